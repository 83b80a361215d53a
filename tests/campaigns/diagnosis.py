"""What is told of faults on vehicles whose thresholds nobody tuned by hand: `make campaign-diagnosis`.

Every vehicle is a truck of the rig's fleet (profile `realistic`): calibrated on one training recording of 600 s and
tuned on two fault-free drives of 600 s, as a workshop would. It is judged on other drives: fault-free ones, and with
each fault of the frozen list, small and large by effect, from 150 s on. Nothing of a judged recording was used before.
"""

import argparse
import io
import json
import tempfile
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import msgspec
from results_page import digest, head_commit

from analysis.calibration.command import main as calibrate
from analysis.evaluation.truth import load_truth
from analysis.export import main as export
from analysis.tuning.command import main as tune
from service.bundle import Bundle, load_bundle
from service.core.events import Event
from service.core.monitor import Monitor
from service.logs import open_log
from testbench.command import main as rig
from testbench.sizes import frozen

Record = dict[str, Any]

KEPT = Path("docs/results/diagnosis.jsonl")
PAGE = Path("docs/results/diagnosis.md")

VEHICLES = tuple(f"truck-{number}" for number in range(201, 209))
ONSET_S, AFTER_S = 150.0, 120.0
"""A diagnosis is judged so long after the first one was told."""


@dataclass(frozen=True)
class Workshop:
    """A vehicle's recordings and its bundle, in a folder of its own."""

    vehicle: str
    folder: Path

    def made(self, cycle: str, seed: int, seconds: float, *words: str) -> Path:
        """A recording; `words` are further options of the rig."""
        number = int(self.vehicle.removeprefix("truck-"))
        name = "-".join([self.vehicle, cycle, str(seed), *words[1:4:2]])
        given = ["record", "--cycle", cycle, "--vehicle", self.vehicle, "--kind", "instrumented", "--id", name]
        given += ["--seed", str(1000 * number + seed), "--duration", str(seconds), "--out", str(self.folder / "logs")]
        quietly(rig, [*given, "--truth", str(self.folder / "truth"), *words])
        return self.folder / "logs" / name

    def bundle(self) -> Bundle:
        """From fault-free recordings."""
        model, tuning, out = (str(self.folder / name) for name in ("model.toml", "tuning.json", "bundle"))
        training = self.made("training", 1, 600.0)
        quietly(calibrate, ["uds4", str(training), "--out", model])
        drives = [str(self.made("drive", seed, 600.0)) for seed in (2, 3)]
        quietly(tune, [model, *drives, "--out", tuning])
        quietly(export, [model, "--tuning", tuning, "--dbc", str(training / "uds.dbc"), "--out", out])
        return load_bundle(Path(out))


def quietly(command: Any, words: list[str]) -> None:
    """Runs a command that must succeed."""
    with redirect_stdout(io.StringIO()) as told, redirect_stderr(told):
        code = command(words)
    assert code == 0, told.getvalue()


def told_of(bundle: Bundle, recording: Path, truth: Path) -> Record:
    """What the vehicle tells of a recording, judged."""
    log, true, at = open_log(recording), load_truth(truth, recording.name), [0.0]
    monitor = Monitor(
        bundle.manifest,
        bundle.bank(),
        bundle.table,
        log.id,
        bundle.id,
        lambda tick, _: at.append(tick.t_s - tick.number * bundle.manifest.period_s),
    )
    told = list(monitor.log(log.relative()))
    origin_s = at[-1]  # log time of tick 0
    events = [(origin_s + event.t_s, event) for event in told]
    onset_s = min((fault.onset_s for fault in true.fault), default=log.duration_s)
    before = [event.diagnoses for t, event in events if t < onset_s]
    first = next((t for t, e in events if t >= onset_s and e.diagnoses and e.diagnoses != before[-1]), None)
    stood = [event for t, event in events if first is not None and t <= first + AFTER_S]
    return {
        "seconds": onset_s,
        "false": [_named(event) for t, event in events if event.transition == "occurred" and t < onset_s],
        "delay_s": None if first is None else first - onset_s,
        "standing": _named(stood[-1]) if stood else [],
    }


def _named(event: Event) -> list[str]:
    return ["+".join(d.faults) or "unknown" for d in event.diagnoses if d.rank == 1]


def vehicle(name: str, faults: Sequence[str] | None = None, free: int = 4) -> Record:
    """All recordings of one vehicle."""
    with tempfile.TemporaryDirectory() as scratch:
        shop = Workshop(name, Path(scratch))
        bundle, truths = shop.bundle(), Path(scratch) / "truth"
        judged: list[Record] = []
        for seed in range(10, 10 + free):
            path = shop.made("drive", seed, 600.0)
            judged.append({"fault": None, **told_of(bundle, path, truths / f"{path.name}.toml")})
        for row, (fault, sizes) in enumerate(frozen().items()):
            for column, size in enumerate(("small", "large")):
                if faults is not None and fault not in faults:
                    continue
                words = ("--fault", fault, "--size", size, "--onset", str(ONSET_S))
                path = shop.made("drive", 100 + 2 * row + column, 450.0, *words)
                told = told_of(bundle, path, truths / f"{path.name}.toml")
                judged.append({"fault": fault, "size": size, "of": sizes[column], **told})
    return {"vehicle": name, "judged": judged}


def kept() -> list[Record]:
    """The records that are there."""
    return [json.loads(line) for line in KEPT.read_text().splitlines()] if KEPT.exists() else []


def main(arguments: Sequence[str] | None = None) -> None:
    """Makes what is missing, and the page."""
    from diagnosis_page import page

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args(arguments)
    there = {record["vehicle"] for record in kept()}
    stamp = {"commit": head_commit(), "code": digest("analysis", "service", "testbench", "dbc")}
    with get_context("spawn").Pool(options.processes, maxtasksperchild=1) as pool, KEPT.open("ab") as out:
        for record in pool.imap_unordered(vehicle, [name for name in VEHICLES if name not in there]):
            print(record["vehicle"], flush=True)
            out.write(msgspec.json.encode({**record, **stamp}) + b"\n")
            out.flush()
    PAGE.write_text(page(kept()))


if __name__ == "__main__":
    main()

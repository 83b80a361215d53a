"""Networks from structure alone diagnose loops of a pump and a valve, without dynamics. `make campaign-loops`.

    .venv/bin/python tests/campaigns/loops.py --vehicles 11 12

Each loop has 20 minutes to train on, two drives of 15 minutes to tune, six faults of two sizes, and two drives of half
an hour without one. A line of the results is a loop; what is there of the same code is not made again.
"""

import json
import time
from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout, suppress
from io import BytesIO, TextIOWrapper
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from by_vehicle import Campaign, run
from diagnosis_shop import Workshop, must
from pump_loop import MODEL, SIZES, samples, written
from results_page import exact_rate, exact_share, provenance

from faultline.analysis.export import main as export
from faultline.analysis.tuning.command import main as tune
from faultline.service.core.errors import InputError
from faultline.service.diagnose.command import main as diagnose
from faultline.training.command import main as train

Record = dict[str, Any]

VEHICLES = tuple(range(11, 21))
"""Nothing was chosen on these: loops 1 and 2 are of development."""
TRAINING_S, TUNING_S, DRIVE_S, ONSET_S, FREE_S = 1200, 900, 900, 400, 1800
LOOK_S = 120.0
SEVERE = 2.5
RESULTS = Path("docs/results/loops.jsonl")
WORK = Path("out/campaign-loops")
FROZEN = ("analysis", "service", "training", "tests/campaigns/loops.py", "tests/campaigns/pump_loop.py")
HEAD = """# From structure alone, without dynamics

All data are **simulated** (`tests/campaigns/pump_loop.py`, at 1 Hz). Made by `make campaign-loops`, frozen before it
was run. Loops of water with a pump and a valve, each with parameters of its own; the model says which variables are in
which equation, and no test has a state. One recording of 20 minutes to train on, two of 15 to tune; faults set in at
400 s of 900. *In the set*: two minutes after the first diagnosis the true component is among the explanations of rank
1, alone or in a pair. Intervals of 95 % are exact.
"""


class _Drive(NamedTuple):
    """A recording to be judged; without a fault its name is empty."""

    name: str
    fault: str
    size: float
    seconds: int


def _drives() -> Iterator[_Drive]:
    for fault, large in SIZES.items():
        for label, size in (("large", large), ("severe", SEVERE * large)):
            yield _Drive(f"{fault}-{label}", fault, size, DRIVE_S)
    for k in range(2):
        yield _Drive(f"free-{k}", "", 0.0, FREE_S)


def vehicle(shop: Workshop) -> Record:
    """All recordings of a loop."""
    start, busy, folder = time.monotonic(), time.process_time(), shop.folder
    folder.mkdir(parents=True, exist_ok=True)
    model, tuning = folder / "loop.toml", folder / "tuning.json"
    model.write_text(MODEL)
    tuning.unlink(missing_ok=True)

    def made(name: str, seed: int, seconds: int, fault: str = "", size: float = 0.0) -> str:
        values = samples(shop.number, seed, seconds, fault, size, ONSET_S)
        return str(written(folder / name, model, values, shop.number))

    given = [str(model), "--networks", str(folder / "networks")]
    must(train, [str(model), made("training", 1, TRAINING_S), "--out", str(folder / "networks")])
    drives = [made(f"tuning-{seed}", seed, TUNING_S) for seed in (2, 3)]
    must(tune, [*given, *drives, "--out", str(tuning)])
    must(export, [*given, "--tuning", str(tuning), "--out", str(folder / "bundle"), "--force"])
    judged = []
    for seed, drive in enumerate(_drives(), start=10):
        path = made(drive.name, seed, drive.seconds, drive.fault, drive.size)
        judged.append({**drive._asdict(), **_read(_events(path, folder / "bundle"), drive)})
    spent = {"wall_s": round(time.monotonic() - start, 1), "cpu_s": round(time.process_time() - busy, 1)}
    return {"vehicle": shop.number, "judged": judged, **spent}


def _events(recording: str, bundle: Path) -> list[Record]:
    """The events of a recording, also of one that ends while an alarm stands that nothing has confirmed."""
    raw = BytesIO()
    out = TextIOWrapper(raw, write_through=True)
    with redirect_stdout(out), suppress(InputError):
        diagnose([recording, "--bundle", str(bundle), "--json"])
    return [json.loads(line) for line in raw.getvalue().splitlines()]


def _read(events: Sequence[Record], drive: _Drive) -> Record:
    """The delay [s], the faults of rank 1 two minutes after the first diagnosis, and what was false before."""
    onset_s = float(ONSET_S if drive.fault else drive.seconds)
    found = [event for event in events if event["diagnoses"] and event["t_s"] >= onset_s]
    false = [event for event in events if event["transition"] == "occurred" and event["t_s"] < onset_s]
    suspected = [event for event in events if event["transition"] == "suspected" and event["t_s"] < onset_s]
    by_then = [event for event in found if event["t_s"] <= found[0]["t_s"] + LOOK_S]
    first = [each["faults"] for each in by_then[-1]["diagnoses"] if each["rank"] == 1] if found else []
    return {
        "delay_s": found[0]["t_s"] - onset_s if found else None,
        "first": first,
        "false": len(false),
        "suspected": len(suspected),
        "free_s": onset_s,
    }


def page(records: Sequence[Record]) -> str:
    """The tables, of all loops that are there."""
    commit = ", ".join(sorted({record["commit"] for record in records}))
    lines = [HEAD, provenance(commit, sum(record["wall_s"] for record in records)), "", f"{len(records)} loops.", ""]
    lines += ["| fault | detected | delay | in the set | names of rank 1, mean |", "|---|---|---|---|---|"]
    every = [each for record in records for each in record["judged"]]
    faulty = [each for each in every if each["fault"]]
    for label in ("large", "severe"):
        lines.append(_row(f"all, {label}", [each for each in faulty if each["name"].endswith(label)]))
    for name in dict.fromkeys(each["name"] for each in faulty):
        lines.append(_row(name.replace("-", ", "), [each for each in faulty if each["name"] == name]))
    hours = sum(each["free_s"] for each in every) / 3600.0
    for what, key in (("False diagnoses", "false"), ("False suspicions", "suspected")):
        lines += ["", f"{what}: {exact_rate(sum(each[key] for each in every), hours)}."]
    return "\n".join(lines) + "\n"


def _row(name: str, of: Sequence[Record]) -> str:
    found = [each for each in of if each["delay_s"] is not None]
    right = sum(any(each["fault"] in faults for faults in each["first"]) for each in found)
    names = [len({fault for faults in each["first"] for fault in faults}) for each in found]
    delay = f"{median(each['delay_s'] for each in found):.0f} s" if found else "-"
    mean = f"{sum(names) / len(names):.2f}" if names else "-"
    return f"| {name} | {exact_share(len(found), len(of))} | {delay} | {exact_share(right, len(found))} | {mean} |"


if __name__ == "__main__":
    run(Campaign(__doc__, VEHICLES, vehicle, page, RESULTS, WORK, FROZEN))

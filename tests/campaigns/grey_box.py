"""What networks are worth beside the calibrated equations: error, coverage, cost, transfer.

    .venv/bin/python tests/campaigns/grey_box.py

A record is a vehicle of the rig with an effect or none, on which both are made from one training recording, and judged
on others. Finished records stay in `KEPT`; a call goes on with those that are missing. The page is written anew.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import numpy.typing as npt
from results_page import digest, head_commit

from faultline.analysis.calibration.command import main as calibrate
from faultline.analysis.graph.bank import build_bank, inputs_of
from faultline.analysis.graph.networks import Networks
from faultline.analysis.graph.runnable import Runnable
from faultline.analysis.model import Model, load_model
from faultline.analysis.recordings.observe import ticks_of
from faultline.service.core.signals.dbc import compile_dbc
from faultline.service.logs import open_log
from faultline.testbench import ecu
from faultline.testbench.command import main as rig
from faultline.training.bank import networks_of
from faultline.training.layout import layout_of
from faultline.training.loop import Begin, Training
from faultline.training.recipe import DEFAULT, THESIS, Phase, Recipe
from faultline.training.samples import Samples, load_samples
from faultline.training.saved import PHASES, RATE

Array = npt.NDArray[np.float64]
Record = dict[str, Any]

KEPT, PAGE = Path("docs/results/grey-box.jsonl"), Path("docs/results/grey-box.md")
MODEL = "uds"
BAND = 2.576
"""Of sigma: the adaptive band that 99 % shall lie within."""

USUAL, SLOW, BRISK = (1.0, 1.0), (0.5, 2.0), (2.0, 0.7)
"""Pressure controllers: gain and integral time, in parts of the usual one's."""

SHORT_S = (120.0, 240.0)
"""Recordings of a truck to which a bench's networks are adapted."""

EPOCHS = 3
"""Of the thesis' recipe, for what one costs."""

ONSET_S = 100.0
CLOGGED = ("--fault", "fA_p", "--size", "0.85", "--onset", str(ONSET_S))
CORNER_PA = 9.0e5
"""Below it, and above the operating region's end, no recording of `drive` has a pressure."""

WAYS = ("not varied", "with the fault", "default")

WHOLE = ("t02", "t13", "t21")
"""Tests that the thesis' recipe trains to its end."""


@dataclass(frozen=True)
class Case:
    """A vehicle with an effect (or none), and the seed of its recordings and networks."""

    vehicle: str
    effect: str | None
    seed: int

    @property
    def name(self) -> str:
        """For example truck-2-full_lift-0."""
        return f"{self.vehicle}-{self.effect or 'none'}-{self.seed}"


def cases() -> Iterator[Case]:
    """Five seeds on the bench, five trucks, two effects that the equations lack."""
    yield from (Case("bench", None, seed) for seed in range(5))
    yield from (Case(f"truck-{number}", None, 0) for number in range(1, 6))
    yield from (Case("bench", effect, 0) for effect in ("full_lift", "stiff_hose"))


def made(
    case: Case,
    cycle: str,
    folder: Path,
    seed: int,
    duration_s: float,
    controller: tuple[float, float] = USUAL,
    *words: str,
) -> Path:
    """An instrumented recording of the case; `words` are further options of the rig, a fault for one."""
    name = "-".join([case.name, cycle, str(seed), *(f"{part:g}" for part in controller), *words[1:4:2]])
    given = ["record", "--cycle", cycle, "--vehicle", case.vehicle, "--kind", "instrumented", "--profile", "ideal"]
    given += ["--seed", str(seed), "--duration", str(duration_s), "--id", name, "--out", str(folder / "logs")]
    given += ["--truth", str(folder / "truth"), *(["--effect", case.effect] if case.effect else []), *words]
    with (
        patch.object(ecu, "GAIN", ecu.GAIN * controller[0]),
        patch.object(ecu, "INTEGRAL_TIME", ecu.INTEGRAL_TIME * controller[1]),
    ):
        assert rig(given) == 0
    return folder / "logs" / name


def others(case: Case, folder: Path) -> dict[str, Path]:
    """The recordings on which a case is judged."""
    first = 100 * case.seed
    return {
        "validation": made(case, "validation", folder, first + 2, 480.0),
        "drive": made(case, "drive", folder, first + 3, 480.0),
        "slow": made(case, "validation", folder, first + 2, 480.0, SLOW),
        "brisk": made(case, "drive", folder, first + 4, 480.0, BRISK),
    }


def trained(
    model: Model,
    recordings: Path | Sequence[Path],
    recipe: Recipe,
    seed: int,
    begin: Begin | None = None,
    tests: Sequence[str] | None = None,
) -> tuple[Networks, Training, float]:
    """Networks from recordings, and the CPU time [s] that they took."""
    layout = layout_of(model, tests)
    of = [recordings] if isinstance(recordings, Path) else recordings
    samples = load_samples(model, inputs_of(model), of, lambda _: None)
    start = time.process_time()
    training = Training(layout, samples, recipe, seed, begin)
    training.run(lambda _: None, lambda: None)
    found = networks_of(training, samples, seed)
    return found, training, time.process_time() - start


def judged(model: Model, networks: Networks, recording: Path) -> dict[str, dict[str, float]]:
    """Return by test the RMS error [Pa] of equations and networks, and the coverage of the band."""
    return {
        test: {
            "equations": _rms(of.equations[of.usable]),
            "networks": _rms(of.r[of.usable]),
            "covered": float((np.abs(of.r[of.usable]) < BAND * of.sigma[of.usable]).mean()),
        }
        for test, of in watched(model, networks, recording).items()
    }


@dataclass(frozen=True)
class Watched:
    """A test over K ticks at `t_s`, samples `z` (K, nz), and the residuals [Pa] of its `equations` and networks (`r`).

    `usable` is where both can tell.
    """

    t_s: Array
    z: Array
    equations: Array
    r: Array
    sigma: Array
    usable: npt.NDArray[np.bool_]


def watched(model: Model, networks: Networks, recording: Path) -> dict[str, Watched]:
    """By test: what the vehicle would see."""
    runnable = Runnable(build_bank(model), networks)
    log = open_log(recording)
    table = compile_dbc(log.dbc, {c.signal: c.unit for c in runnable.bank.inputs}, str(recording))
    ticks = ticks_of(model, runnable.bank.inputs, log.signals(table), runnable.fresh())
    t_s, z = np.array([tick.t_s for tick in ticks]), np.array([tick.z for tick in ticks])
    r, sigma, usable = (np.array([getattr(t.residuals, part) for t in ticks]) for part in ("r", "sigma", "counted"))
    names = [generator.name for generator in runnable.generators]
    found = {}
    for n, generator in enumerate(runnable.generators):
        if generator.name.endswith(".rnn"):
            t = names.index(f"{generator.test}.ode")
            both = usable[:, t] & usable[:, n]
            found[generator.test] = Watched(t_s, z, r[:, t], r[:, n], sigma[:, n], both)
    return found


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def compared(case: Case) -> Record:
    """Equations and networks from one recording, judged on others."""
    with tempfile.TemporaryDirectory() as scratch:
        folder, first = Path(scratch), 100 * case.seed
        training = made(case, "training", folder, first + 1, 600.0)
        calibrated = folder / "model.toml"
        refused = calibrate([MODEL, str(training), "--out", str(calibrated)])  # then it writes nothing, and says why
        assert refused in (0, 1)
        model = load_model(str(calibrated) if calibrated.exists() else MODEL)
        networks, _, cpu_s = trained(model, training, DEFAULT, case.seed)
        return {
            "kind": "compared",
            "case": case.name,
            **asdict(case),
            "cpu_s": cpu_s,
            "calibrated": calibrated.exists(),
            "bytes": len(networks.graph),
            "judged": {name: judged(model, networks, recording) for name, recording in others(case, folder).items()},
        }


def cornered(way: str) -> Record:
    """Thesis Fig. 6.15 and 6.16: a clogged pump filter brings doses at pressures that t02 has never seen.

    It decouples that fault: what its residual would show there is false. Shares are of the ticks at such a pressure.
    """
    model, case, test = load_model(MODEL), Case("bench", None, 0), "t02"
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        usual = made(case, "drive", folder, 3, 600.0)  # no ladder: pressures are those at which doses are given
        clogged, other = (made(case, "validation", folder, seed, 300.0, USUAL, *CLOGGED) for seed in (31, 32))
        recipe = DEFAULT if way == "default" else replace(DEFAULT, copies=0)
        recordings = [usual, clogged] if way == "with the fault" else [usual]
        networks, _, _ = trained(model, recordings, recipe, 0, tests=[test])
        found = watched(model, networks, other)[test]
    column = [*model.known].index("y_p_ap")
    there = found.usable & (found.t_s > ONSET_S) & (found.z[:, column] < CORNER_PA)
    beyond = np.abs(found.r) > BAND * found.sigma
    return {
        "kind": "corner",
        "case": f"corner-{way.replace(' ', '-')}",
        "way": way,
        "ticks": int(there.sum()),
        "beyond": float(beyond[there].mean()),
        "error": _rms(found.r[there]),
    }


def transferred(seconds: float) -> Record:
    """The bench's networks on a truck: as they are, adapted to a short recording, and trained on that alone."""
    model, bench, truck = load_model(MODEL), Case("bench", None, 0), Case("truck", None, 0)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        usual, training, _ = trained(model, made(bench, "training", folder, 1, 600.0), DEFAULT, 0)
        short = made(truck, "drive", folder, 5, seconds + 25.0)  # the first of it builds the pressure up
        begin = _Weights(training.best, training.scaling)
        adapted, _, adapting_s = trained(model, short, replace(DEFAULT, phases=PHASES, rate=RATE), 0, begin)
        anew, _, anew_s = trained(model, short, DEFAULT, 0)
        other = made(truck, "validation", folder, 6, 480.0)
        errors = {
            name: {test: found["networks"] for test, found in judged(model, networks, other).items()}
            for name, networks in (("as they are", usual), ("adapted", adapted), ("anew", anew))
        }
    cost = {"adapted": adapting_s, "anew": anew_s}
    return {"kind": "transfer", "case": f"transfer-{seconds:.0f}", "seconds": seconds, "cpu_s": cost, "errors": errors}


@dataclass(frozen=True)
class _Weights:
    """Where an adaptation begins."""

    weights: dict[str, Any]
    scaling: Any


def thesis_cost(test: str) -> Record:
    """What an epoch of the thesis' recipe costs, one member of one test by itself, as the thesis ran it."""
    with tempfile.TemporaryDirectory() as scratch:
        _, _, seconds = _as_the_thesis(test, Path(scratch), EPOCHS)
    return {"kind": "thesis", "case": f"thesis-{test}", "test": test, "epoch_s": seconds / EPOCHS}


def thesis_whole(test: str) -> Record:
    """The thesis' recipe to its end: errors where `bench-none-0` is judged."""
    case = Case("bench", None, 0)
    with tempfile.TemporaryDirectory() as scratch:
        folder, model = Path(scratch), load_model(MODEL)
        training, samples, seconds = _as_the_thesis(test, folder, None)
        networks = networks_of(training, samples, 0)
        errors = {
            name: judged(model, networks, recording)[test]["networks"]
            for name, recording in others(case, folder).items()
        }
    return {"kind": "whole", "case": f"whole-{test}", "test": test, "cpu_s": seconds, "errors": errors}


def _as_the_thesis(test: str, folder: Path, epochs: int | None) -> tuple[Training, Samples, float]:
    """A training by its recipe, of one member of one test, and the CPU time [s]."""
    model = load_model(MODEL)
    recording = made(Case("bench", None, 0), "training", folder, 1, 600.0)
    samples = load_samples(model, inputs_of(model), [recording], lambda _: None)
    begins = [stretch.begin_s for stretch in samples.stretches]
    first = next((k for k in range(1, len(begins)) if begins[k] <= begins[k - 1]), len(begins))
    one = replace(samples, stretches=samples.stretches[:first])  # of one start, as the thesis had
    recipe = replace(THESIS, phases=(Phase(None, 0, 1, epochs),)) if epochs else THESIS
    training = Training(layout_of(model, [test]), one, recipe, 0)
    start = time.process_time()
    training.run(lambda report: print(test, report, flush=True), lambda: None)
    return training, one, time.process_time() - start


def work() -> list[tuple[str, Any, Any]]:
    """All records: name, function and its argument."""
    tests = [test.name for test in layout_of(load_model(MODEL)).tests]
    found: list[tuple[str, Any, Any]] = [(case.name, compared, case) for case in cases()]
    found += [(f"transfer-{seconds:.0f}", transferred, seconds) for seconds in SHORT_S]
    found += [(f"corner-{way.replace(' ', '-')}", cornered, way) for way in WAYS]
    found += [(f"thesis-{test}", thesis_cost, test) for test in tests]
    return found + [(f"whole-{test}", thesis_whole, test) for test in WHOLE]


def kept() -> list[Record]:
    """The records that are there."""
    return [json.loads(line) for line in KEPT.read_text().splitlines()] if KEPT.exists() else []


def _done(order: tuple[str, Any, Any]) -> Record:
    import torch

    torch.set_num_threads(1)
    _, function, argument = order
    found: Record = function(argument)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Makes what is missing, and the page."""
    from grey_box_page import page

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args(arguments)
    there = {record["case"] for record in kept()}
    todo = [order for order in work() if order[0] not in there]
    stamp = {"commit": head_commit(), "code": digest("training", "analysis", "service", "testbench", "dbc")}
    with get_context("spawn").Pool(options.processes, maxtasksperchild=1) as pool, KEPT.open("a") as out:
        for record in pool.imap_unordered(_done, todo):
            print(record["case"], flush=True)
            out.write(json.dumps({**record, **stamp}) + "\n")
            out.flush()
    PAGE.write_text(page(kept()))


if __name__ == "__main__":
    main()

"""Networks of one vehicle on another: as they are, adapted, or trained anew. `make campaign-transfer`.

    .venv/bin/python tests/campaigns/transfer.py --vehicles 942 943

The bench's networks (one training recording of 600 s) on trucks of the rig's fleet, profile `ideal`: `train --from` on
a drive of 2, 5 or 10 minutes, networks trained on that drive alone, and the bench's own, judged on the truck's
validation cycle and on another drive. A line of the results is a vehicle; what is there of the same
code is not made again.
"""

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from by_vehicle import Campaign, run
from diagnosis_shop import Workshop
from grey_box import MODEL, Case, judged, made
from results_page import provenance

from faultline.analysis.graph.bank import inputs_of
from faultline.analysis.graph.networks import Networks
from faultline.analysis.model import load_model
from faultline.training.adaptation import trained_anew
from faultline.training.bank import networks_of
from faultline.training.device import device_of
from faultline.training.layout import layout_of
from faultline.training.loop import Training
from faultline.training.recipe import DEFAULT
from faultline.training.samples import Samples, load_samples
from faultline.training.saved import Saved

Record = dict[str, Any]

VEHICLES = tuple(range(985, 995))
MINUTES = (2, 5, 10)
PRESSURE_S = 25.0
"""The first of a drive builds the pressure up."""
WAYS = ("as they are", "adapted", "anew")
AS_GOOD = 1.05
"""Times the error of networks trained anew: what two trainings with other seeds differ by."""
HEAD = """# Networks of one vehicle on another

All data are **simulated** by the rig, profile `ideal`. Made by `make campaign-transfer`; vehicles and what counts are
declared in `tests/campaigns/transfer.py`, frozen before it was run. The bench's networks on trucks: as they are;
adapted to a short drive (`faultline train --from`, which takes of each test what was trained anew, unless what was
adapted errs clearly less where the drive was held out); and trained on that drive alone. RMS errors over two recordings
of the truck that no training saw, medians over the vehicles [kPa]; *as good* counts the vehicles in which what was
adapted errs by at most 1.05 times as much as what was trained anew, which is what two trainings with other seeds
differ by.
"""
RESULTS = Path("docs/results/transfer.jsonl")
WORK = Path("out/campaign-transfer")
FROZEN = ("analysis", "service", "testbench", "training", "dbc", "tests/campaigns/transfer.py")


def vehicle(shop: Workshop) -> Record:
    """All trainings for one vehicle."""
    start, busy = time.monotonic(), time.process_time()
    device_of("cpu")  # on one thread
    model, truck = load_model(MODEL), Case(f"truck-{shop.number}", None, 0)
    layout = layout_of(model)
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        bench = _samples(made(Case("bench", None, 0), "training", folder, 1, 600.0))
        base, of_bench = _trained(Training(layout, bench, DEFAULT, 0), bench)
        others = [made(truck, "validation", folder, 6, 480.0), made(truck, "drive", folder, 7, 480.0)]
        for minutes in MINUTES:
            short = _samples(made(truck, "drive", folder / str(minutes), 5, 60.0 * minutes + PRESSURE_S))
            begin = Saved(base.best, base.scaling, DEFAULT, bench.digests)
            adapting = Training(layout, short, begin.adapting(), 0, begin)
            adapting.run(lambda _: None, lambda: None)
            taken = trained_anew(adapting, layout, short, begin, 0, lambda _: None)
            banks = (
                of_bench,
                networks_of(adapting, short, 0),
                _trained(Training(layout, short, DEFAULT, 0), short)[1],
            )
            errors = {way: _errors(bank, others) for way, bank in zip(WAYS, banks, strict=True)}
            found[str(minutes)] = {"errors": errors, "anew": taken}
    spent = {"wall_s": round(time.monotonic() - start, 1), "cpu_s": round(time.process_time() - busy, 1)}
    return {"vehicle": shop.number, "minutes": found, **spent}


def _samples(recording: Path) -> Samples:
    model = load_model(MODEL)
    return load_samples(model, inputs_of(model), [recording], lambda _: None)


def _trained(training: Training, samples: Samples) -> tuple[Training, Networks]:
    training.run(lambda _: None, lambda: None)
    return training, networks_of(training, samples, 0)


def _errors(networks: Networks, recordings: Sequence[Path]) -> dict[str, float]:
    """The RMS error [Pa] by test, over the recordings."""
    each = [judged(load_model(MODEL), networks, recording) for recording in recordings]
    return {test: float(np.sqrt(np.mean([of[test]["networks"] ** 2 for of in each]))) for test in each[0]}


def page(records: Sequence[Record]) -> str:
    """The tables, of all vehicles that are there."""
    commit = ", ".join(sorted({record["commit"] for record in records}))
    lines = [HEAD, provenance(commit, sum(record["wall_s"] for record in records)), ""]
    lines += [f"{len(records)} vehicles.", ""]
    lines += ["| minutes | test | " + " | ".join(WAYS) + " | as good as anew | taken from those trained anew |"]
    lines += ["|---|---|---|---|---|---|---|"]
    for minutes in map(str, MINUTES):
        of = [record["minutes"][minutes] for record in records]
        for test in of[0]["errors"]["anew"]:
            by = {way: np.array([each["errors"][way][test] for each in of]) for way in WAYS}
            good = int((by["adapted"] <= AS_GOOD * by["anew"]).sum())
            taken = sum(test in each["anew"] for each in of)
            medians = " | ".join(f"{np.median(by[way]) / 1e3:.2f}" for way in WAYS)
            lines.append(f"| {minutes} | {test} | {medians} | {good} of {len(of)} | {taken} of {len(of)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    run(Campaign(__doc__, VEHICLES, vehicle, page, RESULTS, WORK, FROZEN))

"""A vehicle tuned with one drive, with and without a fleet, beside five own drives: `make campaign-one-drive`.

    .venv/bin/python tests/campaigns/one_drive.py --vehicles 1035 1036

Trucks of the rig's fleet (profile `everyday`, hidden effects). Those of `FLEET` are calibrated and tuned, each with
drives of its own, and pooled. Others are tuned three times: with five drives, with the first of them, and with that one
and the fleet. All three bundles see the same small faults and the same drives without one. A line of the results is a
vehicle; what is there of the same code is not made again.
"""

import json
import shutil
import sys
import time
from collections.abc import Iterator, Mapping
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from by_vehicle import Campaign, run, set_of
from diagnosis_cases import Case, Set, hidden, seed_of
from diagnosis_shop import TUNING_S, Workshop, must, run_of, told_of, watched
from diagnosis_visible import changes
from one_drive_page import METHODS, page
from results_page import digest

from faultline.analysis.export import main as export
from faultline.analysis.fleet.pooling import FILE, pool
from faultline.analysis.tuning.command import main as tune
from faultline.service.bundle.load import load_bundle
from faultline.service.core.errors import InputError
from faultline.testbench.bus import load_dbc
from faultline.testbench.sizes import frozen
from faultline.testbench.traffic import frames

Record = dict[str, Any]

FLEET = tuple(range(1001, 1015))
VEHICLES = tuple(range(1035, 1045))
DRIVES = (2, 3, 4, 5, 6)
OF_FLEET = DRIVES[:4]
SECONDS, FREE_S, FREE = 480.0, 900.0, 5
SMALL: Mapping[str, float] = {name: small for name, (small, _) in frozen().items()}
RESULTS = Path("docs/results/one-drive.jsonl")
WORK = Path("out/campaign-one-drive")
FROZEN = (
    "analysis",
    "service",
    "testbench",
    "dbc",
    "tests/campaigns/one_drive.py",
    "tests/campaigns/diagnosis_shop.py",
)


def cases(number: int, effects_set: Set) -> Iterator[Case]:
    """All recordings of a vehicle that are judged: every fault, small, and drives without one."""
    for k, (fault, size) in enumerate(SMALL.items()):
        yield Case(number, effects_set, "single", "small", ((fault, size),), seed_of(number, 500 + k), SECONDS)
    for k in range(FREE):
        yield Case(number, effects_set, "free", "free", (), seed_of(number, 560 + k), FREE_S)


def of_fleet(shop: Workshop) -> tuple[str, str]:
    """Tune a vehicle of the fleet; return its name, and why it has no tuning."""
    out = shop.folder / "tuning.json"
    if not out.exists():
        try:
            model, _ = shop.calibrated()
            must(tune, [str(model), *(str(shop.made("drive", k, TUNING_S)) for k in OF_FLEET), "--out", str(out)])
        except InputError as error:
            return f"truck-{shop.number}", str(error)
        _without_logs(shop)
    return f"truck-{shop.number}", ""


def _without_logs(shop: Workshop) -> None:
    for folder in ("logs", "truth"):
        shutil.rmtree(shop.folder / folder, ignore_errors=True)


def fleet(work: Path, processes: int) -> None:
    """Make the fleet's file, unless it is there."""
    if (work / FILE).exists():
        return
    shops = [Workshop(number, set_of(number), work / f"truck-{number}") for number in FLEET]
    with get_context("spawn").Pool(processes) as workers:
        refused = {name: why for name, why in workers.imap(of_fleet, shops) if why}
    tuned = {each.folder.name: each.folder / "tuning.json" for each in shops if each.folder.name not in refused}
    print(pool(tuned, str(shops[0].folder / "model.toml"), work, print), refused, flush=True)


def tunings(shop: Workshop) -> dict[str, list[str]]:
    """The arguments of `tune` behind the model, by method."""
    first, *others = (str(shop.made("drive", k, TUNING_S)) for k in DRIVES)
    return {"five": [first, *others], "one": [first], "fleet": [first, "--fleet", str(shop.folder.parent / FILE)]}


def judged_by(shop: Workshop) -> tuple[list[Record], dict[str, float], dict[str, str]]:
    """All recordings of a vehicle by every bundle, CPU time of each tuning [s], and why one was refused."""
    model, training = shop.calibrated()
    bundles, costs, refused = {}, dict[str, float](), dict[str, str]()
    for method, words in tunings(shop).items():
        tuned, out = shop.folder / f"tuning-{method}.json", shop.folder / f"bundle-{method}"
        busy = time.process_time()
        try:
            if not tuned.exists():
                must(tune, [str(model), *words, "--out", str(tuned)])
            if not out.exists():
                dbc = ["--dbc", str(training / "uds.dbc")]
                must(export, [str(model), "--tuning", str(tuned), *dbc, "--out", str(out)])
        except InputError as error:
            refused[method] = str(error)
            continue
        costs[method] = time.process_time() - busy
        bundles[method] = load_bundle(out)
    told = []
    for case in cases(shop.number, shop.effects_set):
        made = run_of(case.request)
        drive = list(frames(case.request, load_dbc(), [made]))
        visible = changes(case.request, made, run_of(case.healthy)) if "fA_p" in dict(case.faults) else True
        for method, bundle in bundles.items():
            row = told_of(case, watched(bundle, case.name, drive, native=True), bundle.manifest.period_s)
            told.append({**row, "method": method, "changes": visible})
    _without_logs(shop)
    return told, costs, refused


def vehicle(shop: Workshop) -> Record:
    """All recordings of one vehicle, by all tunings."""
    start, busy = time.monotonic(), time.process_time()
    told, costs, refused = judged_by(shop)
    spent = {"wall_s": time.monotonic() - start, "cpu_s": time.process_time() - busy}
    prior = json.loads((shop.folder.parent / FILE).read_text())
    return {
        "vehicle": shop.number,
        "effects": hidden(shop.number, shop.effects_set),
        "refused": refused,
        "fleet": {name: prior[name] for name in ("vehicles", "drives", "hours")},
        "costs": {method: round(costs[method], 1) for method in METHODS if method in costs},
        "judged": told,
        **{name: round(each, 1) for name, each in spent.items()},
    }


if __name__ == "__main__":
    if "--page-only" not in sys.argv:
        fleet(WORK / digest(*FROZEN), 2)
    run(Campaign(__doc__, VEHICLES, vehicle, page, RESULTS, WORK, FROZEN))

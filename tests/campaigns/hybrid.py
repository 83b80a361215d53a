"""The thesis' question: do networks make a diagnosis system, and from the structure alone? `make campaign-hybrid`.

    .venv/bin/python tests/campaigns/hybrid.py --vehicles 901 902

Trucks of the rig's fleet (profile `everyday`, hidden effects), with the same training recording, tuning drives, faults
and drives for four bundles: calibrated equations, networks alone (trained with what the equations know), networks from
structure alone (trained on a second recording besides, that excites), equations and networks together. A line of the
results is a vehicle; what is there of the same code is not made again.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from by_vehicle import Campaign, run
from diagnosis_cases import Case, Set, hidden, seed_of
from diagnosis_shop import TUNING, Workshop, must, run_of, told_of, watched
from diagnosis_visible import changes
from hybrid_page import page

from faultline.analysis.export import main as export
from faultline.analysis.structure.command import main as structure
from faultline.analysis.tuning.command import main as tune
from faultline.service.bundle.load import Bundle, load_bundle
from faultline.service.core.errors import InputError
from faultline.testbench.bus import load_dbc
from faultline.testbench.sizes import frozen
from faultline.testbench.traffic import frames
from faultline.training.command import main as train

Record = dict[str, Any]

VEHICLES = tuple(range(901, 921))
SECONDS, FREE_S, FREE = 480.0, 900.0, 2
TRAINING_S = 600.0
SEVERE: Mapping[str, float] = {
    "fA_t": 0.8,
    "fA_p": 0.9,
    "fA_du": 0.8,
    "fA_ori": 0.2,
    "fA_dos": 0.3,
    "fq_pump": 0.2,
    "fy_p_tp": 2e4,
    "fy_p_ap": 4e4,
    "fy_p_du": 4e4,
    "leak_ap": 0.5,
}
"""In the units of `testbench/sizes.toml`; large sizes are those of that file."""
LARGE = {name: large for name, (_, large) in frozen().items()}
RESULTS = Path("docs/results/hybrid.jsonl")
WORK = Path("out/campaign-hybrid")
FROZEN = (
    "analysis",
    "service",
    "testbench",
    "training",
    "dbc",
    "tests/campaigns/hybrid.py",
    "tests/campaigns/diagnosis_shop.py",
)


def cases(number: int, effects_set: Set) -> Iterator[Case]:
    """All recordings of a vehicle: faults of both sizes, sensors reading too much or too little, and none."""
    rng = np.random.default_rng([number, 23])
    sizes = [(fault, label, of[fault]) for fault in SEVERE for label, of in (("large", LARGE), ("severe", SEVERE))]
    for k, (fault, label, size) in enumerate(sizes):
        sign = float(rng.choice([-1.0, 1.0])) if fault.startswith("fy") else 1.0
        yield Case(number, effects_set, "single", label, ((fault, sign * size),), seed_of(number, 500 + k), SECONDS)
    for k in range(FREE):
        yield Case(number, effects_set, "free", "free", (), seed_of(number, 560 + k), FREE_S)


def bundles(shop: Workshop) -> dict[str, Bundle]:
    """The vehicle's bundles by method; made once for a folder."""
    equations, folder = shop.bundle(), shop.folder
    model, names = folder / "model.toml", folder / "names.toml"
    training, excite = (str(shop.made(cycle, 1, TRAINING_S)) for cycle in ("training", "excite"))
    drives = [str(shop.made("drive", k, 600.0)) for k in TUNING]
    if not names.exists():
        must(structure, [str(model), "--model", str(names), "--without-formulas"])
    _made(folder / "networks", train, [str(model), training])
    _made(folder / "structure", train, [str(names), training, excite])
    found = {"equations": equations}
    for method, of, networks in (
        ("networks", names, "networks"),
        ("structure", names, "structure"),
        ("both", model, "networks"),
    ):
        given = ["--networks", str(folder / networks)]
        out, tuned = folder / f"bundle-{method}", folder / f"tuning-{method}.json"
        _made(tuned, tune, [str(of), *drives, *given])
        dbc = ["--dbc", f"{training}/uds.dbc"]
        _made(out, export, [str(of), "--tuning", str(tuned), *given, *dbc])
        found[method] = load_bundle(out)
    return found


def _made(out: Path, command: Any, words: Sequence[str]) -> None:
    if not out.exists():
        must(command, [*words, "--out", str(out)])


def vehicle(shop: Workshop) -> Record:
    """All recordings of one vehicle, by all methods; none where the workshop's tuning refuses it."""
    start, busy = time.monotonic(), time.process_time()
    told: list[Record] = []
    refused = None
    try:
        every = bundles(shop)
        made_s = time.process_time() - busy
        for case in cases(shop.number, shop.effects_set):
            run = run_of(case.request)
            drive = list(frames(case.request, load_dbc(), [run]))
            visible = changes(case.request, run, run_of(case.healthy)) if "fA_p" in dict(case.faults) else True
            for method, bundle in every.items():
                seen = watched(bundle, case.name, drive)
                alarmed = sorted({test for t, test in seen.alarms if t >= case.onset_s}) if case.faults else []
                row = told_of(case, seen, bundle.manifest.period_s)
                told.append({**row, "method": method, "alarmed": alarmed, "changes": visible})
    except InputError as error:
        refused, made_s = str(error), time.process_time() - busy
    spent = {"wall_s": time.monotonic() - start, "cpu_s": time.process_time() - busy, "made_s": made_s}
    effects = hidden(shop.number, shop.effects_set)
    spent = {name: round(each, 1) for name, each in spent.items()}
    return {"vehicle": shop.number, "effects": effects, "refused": refused, "judged": told, **spent}


if __name__ == "__main__":
    run(Campaign(__doc__, VEHICLES, vehicle, page, RESULTS, WORK, FROZEN))

"""The thesis' question: do networks make a diagnosis system, and from the structure alone? `make campaign-hybrid`.

    .venv/bin/python tests/campaigns/hybrid.py --vehicles 965 966

Trucks of the rig's fleet (profile `everyday`, hidden effects), with the same training recording, tuning drives, faults
and drives for four bundles: calibrated equations, networks alone (trained with what the equations know), networks from
structure alone (trained on a second recording besides, that excites), equations and networks together. A line of the
results is a vehicle; what is there of the same code is not made again.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from by_vehicle import Campaign, run
from diagnosis_cases import Case, Set, hidden, seed_of
from diagnosis_shop import TUNING, TUNING_S, Workshop, must, run_of, told_of, watched
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

VEHICLES = tuple(range(965, 985))
"""Nothing was chosen on these: on 903 to 905 how long a suspicion must last, on 907, 929 and 931 what networks take for
the baseline."""
SECONDS, FREE_S, FREE = 480.0, 900.0, 2
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


class Cost(NamedTuple):
    """What a method takes on a vehicle: CPU time to the bundle [s], lines of the model, seconds of recordings."""

    cpu_s: float
    lines: int
    data_s: float


def bundles(shop: Workshop) -> tuple[dict[str, Bundle], dict[str, Cost]]:
    """The vehicle's bundles by method, and what they took; made once for a folder."""
    busy = time.process_time()
    equations, folder = shop.bundle(), shop.folder
    calibrated_s = time.process_time() - busy
    model, names = folder / "model.toml", folder / "names.toml"
    training, excite = (str(shop.made(cycle, 1, shop.training_s)) for cycle in ("training", "excite"))
    drives = [str(shop.made("drive", k, TUNING_S)) for k in TUNING]
    if not names.exists():
        must(structure, [str(model), "--model", str(names), "--without-formulas"])
    trained = {
        "networks": _made(folder / "networks", train, [str(model), training]),
        "structure": _made(folder / "structure", train, [str(names), training, excite]),
    }
    lines = {path: sum(map(bool, path.read_text().splitlines())) for path in (model, names)}
    tuning_s = TUNING_S * len(TUNING)
    found = {"equations": equations}
    costs = {"equations": Cost(calibrated_s, lines[model], shop.training_s + tuning_s)}
    for method, of, networks in (
        ("networks", names, "networks"),
        ("structure", names, "structure"),
        ("both", model, "networks"),
    ):
        given = ["--networks", str(folder / networks)]
        out, tuned = folder / f"bundle-{method}", folder / f"tuning-{method}.json"
        cpu_s = trained[networks] + _made(tuned, tune, [str(of), *drives, *given])
        dbc = ["--dbc", f"{training}/uds.dbc"]
        cpu_s += _made(out, export, [str(of), "--tuning", str(tuned), *given, *dbc])
        found[method] = load_bundle(out)
        recordings_s = shop.training_s * (2 if method == "structure" else 1)
        # networks that equations say more about need these, and their parameters
        of_lines = lines[names] if method == "structure" else lines[model]
        costs[method] = Cost(cpu_s + (calibrated_s if method == "both" else 0.0), of_lines, recordings_s + tuning_s)
    return found, costs


def _made(out: Path, command: Any, words: Sequence[str]) -> float:
    """Make what is not there; the CPU time that it took [s]."""
    busy = time.process_time()
    if not out.exists():
        must(command, [*words, "--out", str(out)])
    return time.process_time() - busy


def judged_by(shop: Workshop) -> tuple[list[Record], dict[str, Cost]]:
    """All recordings of a vehicle by all methods, and what each method took.

    Raises:
        InputError: the workshop's tuning refuses the vehicle.
    """
    told: list[Record] = []
    every, costs = bundles(shop)
    for case in cases(shop.number, shop.effects_set):
        run = run_of(case.request)
        drive = list(frames(case.request, load_dbc(), [run]))
        visible = changes(case.request, run, run_of(case.healthy)) if "fA_p" in dict(case.faults) else True
        for method, bundle in every.items():
            seen = watched(bundle, case.name, drive, native=method == "equations")
            alarmed = sorted({test for t, test in seen.alarms if t >= case.onset_s}) if case.faults else []
            row = told_of(case, seen, bundle.manifest.period_s)
            told.append({**row, "method": method, "alarmed": alarmed, "changes": visible})
    return told, costs


def vehicle(shop: Workshop) -> Record:
    """All recordings of one vehicle, by all methods; none where the workshop's tuning refuses it."""
    start, busy = time.monotonic(), time.process_time()
    refused = None
    try:
        told, costs = judged_by(shop)
    except InputError as error:
        refused, told, costs = str(error), [], {}
    spent = {"wall_s": time.monotonic() - start, "cpu_s": time.process_time() - busy}
    return {
        "vehicle": shop.number,
        "effects": hidden(shop.number, shop.effects_set),
        "refused": refused,
        "doubted": bool(shop.doubts),
        "costs": {method: [round(each, 1) for each in cost] for method, cost in costs.items()},
        "judged": told,
        **{name: round(each, 1) for name, each in spent.items()},
    }


if __name__ == "__main__":
    run(Campaign(__doc__, VEHICLES, vehicle, page, RESULTS, WORK, FROZEN))

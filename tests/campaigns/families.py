"""Sound plants of other structures (`faultline.testbench.families`): does the workflow claim anything in them?

    .venv/bin/python tests/campaigns/families.py --families stepped slow --first 0 --count 15

Each plant has two recordings of a random cycle, and the four-state model with the plant's data sheet. `calibrate` fits
the first; `discover` searches with the shipped library, the second held out. Where an effect is hidden, its name should
be found, otherwise nothing. Results are appended to a file as they come, one line a plant.
"""

import argparse
import dataclasses
import json
import math
import multiprocessing
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from discrepancy import Inline
from families_page import page
from results_page import head_commit

from faultline.analysis.calibration.doubts import doubts
from faultline.analysis.calibration.fit import fit, nuisances
from faultline.analysis.calibration.identify import identify
from faultline.analysis.calibration.sections import sections
from faultline.analysis.calibration.validate import validate
from faultline.analysis.discrepancy.data import load
from faultline.analysis.discrepancy.discover import discover
from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.model import Model, load_model
from faultline.analysis.model.file import SYSTEMS
from faultline.analysis.recordings.observe import open_for
from faultline.analysis.simulation import system_of
from faultline.testbench.bus import load_dbc
from faultline.testbench.families.development import DEVELOPMENT
from faultline.testbench.families.draw import FAMILIES, plant_of
from faultline.testbench.families.plant import Plant, on_a_day
from faultline.testbench.families.recording import record
from faultline.testbench.streams import stream

DURATION_S = 480.0
PAGE = Path("docs/results/families.md")
PRINTED = ("family", "number", "verdict", "sets", "gain", "evidence", "dispersion", "cpu_s")


def sheet_model(sheet: Mapping[str, float]) -> Model:
    """The four-state model with a plant's data sheet."""
    model = load_model("uds")
    parameters = {
        name: dataclasses.replace(p, value=sheet[name]) if name in sheet else p for name, p in model.parameters.items()
    }
    return dataclasses.replace(model, parameters=parameters)


def recordings(family: str, number: int, effects: Mapping[str, float], folder: Path) -> tuple[Path, Path]:
    """A plant's recordings, made unless they are there."""
    plant, dbc = plant_of(family, number, effects), load_dbc()
    title = "+".join(f"{name}={size:g}" for name, size in effects.items()) or "sound"
    here = folder / f"{plant.name}-{title}"
    found = []
    for k, name in enumerate(("training", "held")):
        path = here / name
        found.append(path if path.exists() else record(plant, name, 2 * number + k, DURATION_S, dbc, here))
    return found[0], found[1]


def calibrated(training: Path, held: Path, plant: Plant, number: int) -> dict[str, Any]:
    """What `calibrate` says: its doubts, and by parameter the error of the logarithm and half the 95 % interval.

    Errors are relative to the displacement, the anchor: pressures alone cannot tell the flow scale.
    """
    model = sheet_model(plant.sheet)
    system, found = system_of(model, model.varying), {}
    for path in (training, held):
        log = open_for(model, path, lambda _: None)
        signals = log.signals(log.table({name: known.unit for name, known in model.known.items()}, str(path)))
        found[path.name] = sections(model, system, signals, str(path))
    result = fit(system, found["training"], lambda _: None)
    values = result.unknowns.usual(result.x)
    runs = {name: validate(system, part, values, nuisances(result, part)) for name, part in found.items()}
    estimates, true = identify(result), true_values(on_a_day(plant, stream(2 * number, plant.name, "day")), model)
    scale, errors = result.values["D_p"] / true["D_p"], {}
    for name, value in true.items():
        expected = value * (scale if name.startswith("A_") else 1.0 / scale if name == "B_ap" else 1.0)
        e = estimates.estimates[name]
        low, high = e.interval(e.relative_spread)
        errors[name] = (math.log(result.values[name] / expected), 0.5 * math.log(high / low), e.told)
    normalised = {
        f"{recording} {name} {mode}": a.normalised
        for recording, run in runs.items()
        for name, by_mode in run.agreement.items()
        for mode, a in by_mode.items()
    }
    return {
        "doubts": [*doubts(result, runs)],
        "anchors": {name: list(others) for name, others in estimates.anchors.items()},
        "errors": errors,
        "normalised": normalised,
    }


def true_values(plant: Plant, model: Model) -> dict[str, float]:
    """What the diagnosis model's parameters are for this plant."""
    c, value = plant.circuit, {name: p.value for name, p in model.parameters.items()}
    of_area = value["C_q"] * math.sqrt(2.0 / value["rho"])
    swells = c.c_ap + c.c_du - value["V_du"] / value["B_du"]  # all that the model does not have in V_du is in V_ap
    return {
        "D_p": c.displacement,
        "C_v": c.leakage * value["eta"] / c.displacement,
        "A_t": c.k_t / of_area,
        "A_p": c.k_p / of_area,
        "A_du": c.k_f / of_area,
        "A_ori": c.k_o / of_area,
        "A_dos": c.k_v / of_area,
        "B_ap": value["V_ap"] / swells,
    }


def tried(case: tuple[str, int, dict[str, float]], folder: Path) -> dict[str, Any]:
    """What `discover` says of one plant, or what went wrong."""
    family, number, effects = case
    begin: dict[str, Any] = {"family": family, "number": number, "effects": effects}
    try:
        training, held = recordings(family, number, effects, folder)
        cpu = time.process_time()
        plant = plant_of(family, number, effects)
        begin["calibrate"] = calibrated(training, held, plant, number)
        begin["calibrate_s"], cpu = time.process_time() - cpu, time.process_time()
        data = load(sheet_model(plant.sheet), [training], [held], lambda _: None)
        found = discover(data, load_library(SYSTEMS / "uds"), Inline(), None, lambda *_: None)
        evidence = {
            title: 0.5 * place.suspects[0].evidence if place.members else 0.0
            for title, place in (("before", found.before), ("after", found.after), ("held", found.held))
        }
        return {
            **begin,
            "verdict": "fault" if found.onset(["training"], ["held"]) else found.verdict.kind,
            "sets": [list(names) for names in found.verdict.sets],
            "gain": found.verdict.gain,
            "remainder": found.verdict.remainder,
            "evidence": evidence,
            "members": list(found.before.members),
            "threshold": found.outcome.threshold,
            "dispersion": [found.outcome.nominal.dispersion, found.outcome.chosen.dispersion],
            "singles": [[a.effects[0], a.evidence - found.outcome.nominal.evidence] for a in found.outcome.singles[:5]],
            "cpu_s": time.process_time() - cpu,
        }
    except Exception as error:  # noqa: BLE001  (whatever it is, it counts against the workflow)
        return {**begin, "verdict": f"{type(error).__name__}: {error}", "sets": []}


def main() -> None:
    """Runs what is missing in the file of results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--families", nargs="+", default=[*FAMILIES])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=15)
    parser.add_argument("--hide", nargs=2, default=None, metavar=("EFFECT", "SIZE"))
    parser.add_argument("--folder", type=Path, default=Path("out/families"), help="recordings are kept here")
    parser.add_argument("--results", type=Path, default=PAGE.with_suffix(".jsonl"))
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    effects = {options.hide[0]: float(options.hide[1])} if options.hide else {}
    there = [json.loads(line) for line in options.results.read_text().splitlines()] if options.results.exists() else []
    known = {(line["family"], line["number"]) for line in there if line["effects"] == effects}
    numbers = range(options.first, options.first + options.count)
    wanted = [(family, n, effects) for n in numbers for family in options.families if (family, n) not in known]
    commit, start = head_commit(), time.monotonic()
    with multiprocessing.Pool(options.processes, maxtasksperchild=20) as pool:
        for result in pool.imap_unordered(partial(tried, folder=options.folder), wanted, chunksize=1):
            with options.results.open("a") as file:
                file.write(json.dumps({**result, "commit": commit}) + "\n")
            print({key: result.get(key) for key in PRINTED}, flush=True)
    rows = [json.loads(line) for line in options.results.read_text().splitlines()]
    options.results.with_suffix(".md").write_text(page(rows, commit, time.monotonic() - start, [*DEVELOPMENT]))


if __name__ == "__main__":
    main()

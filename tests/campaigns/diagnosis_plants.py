"""Plants of other structures among the campaign's vehicles: what they record, drive and are calibrated from.

Of the three families that were written for verification, after calibration had been frozen; no decision has seen them.
"""

import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from diagnosis_cases import PLANTS, Case

from faultline.analysis.model import load_model
from faultline.analysis.model.write import dump_model
from faultline.testbench.bus import load_dbc
from faultline.testbench.families.cycle import asked
from faultline.testbench.families.draw import plant_of
from faultline.testbench.families.plant import Plant, on_a_day, run
from faultline.testbench.families.recording import record
from faultline.testbench.families.sensed import PLACE, Course, frames
from faultline.testbench.faults import Fault
from faultline.testbench.sizes import SIGMAS, WINDOW
from faultline.testbench.streams import stream
from faultline.testbench.traffic import Frame

SPEED_NOISE = 0.03
"""Of a speed that is counted without noise [1/s]."""


def recorded(number: int, name: str, seed: int, seconds: float, out: Path) -> Path:
    """A fault-free recording of a plant."""
    return record(plant_of(*PLANTS[number]), name, seed, seconds, load_dbc(), out)


def sheet(number: int, path: Path) -> Path:
    """The four-state model with the plant's data sheet, as a file."""
    given, model = plant_of(*PLANTS[number]).sheet, load_model("uds")
    parameters = {
        name: dataclasses.replace(p, value=given[name]) if name in given else p for name, p in model.parameters.items()
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(dump_model(dataclasses.replace(model, parameters=parameters)))
    return path


def with_edges(sheet: Path, told: str) -> bool:
    """Put the [edges] that a command proposed into the sheet, as an engineer would; return whether that changed it."""
    proposed = re.search(r"\[edges\]: steps = \{(.+)\}", told)
    if proposed is None:
        return False
    before = sheet.read_text()
    sheet.write_text(re.sub(r"(?<=\nsteps = )\{.+\}", f"{{{proposed[1]}}}", before, count=1))
    return sheet.read_text() != before


def frames_of(case: Case) -> Iterator[Frame]:
    """What is sent in a case's drive."""
    today, course = _driven(case, faulty=True)
    return frames(course, today.seen, load_dbc(), stream(case.seed, today.name, "frames"))


def _driven(case: Case, *, faulty: bool) -> tuple[Plant, Course]:
    plant = plant_of(*PLANTS[case.number])
    today = on_a_day(plant, stream(case.seed, plant.name, "day"))
    cycle = asked(plant.style, case.seconds, stream(case.seed, plant.name, "cycle"))
    faults = [Fault(name, size, case.onset_s) for name, size in case.faults] if faulty else []
    return today, run(today, cycle, case.seconds, faults)


def changes(case: Case) -> bool:
    """Whether some mean of `WINDOW` moves by `SIGMAS` of its sensor's noise after the onset (`diagnosis_visible`)."""
    today, faulty = _driven(case, faulty=True)
    _, healthy = _driven(case, faulty=False)
    sensors = today.seen.sensors
    moved = [((faulty.pressures - healthy.pressures)[:, k], sensors[name].noise) for name, k in PLACE.items()]
    moved.append((faulty.speed - healthy.speed, max(today.seen.speed.noise, SPEED_NOISE)))
    width, first = round(WINDOW / faulty.step), round(case.onset_s / faulty.step)
    count = (len(faulty.t) - first) // width
    means = [np.abs(by[first : first + count * width].reshape(count, width).mean(axis=1)) / sd for by, sd in moved]
    return bool(np.max(means) > SIGMAS)

"""The files of a family's recording: what an instrumented vehicle's logger hands over."""

import json
from dataclasses import asdict
from pathlib import Path

from faultline.testbench.bus import SENSOR_BOX, Dbc, with_periods
from faultline.testbench.can_logger import START_TEXT, candump
from faultline.testbench.families.circuit import HIDDEN
from faultline.testbench.families.cycle import asked
from faultline.testbench.families.plant import Plant, on_a_day, run
from faultline.testbench.families.sensed import frames
from faultline.testbench.streams import stream
from faultline.writing import write_folder


def record(plant: Plant, name: str, seed: int, duration_s: float, dbc: Dbc, out: Path) -> Path:
    """Runs the plant over a random cycle and writes the recording `name`, whole or not at all; returns its folder."""
    dbc = dbc_of(plant, dbc)
    today = on_a_day(plant, stream(seed, plant.name, "day"))
    course = run(today, asked(plant.style, duration_s, stream(seed, plant.name, "cycle")), duration_s)
    sent = frames(course, today.seen, dbc, stream(seed, plant.name, "frames"))
    folder = out / name
    files = {
        "recording.toml": _toml(plant, name, dbc).encode(),
        "can.log": candump(sent).encode(),
        "uds.dbc": dbc.content,
    }
    write_folder(folder, files)
    return folder


def dbc_of(plant: Plant, dbc: Dbc) -> Dbc:
    """The DBC that the plant's maker hands over: with the periods of its own frames."""
    bus = plant.seen.bus
    return with_periods(dbc, {"UDS_ECU": bus.ecu, SENSOR_BOX: bus.box})


def truth(plant: Plant) -> str:
    """What is hidden in a plant, its own values, and its data sheet, as TOML."""
    own = asdict(plant.circuit)
    tables = {
        "hidden": {name: own[name] for name in HIDDEN if own[name]},
        "circuit": {name: value for name, value in own.items() if name not in HIDDEN},
        "data_sheet": plant.sheet,
        "drift": plant.drifts,
    }
    parts = [f"[{title}]\n" + "".join(f"{k} = {v!r}\n" for k, v in values.items()) for title, values in tables.items()]
    return f'schema = 1\nfamily = "{plant.family}"\nnumber = {plant.number}\n\n' + "\n".join(parts)


def _toml(plant: Plant, name: str, dbc: Dbc) -> str:
    return f"""schema = 1
id = {json.dumps(name)}
kind = "instrumented"
source = "simulated by the faultline rig, family {plant.family}"
vehicle = {json.dumps(plant.name)}
cycle = "random"
start = {START_TEXT}
sensor_set = "instrumented"

[can]
file = "can.log"
dbc = "uds.dbc"
dbc_sha256 = "{dbc.sha256}"
"""

"""The files of a recording, and its truth in another folder.

    OUT/<id>/recording.toml  can.log  external.csv  uds.dbc          what a bench would hand over (or can.blf ...)
    OUT/<id>/recording.toml  can.log  uds.dbc                        and a vehicle, with all that it has on CAN
    TRUTH/<id>.toml                                                  what only the rig knows

Equal requests give equal bytes, but for the head of ASC and TRC logs, where python-can writes the time of writing.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path

from faultline.testbench.bus import Dbc
from faultline.testbench.can_logger import START_TEXT, candump, in_format
from faultline.testbench.day import CALM
from faultline.testbench.effects import checked, fitted
from faultline.testbench.errors import RigError
from faultline.testbench.faults import FAULTS, UNITS
from faultline.testbench.request import Request
from faultline.testbench.second_logger import Clocking, external_csv
from faultline.testbench.simulation import MARGIN, simulate
from faultline.testbench.streams import stream
from faultline.testbench.traffic import frames
from faultline.testbench.vehicles import Vehicle
from faultline.writing import check_folder, write_file, write_folder


def record(
    request: Request, dbc: Dbc, out: Path, truth: Path, *, force: bool, progress: Callable[[float], None]
) -> tuple[Path, Path]:
    """Runs the rig and writes the recording; returns its folder and its truth file.

    A recording appears whole or not at all.

    Raises:
        RigError: something is already there and `force` is not given, or `truth` lies beside or inside the recording.
    """
    folder, truth_file = out / request.name, truth / f"{request.name}.toml"
    if truth.resolve() == out.resolve() or folder.resolve() in (truth.resolve(), *truth.resolve().parents):
        raise RigError(f"{truth} would put the truth beside the recording; give --truth a folder of its own")
    for path in (folder, truth_file):
        if path.exists() and not force:
            raise RigError(f"{path} exists; remove it or use --force")
    check_folder(out)
    check_folder(truth)
    files, truth_text = _contents(request, dbc, progress)
    write_folder(folder, files, lambda _: write_file(truth_file, truth_text))  # both fit on the disk, or neither is new
    return folder, truth_file


def truth_of(request: Request) -> str:
    """The truth about a run without a second logger."""
    return _truth_toml(request, None)


def _contents(request: Request, dbc: Dbc, progress: Callable[[float], None]) -> tuple[dict[str, bytes], str]:
    """Content of every file of the recording's folder, and of the truth."""
    vehicle, seed, cycle, duration = request.vehicle, request.seed, request.cycle, request.duration
    random = stream(seed, cycle.name, "external")
    clocking = request.logger.clocking(duration, random) if request.kind == "bench" else None
    after = clocking.needs_after if clocking else MARGIN
    effects, faults, day = request.effects, request.faults, request.day
    run = simulate(vehicle, cycle, faults, seed, duration, effects=effects, day=day, after=after, progress=progress)
    can = candump(frames(request, dbc, [run]))
    files = {
        "recording.toml": _recording_toml(request, dbc).encode(),
        f"can.{request.format}": in_format(can, request.format),
        "uds.dbc": dbc.content,
    }
    if clocking:
        sensors, phases = fitted(vehicle, effects).external, stream(seed, cycle.name, "ripple")
        files["external.csv"] = external_csv(run, sensors, faults, duration, clocking, day, random, phases).encode()
    return files, _truth_toml(request, clocking)


def _recording_toml(request: Request, dbc: Dbc) -> str:
    external = _external_toml(request.vehicle) if request.kind == "bench" else ""
    return f"""schema = 1
id = {json.dumps(request.name)}
kind = "{"bench" if request.kind == "bench" else "instrumented"}"
source = "simulated by the faultline rig"
vehicle = {json.dumps(request.vehicle.name)}
cycle = {json.dumps(request.cycle.name)}
start = {START_TEXT}
sensor_set = "{"production" if request.kind == "production" else "instrumented"}"

[can]
file = "can.{request.format}"
dbc = "uds.dbc"
dbc_sha256 = "{dbc.sha256}"
{external}"""


def _external_toml(vehicle: Vehicle) -> str:
    tables = "".join(
        f"""
[external.tables.{signal}]
column = {json.dumps(sensor.column)}
volts = {list(sensor.volts)}
pascal = {list(sensor.pascal)}
"""
        for signal, sensor in vehicle.external.items()
    )
    return f"""
[external]
file = "external.csv"
time_column = "time_s"
unit = "V"
{tables}"""


def _truth_toml(request: Request, clocking: Clocking | None) -> str:
    """What was in the recording.

    `[day]`, where conditions differ from one drive to the next, says how (`Day.truth`).

    `[logger]`, for a bench, is what the second logger did (`Clocking`), and besides what an ideal synchronisation of
    its clock would find, exactly: can_time = offset_s + (1 + drift) logger_time, with logger_time as in the CSV (whose
    samples' own jitter is in it) and can_time in seconds after the first frame. A value in an ECU's frame is older than
    the frame by up to one of the ECU's periods, and by the effect `log_delay`: that belongs to the ECU, not to the
    clocks.
    """
    faults = "".join(
        f"""
[[fault]]
name = "{fault.name}"
size = {fault.size!r}
unit = "{UNITS.get(FAULTS[fault.name][1], "")}"
onset_s = {fault.onset_s!r}
profile = "{fault.profile}"
"""
        for fault in request.faults
    )
    logger = f"\n[logger]\n{_pairs(clocking.truth())}" if clocking else ""
    day = f"\n[day]\n{_pairs(request.day.truth())}" if request.day != CALM else ""
    return f"""schema = 1
recording = {json.dumps(request.name)}
{faults}
[effects]
{_pairs(checked(request.effects))}
[vehicle]
{_pairs(request.vehicle.scatter)}{day}{logger}"""


def _pairs(values: Mapping[str, float]) -> str:
    return "".join(f"{name} = {value!r}\n" for name, value in values.items())

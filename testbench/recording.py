"""The files of a recording, and its truth in another folder.

    OUT/<id>/recording.toml  can.log  external.csv  uds.dbc          what a bench would hand over (or can.blf ...)
    TRUTH/<id>.toml                                                  what only the rig knows

Equal requests give equal bytes, but for the head of ASC and TRC logs, where python-can writes the time of writing.
"""

import json
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from testbench.bus import Dbc
from testbench.can_logger import START_TEXT, can_log, in_format
from testbench.cycles import Cycle, check_duration
from testbench.effects import PROFILES, checked, fitted
from testbench.errors import RigError
from testbench.faults import Fault
from testbench.second_logger import Clocking, SecondLogger, external_csv
from testbench.simulation import simulate, stream
from testbench.vehicles import Vehicle


@dataclass(frozen=True)
class Request:
    """What to record: `duration` [s]; `name` is the recording's id, `effects` are the hidden ones with their sizes.

    `format` is that of the CAN log, one of `FORMATS`.

    Raises:
        RigError: the duration is too short for a cycle, a fault comes twice or sets in after it, an effect is unknown
            or has an impossible size.
    """

    name: str
    vehicle: Vehicle
    cycle: Cycle
    faults: tuple[Fault, ...]
    seed: int
    duration: float
    effects: Mapping[str, float] = field(default_factory=lambda: PROFILES["realistic"])
    format: str = "log"
    logger: SecondLogger = field(default_factory=SecondLogger)

    def __post_init__(self) -> None:
        check_duration(self.duration)
        checked(self.effects)
        names = [fault.name for fault in self.faults]
        for name in names:
            if names.count(name) > 1:
                raise RigError(f"fault {name} comes twice; give it once, with the size it is to have")
        for fault in self.faults:
            if not 0 <= fault.onset_s < self.duration:
                raise RigError(
                    f"onset {fault.onset_s:g} s of {fault.name} is not within the recording's {self.duration:g} s"
                )


def default_name(vehicle: str, cycle: str, seed: int, faults: Sequence[str]) -> str:
    """The recording's id, such as `bench-validation-s3-fA_du`."""
    return "-".join([vehicle, cycle, f"s{seed}", *faults])


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
    files, truth_text = _contents(request, dbc, progress)
    try:
        out.mkdir(parents=True, exist_ok=True)
        truth.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=out, prefix=".rig-") as temporary:
            whole = Path(temporary) / request.name
            whole.mkdir()
            for name, content in files.items():
                (whole / name).write_bytes(content)
            if folder.exists():
                shutil.rmtree(folder)
            whole.rename(folder)
        truth_file.write_text(truth_text)
    except OSError as error:
        raise RigError(f"{error.filename}: {error.strerror}") from error
    return folder, truth_file


def _contents(request: Request, dbc: Dbc, progress: Callable[[float], None]) -> tuple[dict[str, bytes], str]:
    """Content of every file of the recording's folder, and of the truth."""
    seed, cycle, duration, effects = request.seed, request.cycle, request.duration, request.effects
    random = stream(seed, cycle.name, "external")
    clocking = request.logger.clocking(duration, random)
    after = clocking.needs_after
    run = simulate(
        request.vehicle, cycle, request.faults, seed, duration, effects=effects, after=after, progress=progress
    )
    vehicle = fitted(request.vehicle, effects)
    can = can_log(run, dbc.senders, duration, stream(seed, cycle.name, "can"), vehicle.log_delay)
    external = external_csv(run, vehicle.external, request.faults, duration, clocking, random)
    files = {
        "recording.toml": _recording_toml(request, dbc).encode(),
        f"can.{request.format}": in_format(can, request.format),
        "external.csv": external.encode(),
        "uds.dbc": dbc.content,
    }
    return files, _truth_toml(request, clocking)


def _recording_toml(request: Request, dbc: Dbc) -> str:
    tables = "".join(
        f"""
[external.tables.{signal}]
column = {json.dumps(sensor.column)}
volts = {list(sensor.volts)}
pascal = {list(sensor.pascal)}
"""
        for signal, sensor in request.vehicle.external.items()
    )
    return f"""schema = 1
id = {json.dumps(request.name)}
kind = "bench"
source = "simulated by the faultline rig"
vehicle = {json.dumps(request.vehicle.name)}
cycle = {json.dumps(request.cycle.name)}
start = {START_TEXT}
sensor_set = "instrumented"

[can]
file = "can.{request.format}"
dbc = "uds.dbc"
dbc_sha256 = "{dbc.sha256}"

[external]
file = "external.csv"
time_column = "time_s"
unit = "V"
{tables}"""


def _truth_toml(request: Request, clocking: Clocking) -> str:
    """What was in the recording.

    `[logger]` is what the second logger did (`Clocking`), and besides what an ideal synchronisation of its clock would
    find, exactly: can_time = offset_s + (1 + drift) logger_time, with logger_time as in the CSV (whose samples' own
    jitter is in it) and can_time in seconds after the first frame. A value in an ECU's frame is older than the frame
    by up to one of the ECU's periods, and by the effect `log_delay`: that belongs to the ECU, not to the clocks.
    """
    faults = "".join(
        f"""
[[fault]]
name = "{fault.name}"
size = {fault.size!r}
onset_s = {fault.onset_s!r}
profile = "{fault.profile}"
"""
        for fault in request.faults
    )
    return f"""schema = 1
recording = {json.dumps(request.name)}
{faults}
[effects]
{_pairs(checked(request.effects))}
[vehicle]
{_pairs(request.vehicle.scatter)}
[logger]
{_pairs(clocking.truth())}"""


def _pairs(values: Mapping[str, float]) -> str:
    return "".join(f"{name} = {value!r}\n" for name, value in values.items())

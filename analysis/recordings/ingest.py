"""A bench recording to an instrumented one: volts to pascal, the second logger's clock, the sensors' zero, frames."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from cantools.database import load_string
from cantools.database.can import Database

from analysis.recordings.clock import Clock, Track, synchronise
from analysis.recordings.external import Samples, read_external
from analysis.recordings.frames import candump, sensor_frames, sensor_message
from analysis.recordings.uniform import uniform
from analysis.recordings.zero import standstill, zero_error
from service.core.decode import compile_dbc
from service.core.errors import InputError
from service.core.signals import Quality, Vector
from service.logs import Frame, LogReport, Recording, load_recording, read_log

REFERENCE = "y_p_ap"
"""The added sensor that the controller's own y_p_du can be aligned with."""

ECU_UNITS = {"y_p_du": "Pa", "n_p": "1/s", "dc_dose": "1"}


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """What `ingest` found. CAN time = `offset_s` + (1 + `drift_ppm` / 1e6) * logger time, both from their first sample.

    `zero_pa` is each added sensor's zero error, null where it could not be calibrated and the datasheet's zero stands;
    `standstill_s` the length of the section it comes from. `correlation` is that of the aligned, high-passed pressures,
    `clock_spread_s` the RMS of the offsets of `clock_windows` windows. `outside` samples lay beyond the CAN log's ends.
    """

    id: str
    offset_s: float
    drift_ppm: float
    correlation: float
    clock_spread_s: float
    clock_windows: int
    standstill_s: float
    zero_pa: dict[str, float | None]
    can_frames: int
    can_lost: str | None
    samples: int
    outside: int
    bad_rows: int
    bad_cells: int
    first_bad_row: str | None


class Ingested(NamedTuple):
    """An instrumented recording: the content of every file by name, and the report."""

    files: dict[str, bytes]
    report: Report


class _Ecu(NamedTuple):
    """The controller's own samples: `t` (N,) [s] after the first frame, signals (N,) in SI units."""

    t: Vector
    y_p_du: Vector
    n_p: Vector
    dc_dose: Vector


def ingest(folder: Path, say: Callable[[str], None]) -> Ingested:
    """Makes an instrumented recording of the bench recording in `folder`; `say` hears what is going on.

    Raises:
        InputError: it is no bench recording, lacks a file, column, message or signal, or cannot be aligned.
    """
    recording = load_recording(folder)
    if recording.external is None:
        raise InputError(f"{folder}: kind is {recording.kind}, already ingested; use it as it is")
    if REFERENCE not in recording.external.tables:
        raise InputError(f"{folder}: external.tables has no {REFERENCE}, which the clocks are aligned by")
    say("reading the CAN log")
    dbc = (folder / recording.can.dbc).read_bytes()
    frames, log = read_log(folder / recording.can.file)
    ecu = _ecu(frames, dbc, folder, recording)
    say("reading the second logger")
    samples = read_external(folder, recording.external)
    say("aligning the clocks")
    clock = synchronise(
        _known(samples.t, samples.pressures[REFERENCE], f"{folder / recording.external.file}: {REFERENCE}"),
        Track(ecu.t, ecu.y_p_du),
        ecu.dc_dose,
        str(folder),
    )
    t = clock.can_time(samples.t)
    end = standstill(ecu.t, ecu.n_p, ecu.y_p_du)
    zero = {signal: zero_error(pressure[(t >= 0) & (t <= end)]) for signal, pressure in samples.pressures.items()}
    pressures = {signal: pressure - (zero[signal] or 0.0) for signal, pressure in samples.pressures.items()}
    say("writing")
    inside = (t >= 0) & (t <= frames[-1].t - frames[0].t)
    report = _report(recording, clock, zero, end, log, samples, inside)
    within = {signal: pressure[inside] for signal, pressure in pressures.items()}
    text = _can_log(frames, dbc, t[inside], within, folder / recording.can.dbc)
    return Ingested(
        {
            "recording.toml": _toml(recording).encode(),
            "can.log": text.encode(),
            "uds.dbc": dbc,
            "uniform.csv": _uniform(ecu, t, pressures).encode(),
            "ingest.json": msgspec.json.format(msgspec.json.encode(report)) + b"\n",
        },
        report,
    )


def _ecu(frames: list[Frame], dbc: bytes, folder: Path, recording: Recording) -> _Ecu:
    """Samples with all three signals; they come in one frame."""
    table = compile_dbc(dbc.decode(errors="replace"), ECU_UNITS, str(folder / recording.can.dbc))
    rows = []
    for t, can_id, extended, data in frames:
        signals = {
            name: value for name, value, quality in table.decode(can_id, extended, data) if quality is Quality.GOOD
        }
        if len(signals) == len(ECU_UNITS):
            rows.append((t - frames[0].t, *(signals[name] for name in ECU_UNITS)))
    increasing = np.array(rows).reshape(-1, 1 + len(ECU_UNITS))
    increasing = increasing[np.diff(increasing[:, 0], prepend=-1.0) > 0]
    if len(increasing) < 2:
        raise InputError(
            f"{folder / recording.can.file}: no frame carries {', '.join(ECU_UNITS)}; was the dosing controller on?"
        )
    return _Ecu(*increasing.T)


def _known(t: Vector, value: Vector, where: str) -> Track:
    good = np.isfinite(value)
    if good.sum() < 2:
        raise InputError(f"{where}: no value within its table; check the column, its unit (V) and the table")
    return Track(t[good], value[good])


def _report(
    recording: Recording,
    clock: Clock,
    zero: dict[str, float | None],
    end: float,
    log: LogReport,
    samples: Samples,
    inside: np.ndarray[tuple[int], np.dtype[np.bool_]],
) -> Report:
    return Report(
        id=recording.id,
        offset_s=round(clock.offset_s, 4),
        drift_ppm=round(clock.drift * 1e6, 2),
        correlation=round(clock.correlation, 4),
        clock_spread_s=round(clock.spread_s, 4),
        clock_windows=clock.windows,
        standstill_s=round(end, 3),
        zero_pa={signal: None if error is None else round(error, 1) for signal, error in zero.items()},
        can_frames=log.frames,
        can_lost=log.summary() if log.lost else None,
        samples=len(samples.t),
        outside=int((~inside).sum()),
        bad_rows=samples.bad_rows,
        bad_cells=samples.bad_cells,
        first_bad_row=samples.told or None,
    )


def _can_log(frames: list[Frame], dbc: bytes, t: Vector, pressures: dict[str, Vector], path: Path) -> str:
    database = load_string(dbc.decode(), "dbc", strict=True)
    assert isinstance(database, Database)  # compile_dbc has read it
    message = sensor_message(database, pressures, str(path))
    own = [frame for frame in frames if frame.can_id != message.frame_id]
    if len(own) < len(frames):
        raise InputError(f"{path.parent}: the CAN log of a bench recording already has {message.name} frames")
    added = sensor_frames(message, frames[0].t + t, pressures)
    return candump(sorted([*frames, *added], key=lambda frame: frame.t))


def _uniform(ecu: _Ecu, t: Vector, pressures: dict[str, Vector]) -> str:
    tracks = {signal: _known(t, pressure, signal) for signal, pressure in sorted(pressures.items(), reverse=True)}
    tracks |= {name: Track(ecu.t, getattr(ecu, name)) for name in ECU_UNITS}
    grid, signals = uniform(tracks)
    rows = zip(grid.tolist(), *(values.tolist() for values in signals.values()), strict=True)
    lines = [f"{time:.1f}," + ",".join(f"{value:.6g}" for value in values) for time, *values in rows]
    return "\n".join([",".join(["t", *tracks]), *lines, ""])


def _toml(recording: Recording) -> str:
    def quoted(text: str) -> str:
        return msgspec.json.encode(text).decode()  # a JSON string is a TOML string

    start = f"start = {recording.start.isoformat()}\n" if recording.start else ""
    return f"""schema = 1
id = {quoted(recording.id)}
kind = "instrumented"
source = {quoted(f"{recording.source}; ingested")}
vehicle = {quoted(recording.vehicle)}
cycle = {quoted(recording.cycle)}
{start}sensor_set = "{recording.sensor_set}"

[can]
file = "can.log"
dbc = "uds.dbc"
dbc_sha256 = "{recording.can.dbc_sha256}"
"""

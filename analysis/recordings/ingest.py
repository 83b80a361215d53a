"""A bench recording to an instrumented one: volts to pascal, the second logger's clock, the sensors' zero, frames."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from cantools.database import load_string
from cantools.database.can import Database

from faultline.analysis.model.bench import BenchSetup
from faultline.analysis.recordings.bench import Bench, read_bench
from faultline.analysis.recordings.clock import Clock, ClockError, given, synchronise
from faultline.analysis.recordings.external import STUCK
from faultline.analysis.recordings.frames import candump, clipped, sensor_frames, sensor_message
from faultline.analysis.recordings.lags import likeness
from faultline.analysis.recordings.picture import picture
from faultline.analysis.recordings.report import Report, Source, Standstill, report
from faultline.analysis.recordings.track import known_part
from faultline.analysis.recordings.uniform import uniform
from faultline.analysis.recordings.zero import ATMOSPHERE, ambient_seen, check_drop, check_level, standstill, zero_error
from faultline.service.core.errors import InputError
from faultline.service.core.signals.dbc_text import dbc_text
from faultline.service.core.signals.values import FloatArray

SAME_PRESSURE = 0.9
"""Correlation from which on a column is the follower's; that of a pressure elsewhere in the system stays far below."""


class Ingested(NamedTuple):
    """An instrumented recording: the content of every file by name, and the report."""

    files: dict[str, bytes]
    report: Report


def ingest(
    folder: Path,
    setup: BenchSetup,
    say: Callable[[str], None],
    by_hand: tuple[float, float] | None = None,
    ambient: float | None = None,
) -> Ingested:
    """Makes an instrumented recording of the bench recording in `folder`; `say` hears what is going on.

    `setup` says how the system is measured there.

    `by_hand` is the second logger's offset [s] and drift, `ambient` the pressure around the bench [Pa], where they are
    known better.

    Raises:
        InputError: it is no bench recording, lacks a file, column, message or signal, or cannot be aligned for certain.
    """
    say("reading both logs")
    bench = read_bench(folder, setup)
    say("aligning the clocks")
    clock = _clock(bench, by_hand)
    check_drop(bench.follower.value, bench.reference.value, setup, f"{folder}: {setup.follower}")
    t = clock.can_time(bench.samples.t)
    drive, reference = bench.ecu.track(setup.drive), bench.reference
    end = standstill(drive.t, drive.value, np.interp(drive.t, *reference), setup, ambient or ATMOSPHERE)
    channels = bench.samples.channels
    still = {signal: channel.pressure[(t >= 0) & (t <= end)] for signal, channel in channels.items()}
    around = ambient or ambient_seen(still.values(), reference.value[reference.t <= end], setup)
    pressures, zero = {}, {}
    for signal, channel in channels.items():
        check_level(still[signal], setup, f"{folder}: {signal}", around)
        zero[signal] = zero_error(still[signal], setup, around)
        pressures[signal] = channel.pressure - (zero[signal] or 0.0)
    say("writing")
    inside = (t >= 0) & (t <= bench.length_s)
    text, beyond = _can_log(bench, t[inside], {signal: pressure[inside] for signal, pressure in pressures.items()})
    source: Source = "given" if ambient else "assumed" if around == ATMOSPHERE else "seen"
    found = report(bench, clock, Standstill(round(end, 3), round(around, 1), source), zero, beyond)
    return Ingested(
        {
            "recording.toml": _toml(bench).encode(),
            "can.log": text.encode(),
            Path(bench.recording.can_log.dbc).name: bench.dbc,
            "uniform.csv": _uniform(bench, t, pressures).encode(),
            "synchronisation.png": picture(bench.follower, reference, clock, setup, bench.recording.id),
            "ingest.json": msgspec.json.format(msgspec.json.encode(found)) + b"\n",
        },
        found,
    )


def _clock(bench: Bench, by_hand: tuple[float, float] | None) -> Clock:
    if by_hand is not None:
        clock = given(bench.follower, bench.reference, *by_hand)
        t = clock.can_time(bench.samples.t)
        if t[-1] <= 0 or t[0] >= bench.length_s:
            raise ClockError(
                f"{bench.where}: with an offset of {clock.offset_s:g} s the second logger ran from {t[0]:.1f} to "
                f"{t[-1]:.1f} s, the CAN log from 0 to {bench.length_s:.1f} s; nothing overlaps: check --offset"
            )
        return clock
    still = bench.reference.value
    if np.ptp(still) <= STUCK * abs(float(still.max())):
        raise ClockError(
            f"{bench.where}: {bench.setup.reference} is constant at {still[0] / 1e5:.3f} bar; the controller's sensor "
            "is stuck, and nothing else tells the second logger's clock: give it with --offset SECONDS"
        )
    try:
        command = bench.ecu.track(bench.setup.command)
        clock = synchronise(bench.follower, bench.reference, command, bench.setup, str(bench.where))
    except ClockError:
        _check_columns(bench)
        raise
    if not clock.confident:
        _check_columns(bench)
        raise ClockError(
            f"{bench.where}: the clocks cannot be aligned for certain: {clock.doubt}; the best guess is --offset "
            f"{clock.offset_s:.3f} --drift {clock.drift * 1e6:.0f}: look at a pressure step and give --offset SECONDS"
        )
    return clock


def _check_columns(bench: Bench) -> None:
    """Says so where another column than the follower's follows, or its level tells of another table."""
    setup = bench.setup
    for signal, channel in bench.samples.channels.items():
        track = known_part(bench.samples.t, channel.pressure)
        alike = np.nanmax(likeness(track, bench.reference).correlation, initial=0.0)
        if signal != setup.follower and alike > SAME_PRESSURE:
            raise ClockError(
                f"{bench.where}: the column of {signal} follows the CAN log's {setup.reference}, that of "
                f"{setup.follower} does not; the two are swapped: exchange their columns in external.tables"
            )
    check_drop(bench.follower.value, bench.reference.value, setup, f"{bench.where}: {setup.follower}")


def _can_log(bench: Bench, t: FloatArray, pressures: dict[str, FloatArray]) -> tuple[str, dict[str, int]]:
    """The log with the added sensors' frames, and how many samples of each are beyond its range on CAN."""
    database = load_string(dbc_text(bench.dbc), "dbc", strict=False)
    assert isinstance(database, Database)  # compile_dbc has read it
    message = sensor_message(database, bench.setup.message, pressures, str(bench.where / bench.recording.can_log.dbc))
    own = [frame for frame in bench.frames if frame.can_id != message.frame_id]
    if len(own) < len(bench.frames):
        raise InputError(f"{bench.where}: the CAN log of a bench recording already has {message.name} frames")
    added = sensor_frames(message, bench.frames[0].t + t, pressures)
    return candump(sorted([*bench.frames, *added], key=lambda frame: frame.t)), clipped(message, pressures)


def _uniform(bench: Bench, t: FloatArray, pressures: dict[str, FloatArray]) -> str:
    tracks = {signal: known_part(t, pressure) for signal, pressure in sorted(pressures.items(), reverse=True)}
    tracks |= {name: bench.ecu.track(name) for name in bench.setup.units}
    grid, signals = uniform(tracks)
    rows = zip(grid.tolist(), *(values.tolist() for values in signals.values()), strict=True)
    lines = [
        ",".join([f"{time:.1f}", *(f"{value:.6g}" if np.isfinite(value) else "" for value in values)])
        for time, *values in rows
    ]
    return "\n".join([",".join(["t", *tracks]), *lines, ""])


def _toml(bench: Bench) -> str:
    recording = bench.recording

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
dbc = {quoted(Path(recording.can_log.dbc).name)}
dbc_sha256 = "{recording.can_log.dbc_sha256}"
bench_sha256 = "{bench.sha256}"
"""

"""What `ingest` found and did, to each channel and to the clocks: for a program, and in sentences."""

from typing import Literal, NamedTuple

import msgspec

from faultline.analysis.model.bench import BenchSetup
from faultline.analysis.recordings.bench import Bench
from faultline.analysis.recordings.clock import MINIMUM_CORRELATION, Clock
from faultline.analysis.recordings.track import Track, known_part
from faultline.analysis.recordings.uniform import PERIOD_S
from faultline.analysis.recordings.zero import ATMOSPHERE, WEATHER
from faultline.service.logs.recording import Table

RESAMPLED = f"{1 / PERIOD_S:g} Hz behind a zero-phase FIR low-pass, empty in gaps"


class ChannelReport(msgspec.Struct, frozen=True, kw_only=True):
    """One channel. `clock` is whose times its samples came with; all times here are CAN times [s].

    `samples` have a value, at a median of `rate_hz`; each of `gaps` is a silence from, to [s]. Of an added sensor:
    `table` is what its volts went through, `blank` cells held no number, `outside_table` ones lay beyond the table,
    `clipped` samples beyond the range of the signal on CAN, where they are not available. `zero_pa` was taken off every
    sample, null where the datasheet's zero stands.
    """

    signal: str
    clock: str
    samples: int
    rate_hz: float
    gaps: list[tuple[float, float]]
    table: str | None = None
    blank: int = 0
    outside_table: int = 0
    clipped: int = 0
    zero_pa: float | None = None
    resampled: str = RESAMPLED


Source = Literal["assumed", "given", "seen"]


class Standstill(NamedTuple):
    """The section that zeros come from: its end [s], 0 where there is none, and the ambient pressure [Pa] in it."""

    end_s: float
    ambient_pa: float
    source: Source


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """What `ingest` found. CAN time = `offset_s` + (1 + `drift_ppm` / 1e6) * logger time, as in the logger's file.

    `clock` says how these were found: synchronised, or given. `clock_error_s` is the standard error of the alignment,
    null where given; `correlation` that of the aligned, high-passed pressures; of `clock_windows_telling` windows
    `clock_windows` agree. `slow_reference_s` is the time constant that the reference's sensor seems to have.
    `standstill_s` is the length of the section that the zeros come from, `ambient_pa` the pressure that they are
    relative to, and `ambient` says why: the standard one is assumed, it was given, or all sensors show it. `outside`
    samples lay beyond the CAN log's ends.
    """

    id: str
    clock: str
    offset_s: float
    drift_ppm: float
    clock_error_s: float | None
    correlation: float
    clock_windows: int
    clock_windows_telling: int
    slow_reference_s: float
    standstill_s: float
    ambient_pa: float
    ambient: Source
    can_frames: int
    can_lost: str | None
    samples: int
    outside: int
    bad_rows: int
    first_bad_row: str | None
    channels: list[ChannelReport]


def report(
    bench: Bench, clock: Clock, standstill: Standstill, zero: dict[str, float | None], clipped: dict[str, int]
) -> Report:
    """The report; `zero` [Pa] and the `clipped` samples are by added sensor."""
    t = clock.can_time(bench.samples.t)
    inside = (t >= 0) & (t <= bench.length_s)
    added = [
        _channel(signal, "second logger", known_part(t, channel.pressure),
            table=_table(channel.table),
            blank=channel.blank,
            outside_table=channel.outside,
            clipped=clipped[signal],
            zero_pa=_rounded(zero[signal], 1),
        )
        for signal, channel in bench.samples.channels.items()
    ]  # fmt: skip
    return Report(
        id=bench.recording.id,
        clock="given" if clock.error_s is None else "synchronised",
        offset_s=round(clock.offset_s, 4),
        drift_ppm=round(clock.drift * 1e6, 2),
        clock_error_s=_rounded(clock.error_s, 4),
        correlation=round(clock.correlation, 4),
        clock_windows=len(clock.windows),
        clock_windows_telling=len(clock.windows) + len(clock.straying),
        slow_reference_s=round(clock.slow_s, 3),
        standstill_s=standstill.end_s,
        ambient_pa=standstill.ambient_pa,
        ambient=standstill.source,
        can_frames=bench.log.frames,
        can_lost=bench.log.summary() if bench.log.lost else None,
        samples=len(t),
        outside=int((~inside).sum()),
        bad_rows=bench.samples.bad_rows,
        first_bad_row=bench.samples.told or None,
        channels=[*added, *(_channel(name, "CAN", bench.ecu.track(name)) for name in bench.setup.units)],
    )


def _channel(signal: str, clock: str, track: Track, **more: object) -> ChannelReport:
    gaps = [(round(begin, 2), round(end, 2)) for begin, end in track.gaps()]
    rate = round(1.0 / track.period_s, 2)
    fields = {"signal": signal, "clock": clock, "samples": len(track.t), "rate_hz": rate, "gaps": gaps}
    return msgspec.convert({**fields, **more}, ChannelReport)


def _table(table: Table) -> str:
    return (
        f"{table.column}: {len(table.volts)} points, {table.volts[0]:g}..{table.volts[-1]:g} V to "
        f"{table.pascal[0] / 1e5:g}..{table.pascal[-1] / 1e5:g} bar"
    )


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


def sentences(found: Report, setup: BenchSetup) -> list[str]:
    """The report for a reader, a line a matter."""
    clock = f"clock: offset {found.offset_s:+.3f} s, drift {found.drift_ppm:+.1f} ppm "
    if found.clock_error_s is None:
        clock += f"(given; correlation {found.correlation:.3f})"
        if found.correlation < MINIMUM_CORRELATION:
            clock += (
                f": {setup.follower} DOES NOT FOLLOW {setup.reference} with it, look at synchronisation.png and check "
                "--offset"
            )
    else:
        clock += (
            f"(standard error {1e3 * found.clock_error_s:.0f} ms; {found.clock_windows} of "
            f"{found.clock_windows_telling} windows agree, correlation {found.correlation:.3f})"
        )
    lines = [f"{found.can_frames} CAN frames, {found.samples - found.outside} sensor frames", clock]
    if found.slow_reference_s:
        lines.append(f"the sensor of {setup.reference} is slow: time constant about {found.slow_reference_s:.2f} s")
    if not found.standstill_s:
        lines.append(
            f"no standstill at {found.ambient_pa / 100:.0f} hPa at the start: the sensors keep their datasheet's zero"
        )
    lines += _ambient(found, setup)
    lines += [_line(channel) for channel in found.channels]
    if found.bad_rows:
        lines.append(f"second logger: {found.bad_rows} bad rows (first: {found.first_bad_row})")
    if found.can_lost:
        lines.append(f"CAN log: {found.can_lost}")
    return lines


def _ambient(found: Report, setup: BenchSetup) -> list[str]:
    """Return what follows from an ambient pressure other than the standard one, and what is doubtful of it."""
    lines = []
    if found.ambient == "seen":
        lines.append(
            f"DOUBTFUL: at standstill all sensors show about {found.ambient_pa / 100:.0f} hPa, {setup.reference} too, "
            f"not {ATMOSPHERE / 100:.0f}: taken for the ambient pressure, only what differs from it was taken off; "
            "confirm it with --ambient-hpa"
        )
    taken = [each.zero_pa for each in found.channels if each.zero_pa is not None]
    if found.ambient == "assumed" and len(taken) > 1 and (min(taken) > WEATHER or max(taken) < -WEATHER):
        lines.append(
            f"DOUBTFUL: all added sensors are off alike from {ATMOSPHERE / 100:.0f} hPa, as by another ambient "
            f"pressure, though {setup.reference}, which the controller may trim, is not; if it was, give it with "
            "--ambient-hpa"
        )
    if setup.ambient and abs(found.ambient_pa - ATMOSPHERE) > WEATHER:
        lines.append(
            f"before calibrating, set the model's ambient pressures ({', '.join(setup.ambient)}) to "
            f"{found.ambient_pa:.0f} Pa; the standard one is {ATMOSPHERE:.0f} Pa"
        )
    return lines


def _line(channel: ChannelReport) -> str:
    parts = [f"{channel.signal}: {channel.samples} samples at {channel.rate_hz:g} Hz on the clock of {channel.clock}"]
    if channel.table:
        parts += [channel.table]
        zero = channel.zero_pa
        parts += ["zero not calibrated (datasheet)" if zero is None else f"zero {zero / 100:+.1f} mbar taken off"]
    for count, what in (
        (channel.blank, "cells without a value"),
        (channel.outside_table, "cells outside the table"),
        (channel.clipped, "samples outside the range on CAN"),
    ):
        if count:
            parts.append(f"{count} {what}")
    if channel.gaps:
        shown = ", ".join(f"{begin:.1f}..{end:.1f}" for begin, end in channel.gaps[:3])
        more = ", ..." if len(channel.gaps) > 3 else ""
        silent = sum(end - begin for begin, end in channel.gaps)
        parts.append(f"silent {len(channel.gaps)} times for {silent:.1f} s ({shown}{more} s), left empty")
    return "; ".join(parts)

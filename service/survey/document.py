"""What `faultline log --json` prints."""

from collections.abc import Mapping, Sequence

import msgspec

from faultline.service.core.j1939.identifiers import SOURCE_MASK, group_of
from faultline.service.logs import Log
from faultline.service.survey.columns import ColumnRow
from faultline.service.survey.signals import SignalRow
from faultline.service.survey.traffic import MessageTraffic

SCHEMA = "faultline.log/1"


class BadPlace(msgspec.Struct):
    """A place that could not be read: its number, in the report's unit, and why."""

    number: int
    reason: str


class Damage(msgspec.Struct):
    """What could not be used as it stands.

    `places` are the first of `bad` places, numbered by `unit` (line, byte, row or record), of `lost_bytes` bytes where
    that is known. `missing` and `compression` say how the end is missing and how the compression is damaged.
    """

    bad: int
    unit: str
    places: list[BadPlace]
    lost_bytes: int
    last_line_cut: bool
    missing: str
    compression: str
    clock_steps: int
    outliers: int
    sentences: list[str]


class ChannelRow(msgspec.Struct):
    """A channel: its data frames, and those without data (remote and error frames)."""

    name: str
    frames: int
    without_data: int


class GapRow(msgspec.Struct):
    """A silence of a message: when it began, after the first frame [s], and how long it was [s]."""

    at_s: float
    for_s: float


class MessageRow(msgspec.Struct):
    """The data frames of an identifier on a channel; `pgn`, `sender` and `priority` as J1939's where it has 29 bits.

    `rate_hz` over all of the time between the first frame and the last, `period_s` the median from frame to frame.
    """

    channel: str
    identifier: str
    is_extended: bool
    count: int
    pgn: int | None
    sender: int | None
    priority: int | None
    first_s: float
    last_s: float
    rate_hz: float | None
    period_s: float | None
    shortest: int
    longest: int
    gaps: list[GapRow]


class SenderRow(msgspec.Struct):
    """A source address of J1939 on a channel: its frames and parameter groups."""

    channel: str
    address: int
    frames: int
    groups: list[int]


class Survey(msgspec.Struct):
    """A log: its format, what was read, channels, messages, senders, damage, and the signals that were asked for.

    Of a table of values, `frames` are its rows, and `columns` what they hold.
    """

    schema: str
    file: str
    format: str
    has_times: bool
    start_s: float
    length_s: float
    said_s: float | None
    frames: int
    remote: int
    errors: int
    others: int
    is_damaged: bool
    damage: Damage
    channels: list[ChannelRow]
    messages: list[MessageRow]
    senders: list[SenderRow]
    columns: list[ColumnRow]
    signals: list[SignalRow]


def survey_of(
    log: Log,
    messages: Sequence[MessageTraffic],
    without_data: Mapping[int, int],
    names: Sequence[str],
    columns: list[ColumnRow],
    signals: list[SignalRow],
) -> Survey:
    """The document of a log."""
    report = log.report
    return Survey(
        schema=SCHEMA,
        file=str(log.source.path),
        format=log.format.name,
        has_times=log.format.has_times,
        start_s=log.start_s,
        length_s=report.length_s,
        said_s=report.said_s,
        frames=report.frames,
        remote=report.remote,
        errors=report.errors,
        others=report.others,
        is_damaged=report.damaged,
        damage=_damage(log),
        channels=[
            ChannelRow(name, sum(each.count for each in messages if each.channel == k), without_data.get(k, 0))
            for k, name in enumerate(names)
            if log.channel is None or any(each.channel == k for each in messages) or k in without_data
        ],
        messages=[_row(each, names, report.length_s, log.format.has_times) for each in messages],
        senders=_senders(messages, names),
        columns=columns,
        signals=signals,
    )


def _damage(log: Log) -> Damage:
    report = log.report
    return Damage(
        bad=report.bad,
        unit=report.unit,
        places=[BadPlace(*each) for each in report.places],
        lost_bytes=report.lost_bytes,
        last_line_cut=report.truncated,
        missing=report.missing,
        compression=report.packing,
        clock_steps=report.clock_steps,
        outliers=report.outliers,
        sentences=report.losses(),
    )


def _row(message: MessageTraffic, names: Sequence[str], end_s: float, has_times: bool) -> MessageRow:
    number, is_extended = message.identifier, message.is_extended
    return MessageRow(
        channel=names[message.channel],
        identifier=f"{number:08X}" if is_extended else f"{number:03X}",
        is_extended=is_extended,
        count=message.count,
        pgn=group_of(number) if is_extended else None,
        sender=number & SOURCE_MASK if is_extended else None,
        priority=number >> 26 if is_extended else None,
        first_s=round(message.first_s, 6),
        last_s=round(message.last_s, 6),
        rate_hz=message.rate if has_times else None,
        period_s=message.period_s if has_times else None,
        shortest=message.shortest,
        longest=message.longest,
        gaps=[GapRow(round(at, 6), round(length, 6)) for at, length in message.gaps(end_s)] if has_times else [],
    )


def _senders(messages: Sequence[MessageTraffic], names: Sequence[str]) -> list[SenderRow]:
    found: dict[tuple[int, int], SenderRow] = {}
    for each in messages:
        if each.is_extended:
            address = each.identifier & SOURCE_MASK
            sender = found.setdefault((each.channel, address), SenderRow(names[each.channel], address, 0, []))
            sender.frames += each.count
            sender.groups = sorted({*sender.groups, group_of(each.identifier)})
    return [found[key] for key in sorted(found)]

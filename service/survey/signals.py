"""Which signals of a DBC are in a log, and why others are not."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import msgspec

from faultline.service.core.j1939.identifiers import FRAME, SOURCE_MASK, group_of, named
from faultline.service.core.signals.dbc_messages import Described
from faultline.service.core.signals.decode import DecodeTable
from faultline.service.core.signals.layout import Layout
from faultline.service.core.signals.values import Quality
from faultline.service.survey.traffic import MessageTraffic, WholeMessages


class SignalRow(msgspec.Struct):
    """A signal: whether it is in the log, where, from which senders, and why not."""

    signal: str
    message: str
    identifier: str
    is_there: bool
    channels: list[str]
    senders: list[int]
    why: str


class Contents(NamedTuple):
    """A log's messages, those that came in parts, those of channels that were not chosen, and the channels' names."""

    messages: Sequence[MessageTraffic]
    parts: WholeMessages
    elsewhere: Mapping[str, set[tuple[int, bool]]]
    names: Sequence[str]


def parts_of(described: Collection[Described]) -> WholeMessages:
    """Return what puts together those messages that are too long for a frame of J1939."""
    long = [each for each in described if each.layout is not None and each.layout.j1939 and each.layout.size > FRAME]
    tables = [(each.name, _table(each.layout, each.is_extended)) for each in long if each.layout is not None]

    def name_of(identifier: int) -> str | None:
        return next((name for name, table in tables if table.layout_of(identifier, True) is not None), None)

    return WholeMessages(name_of)


def find_signals(described: Collection[Described], contents: Contents) -> list[SignalRow]:
    """Return each signal of the messages."""
    return [row for each in described for row in _of_message(each, contents)]


def absent(signals: Collection[str]) -> list[SignalRow]:
    """Return signals that no message of the DBC has."""
    return [SignalRow(name, "", "", False, [], [], "the DBC has no such signal") for name in sorted(signals)]


def on_unknown_bus(described: Collection[Described], bus: str) -> list[SignalRow]:
    """Return the signals of messages on a bus of which it is not known which channel of the log it is."""
    why = f"it comes on bus {bus}: say which channel that is with --channel {bus}=CHANNEL"
    return [SignalRow(name, each.name, _shown(each), False, [], [], why) for each in described for name in each.signals]


def _shown(message: Described) -> str:
    return f"{message.identifier:08X}" if message.is_extended else f"{message.identifier:03X}"


def _of_message(message: Described, contents: Contents) -> Iterator[SignalRow]:
    identifier = _shown(message)
    if message.layout is None:
        yield from (SignalRow(name, message.name, identifier, False, [], [], message.why) for name in message.signals)
        return
    table = _table(message.layout, message.is_extended)
    came = [*contents.messages, *contents.parts.messages.values()]
    same = [each for each in came if table.layout_of(each.identifier, each.is_extended) is not None]
    channels = sorted({contents.names[each.channel] for each in same})
    senders = sorted({each.identifier & SOURCE_MASK for each in same}) if message.is_extended else []
    why = _short(message.layout, same) if same else _absent(message, message.layout, table, contents)
    qualities = _qualities(message, message.layout, table, same)
    for name in message.signals:
        is_there = not why and Quality.GOOD in qualities[name]
        reason = "" if is_there else why or _never(qualities[name])
        yield SignalRow(name, message.name, identifier, is_there, channels, senders, reason)


def _table(layout: Layout, is_extended: bool) -> DecodeTable:
    """A table of one message: what another one of the DBC has in common with it is no matter."""
    return DecodeTable({(layout.identifier, is_extended): layout})


def _short(layout: Layout, same: Sequence[MessageTraffic]) -> str:
    """Say so where no frame is as long as the DBC has it."""
    if any(length >= layout.size for each in same for length in each.lengths):
        return ""
    return f"all {sum(each.count for each in same)} frames are shorter than the {layout.size} bytes of the DBC"


def _never(qualities: Collection[Quality]) -> str:
    if not qualities:
        return "no frame has it"
    words = ", ".join(each.name.lower().replace("_", " ") for each in sorted(qualities))
    return f"its values are never valid ({words})"


def _absent(message: Described, layout: Layout, table: DecodeTable, contents: Contents) -> str:
    """Why no frame is its."""
    others = [
        channel
        for channel, identifiers in contents.elsewhere.items()
        if any(table.layout_of(*each) is not None for each in identifiers)
    ]
    if others:
        return f"it is on channel {' and '.join(others)}"
    if losses := contents.parts.losses(message.name):
        return f"its parts were never all there: {_counted(losses)}"
    if layout.j1939 and message.is_extended and not layout.is_from_any:
        came = {each.identifier for each in contents.messages if each.is_extended} | contents.parts.announced
        senders = {each & SOURCE_MASK for each in came if group_of(each) == group_of(layout.identifier)}
        if senders:
            there = ", ".join(map(named, sorted(senders)))
            return f"its parameter group came from {there}, not from {named(layout.identifier & SOURCE_MASK)}"
    return "no such message"


def _counted(losses: Counter[str]) -> str:
    return ", ".join(f"{count} {why}" for why, count in sorted(losses.items()))


def _qualities(
    message: Described, layout: Layout, table: DecodeTable, same: Sequence[MessageTraffic]
) -> dict[str, set[Quality]]:
    """What each signal was worth in the frames that were kept, until all were good."""
    found: dict[str, set[Quality]] = {name: set() for name in message.signals}
    for data in {data for each in same for data in each.data}:
        for name, _, quality in table.decode(layout.identifier, message.is_extended, data):
            found[name].add(quality)
        if all(Quality.GOOD in each for each in found.values()):
            break
    return found

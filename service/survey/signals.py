"""Which signals of a DBC are in a log, and why others are not."""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import msgspec
from cantools.database import load_string
from cantools.database.can import Database
from cantools.database.can import Message as DbcMessage
from cantools.database.errors import Error as DatabaseError

from faultline.service.core.errors import InputError
from faultline.service.core.j1939.identifiers import PRIORITY_MASK
from faultline.service.core.signals.values import Quality, j1939_quality
from faultline.service.survey.traffic import Message

_SENDER = 0xFF
_ANY_SENDER = 0xFE  # the null address: vendors' DBCs have it where any sender is meant
_GROUP_OF_ALL = 240  # PDU format from which on a group has no destination (SAE J1939-21)


class Found(msgspec.Struct):
    """A signal: whether it is in the log, where, from which senders, and why not."""

    signal: str
    message: str
    identifier: str
    is_there: bool
    channels: list[str]
    senders: list[int]
    why: str


class Traffic(NamedTuple):
    """What a log has: its messages, those of the channels that were not chosen, and the channels' names."""

    messages: Sequence[Message]
    elsewhere: Mapping[str, set[tuple[int, bool]]]
    names: Sequence[str]


def group(identifier: int) -> int:
    """The parameter group number of an identifier of 29 bits (SAE J1939-21)."""
    number = identifier >> 8 & 0x3_FFFF
    return number if number >> 8 & 0xFF >= _GROUP_OF_ALL else number & 0x3_FF00


def load_dbc(raw: bytes, where: str) -> Database:
    """A DBC, also one that contradicts itself where nobody asks.

    Raises:
        InputError: it cannot be read as one.
    """
    try:
        text = raw.decode()
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")  # Vector's tools write Windows' characters
    try:
        database = load_string(text, "dbc", strict=False)
    except (DatabaseError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{where}: not a valid DBC file: {' '.join(str(error).split())[:300]}") from error
    assert isinstance(database, Database)
    return database


def find_signals(database: Database, traffic: Traffic, wanted: Collection[str] | None = None) -> list[Found]:
    """Each signal of the DBC, or each that is wanted."""
    found = []
    for message in database.messages:
        signals = [each.name for each in message.signals if wanted is None or each.name in wanted]
        if signals:
            found += _of_message(message, signals, traffic)
    there = {each.signal for each in found}
    absent = sorted(set(wanted or ()) - there)
    return found + [Found(name, "", "", False, [], [], "the DBC has no such signal") for name in absent]


def _of_message(message: DbcMessage, signals: Sequence[str], traffic: Traffic) -> list[Found]:
    is_j1939 = message.is_extended_frame and message.protocol == "j1939"
    same = [each for each in traffic.messages if _matches(message, is_j1939, each.identifier, each.is_extended)]
    identifier = f"{message.frame_id:08X}" if message.is_extended_frame else f"{message.frame_id:03X}"
    channels = sorted({traffic.names[each.channel] for each in same})
    senders = sorted({each.identifier & _SENDER for each in same}) if message.is_extended_frame else []
    why = "" if same else _absent(message, is_j1939, traffic)
    valid = _valid(message, signals, is_j1939, same)
    long = sum(count for each in same for length, count in each.lengths.items() if length >= message.length)
    if same and not long:
        total = sum(each.count for each in same)
        why = f"all {total} frames are shorter than the {message.length} bytes of the DBC"
    return [
        Found(
            name,
            message.name,
            identifier,
            not why and name in valid,
            channels,
            senders,
            why or _never(name, valid, is_j1939),
        )
        for name in signals
    ]


def _never(name: str, valid: set[str], is_j1939: bool) -> str:
    if name in valid:
        return ""
    return "its values are never valid (not available, or an error)" if is_j1939 else "no frame has it"


def _matches(message: DbcMessage, is_j1939: bool, identifier: int, is_extended: bool) -> bool:
    if is_extended != message.is_extended_frame:
        return False
    if not is_j1939:
        return identifier == message.frame_id
    if message.frame_id & _SENDER == _ANY_SENDER:
        return group(identifier) == group(message.frame_id)
    return identifier & PRIORITY_MASK == message.frame_id & PRIORITY_MASK


def _absent(message: DbcMessage, is_j1939: bool, traffic: Traffic) -> str:
    """Why no frame is its."""
    others = [
        channel
        for channel, identifiers in traffic.elsewhere.items()
        if any(_matches(message, is_j1939, *each) for each in identifiers)
    ]
    if others:
        return f"it is on channel {' and '.join(others)}"
    if is_j1939:
        same = {each.identifier for each in traffic.messages if each.is_extended}
        senders = sorted({each & _SENDER for each in same if group(each) == group(message.frame_id)})
        if senders:
            there = ", ".join(f"0x{each:02X}" for each in senders)
            return f"its parameter group came from {there}, not from 0x{message.frame_id & _SENDER:02X}"
    return "no such message"


def _valid(message: DbcMessage, signals: Sequence[str], is_j1939: bool, same: Sequence[Message]) -> set[str]:
    """The signals that have a value in any of the frames that were kept."""
    found: set[str] = set()
    lengths = {each.name: each.length for each in message.signals}
    numbers = {each.name for each in message.signals if not each.is_float and is_j1939}
    for data in {data for each in same for data in each.data if len(data) >= message.length}:
        try:
            values = message.decode_simple(data[: message.length], decode_choices=False, scaling=False)
        except (DatabaseError, ValueError):  # multiplexed by a value that the DBC does not know
            continue
        for name in signals:
            if name in values and name not in found:
                raw = int(str(values[name])) & (1 << lengths[name]) - 1 if name in numbers else 0
                if name not in numbers or j1939_quality(raw, lengths[name]) is Quality.GOOD:
                    found.add(name)
        if len(found) == len(signals):
            break
    return found

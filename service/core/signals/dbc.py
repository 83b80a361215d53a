"""Compilation of a DBC's text to the decode table; cantools reads the DBC, and is not used again afterwards.

Only messages that carry wanted signals need to make sense: in real files others overlap, are too short or are there
twice.
"""

from collections.abc import Collection, Mapping
from math import inf, isfinite
from types import MappingProxyType

import textparser
from cantools.database.can import Message
from cantools.database.can import Signal as DbcSignal
from cantools.database.can.formats import dbc
from cantools.database.errors import Error as DatabaseError

from faultline.service.core.errors import InputError
from faultline.service.core.j1939.identifiers import (
    DESTINATION_MASK,
    GLOBAL,
    NULL,
    PRIORITY_MASK,
    SOURCE_MASK,
    group_of,
    is_addressed,
)
from faultline.service.core.j1939.transport import LARGEST
from faultline.service.core.signals.dbc_text import needed
from faultline.service.core.signals.decode import EXTENDED, STANDARD, DecodeTable
from faultline.service.core.signals.layout import FLOATS, Cut, Field, Layout, Only, Selector
from faultline.service.core.signals.units import MORE, Convert, conversion

SENSELESS: tuple[type[Exception], ...] = (
    *(DatabaseError, ArithmeticError, AttributeError, LookupError, MemoryError, TypeError, ValueError, RecursionError),
)
"""What cantools raises where the statements of a file contradict each other."""
BROKEN: tuple[type[Exception], ...] = (textparser.Error, *SENSELESS)
"""And where it breaks the grammar besides."""
NOBODY: Mapping[str, int] = MappingProxyType({})
NO_BUSES: Mapping[str, str] = MappingProxyType({})
OWN_NAMES: Mapping[str, str] = MappingProxyType({})
"""Every signal has the name that the DBC gives it."""


def compile_dbc(
    text: str,
    units: Mapping[str, str],
    where: str,
    senders: Mapping[str, int] = NOBODY,
    buses: Mapping[str, str] = NO_BUSES,
    signals: Mapping[str, str] = OWN_NAMES,
    convert: Convert = conversion,
) -> DecodeTable:
    """Return the table for the signals in `units` (name to unit), from a DBC's text; `where` names the file in errors.

    `buses` are the names of the buses of some messages: the table has tables of its own for these. `signals` are the
    DBC's names of those signals that have other ones there, as SIGNAL or MESSAGE.SIGNAL. `convert` knows the units.

    `senders` are the source addresses that are chosen for some messages of J1939, whatever the DBC has there. A message
    without one to which the DBC gives the null address (0xFE) is taken from any sender, as long as there is but one.

    Raises:
        InputError: the text is no valid DBC; a wanted signal is absent, ambiguous, in a unit that cannot be converted
            to the one wanted, or in a message that makes no sense; a sender or a bus is given to a message that cannot
            have it.
    """
    wanted_names = by_dbc_name(units, signals, where)
    messages, says_formats = _messages(text, wanted_names, where)
    carriers: dict[str, list[str]] = {name: [] for name in units}
    carrying: list[tuple[Message, dict[str, DbcSignal]]] = []
    for message in messages:
        wanted = wanted_in(message, wanted_names)
        for name in wanted:
            carriers[name].append(message.name)
        if wanted:
            if why := unsaid(message, says_formats):
                raise InputError(f"{where}: {why}")
            check_message(message, wanted.values(), where)
            carrying.append((message, wanted))
    by_bus: dict[str, dict[tuple[int, bool], Layout]] = {"": {}}
    for message, wanted in carrying:
        layouts = by_bus.setdefault(buses.get(message.name, ""), {})
        layout = layout_of(message, identity_of(message, messages, senders), wanted, units, where, convert)
        key = layout.identifier, message.is_extended_frame
        if (before := layouts.setdefault(key, layout)) is not layout:
            raise InputError(f"{where}: {before.name} and {message.name} have one identifier; remove one of them")
    _check_carriers(carriers, signals, where)
    found = [layout for layouts in by_bus.values() for layout in layouts.values()]
    _check_senders(senders, found, where)
    _check_buses(buses, found, where)
    table = DecodeTable(by_bus.pop(""), units)
    for bus, layouts in by_bus.items():
        table.add_bus(bus, DecodeTable(layouts))
    return table


def by_dbc_name(names: Collection[str], signals: Mapping[str, str], where: str) -> dict[str, str]:
    """Return the wanted names by those of the DBC (SIGNAL or MESSAGE.SIGNAL), which `signals` gives where they differ.

    Raises:
        InputError: two are the same signal of the DBC.
    """
    found: dict[str, str] = {}
    for name in names:
        other = found.setdefault(given := signals.get(name, name), name)
        if other != name:
            raise InputError(f"{where}: {other} and {name} are both the DBC's signal {given}; give each its own")
    return found


def wanted_in(message: Message, wanted: Mapping[str, str]) -> dict[str, DbcSignal]:
    """Return the signals of a message by the names that `wanted` has for them."""
    named = [(wanted.get(f"{message.name}.{each.name}", wanted.get(each.name)), each) for each in message.signals]
    return {name: each for name, each in named if name is not None}


def plain_names(wanted: Collection[str]) -> list[str]:
    """Return the DBC's names of signals without those of their messages."""
    return [name.rpartition(".")[2] for name in wanted]


def _messages(text: str, names: Collection[str], where: str) -> tuple[list[Message], bool]:
    """The messages, those with signals of these `names` at least; and whether the file tells J1939 from the others.

    Raises:
        InputError: the text breaks the grammar, or what is said of these messages contradicts itself.
    """
    try:
        return load(text)
    except textparser.Error as error:
        raise InputError(f"{where}: not a valid DBC file: {one_line(error)}") from error
    except SENSELESS:
        try:
            return load(needed(text, plain_names(names)))
        except BROKEN as error:
            raise InputError(f"{where}: not a valid DBC file: {one_line(error)}") from error


def load(text: str) -> tuple[list[Message], bool]:
    """The messages of a file, and whether it tells J1939's from the others; raises one of `BROKEN`."""
    database = dbc.load_string(text, strict=False)
    return list(database.messages), database.dbc is not None and "VFrameFormat" in database.dbc.attribute_definitions


def one_line(error: Exception) -> str:
    """What went wrong, in one line."""
    return " ".join(str(error).split()) or type(error).__name__


def unsaid(message: Message, says_formats: bool) -> str:
    """What the file fails to say of a message; empty where it says enough."""
    if says_formats or not message.is_extended_frame:
        return ""
    return (
        f"does not say whether {message.name} is J1939's: give it the attribute VFrameFormat "
        "(J1939PG, or ExtendedCAN), or raw values that mean *not available* would be taken for numbers"
    )


def check_message(message: Message, wanted: Collection[DbcSignal], where: str) -> None:
    """Refuse a message whose signals cannot be read for certain.

    Raises:
        InputError: signals overlap or do not fit; no such message can come.
    """
    place = f"{where}: {message.name}"
    names = ", ".join(signal.name for signal in wanted)
    if message.protocol == "j1939" and message.length > LARGEST:
        raise InputError(
            f"{place} has {message.length} bytes, J1939's transport protocol carries {LARGEST}: take {names} from "
            "another message"
        )
    try:
        message.refresh(strict=True)
    except SENSELESS as error:
        raise InputError(
            f"{place}: {one_line(error)} Mend its length, start bits and sizes in the DBC: "
            f"{names} cannot be read from it"
        ) from error
    for signal in message.signals:
        if _is_circular(message, signal):
            raise InputError(f"{place}.{signal.name}: is multiplexed by itself; mend SG_MUL_VAL_ in the DBC")
        if signal.is_float and signal.length not in FLOATS:
            raise InputError(
                f"{place}.{signal.name}: a floating-point number of {signal.length} bits; mend its size in the DBC: "
                f"{', '.join(map(str, FLOATS))}"
            )
        if not _is_finite(signal):
            raise InputError(f"{place}.{signal.name}: its scale, offset or limits are no numbers; mend them in the DBC")


def _is_finite(signal: DbcSignal) -> bool:
    """True if scale, offset and limits, and the raw values at the limits, are numbers that a computer has."""
    scale, offset = float(signal.scale), float(signal.offset)
    limits = [float(each) for each in (signal.minimum, signal.maximum) if each is not None]
    ends = [(each - offset) / scale for each in limits] if scale else []
    return all(map(isfinite, (scale, offset, *limits, *ends)))


def _is_circular(message: Message, signal: DbcSignal) -> bool:
    """True if the signal stands behind itself."""
    selectors = {each.name: each.multiplexer_signal for each in message.signals}
    selector, seen = signal.multiplexer_signal, {signal.name}
    while selector is not None and selector not in seen:
        seen.add(selector)
        selector = selectors.get(selector)
    return selector is not None


def identity_of(message: Message, messages: Collection[Message], senders: Mapping[str, int]) -> tuple[int, int]:
    """Identifier and the bits of it that count; those that do not are the null address and the one of all.

    In J1939 the priority counts for nothing, nor does the destination, unless another message of the DBC differs in
    nothing else; and the sender does not where nobody has chosen one.
    """
    if message.protocol != "j1939" or not message.is_extended_frame:
        return message.frame_id, EXTENDED if message.is_extended_frame else STANDARD
    identifier, mask = message.frame_id & PRIORITY_MASK, PRIORITY_MASK
    if is_addressed(group_of(identifier)):
        alike = [one.frame_id for one in messages if one.protocol == "j1939" and _is_alike(one.frame_id, identifier)]
        if len({one & PRIORITY_MASK for one in alike}) < 2:
            identifier, mask = identifier | GLOBAL << 8, mask & ~DESTINATION_MASK
    if message.name in senders:
        identifier = identifier & ~SOURCE_MASK | senders[message.name]
    if identifier & SOURCE_MASK == NULL:
        mask &= ~SOURCE_MASK
    return identifier, mask


def _is_alike(one: int, other: int) -> bool:
    """Whether two identifiers are of one group and sender."""
    return group_of(one) == group_of(other) and not (one ^ other) & SOURCE_MASK


def layout_of(
    message: Message,
    identity: tuple[int, int],
    wanted: Mapping[str, DbcSignal],
    units: Mapping[str, str],
    where: str,
    convert: Convert = conversion,
) -> Layout:
    """Return where the wanted signals, by their names outside the DBC, are in the message.

    Raises:
        InputError: a unit cannot be converted to the one in `units`.
    """
    fields = tuple(_field(message, name, signal, (units[name], convert), where) for name, signal in wanted.items())
    used = {cut for field in fields for cut, _ in field.only}
    selectors = [
        Selector(_cut(message, each), _selected(message, each.name), _only(message, each))
        for each in message.signals
        if each.is_multiplexer
    ]
    return Layout(
        name=message.name,
        identifier=identity[0],
        mask=identity[1],
        size=message.length,
        j1939=message.protocol == "j1939",
        period_s=message.cycle_time / 1000.0 if message.cycle_time else None,
        fields=fields,
        selectors=tuple(selector for selector in selectors if selector.cut in used),
    )


def _field(message: Message, name: str, signal: DbcSignal, wanted: tuple[str, Convert], where: str) -> Field:
    given, (unit, convert) = signal.unit or "", wanted
    how = convert(given, unit)
    if how is None:
        place = f"{where}: {message.name}.{signal.name}"
        raise InputError(f"{place}: unit {given!r} cannot be converted to {unit!r}, which the bundle needs{MORE}")
    factor, shift = how
    low, high = signal.minimum, signal.maximum
    slack = 1e-9 * max(abs(float(low or 0.0)), abs(float(high or 0.0)), 1.0)  # of what a decimal rounds
    return Field(
        name=name,
        cut=_cut(message, signal),
        signed=signal.is_signed,
        is_float=signal.is_float,
        scale=float(signal.scale) * factor,
        offset=float(signal.offset) * factor + shift,
        low=-inf if low is None else (float(low) - slack) * factor + shift,
        high=inf if high is None else (float(high) + slack) * factor + shift,
        only=_only(message, signal),
    )


def _cut(message: Message, signal: DbcSignal) -> Cut:
    big_endian = signal.byte_order == "big_endian"
    shift = signal.start
    if big_endian:  # the DBC numbers the bits of each byte from the right, bytes from the left
        first = 8 * (signal.start // 8) + 7 - signal.start % 8
        shift = 8 * message.length - first - signal.length
    return Cut(shift, signal.length, big_endian)


def _only(message: Message, signal: DbcSignal) -> Only:
    """Return the selectors that the signal stands behind, the outermost first, with their values."""
    if signal.multiplexer_signal is None or signal.multiplexer_ids is None:
        return ()
    selector = message.get_signal_by_name(signal.multiplexer_signal)
    return (*_only(message, selector), (_cut(message, selector), frozenset(signal.multiplexer_ids)))


def _selected(message: Message, selector: str) -> frozenset[int]:
    """Return all values of a selector that some signal stands behind."""
    behind = [signal.multiplexer_ids or () for signal in message.signals if signal.multiplexer_signal == selector]
    return frozenset(value for values in behind for value in values)


def _check_carriers(carriers: Mapping[str, list[str]], signals: Mapping[str, str], where: str) -> None:
    shown = {name: f"{name} (as {signals[name]})" if name in signals else name for name in carriers}
    absent = [shown[name] for name, messages in carriers.items() if not messages]
    if absent:
        raise InputError(f"{where}: no message carries {', '.join(absent)}; use the DBC that the bundle was made for")
    for name, messages in carriers.items():
        if len(messages) > 1:
            raise InputError(
                f"{where}: signal {shown[name]} is in several messages ({', '.join(messages)}); rename all but one, or "
                f'say under [can.signals] which: {name} = "{messages[0]}.{signals.get(name, name)}"'
            )


def _check_senders(senders: Mapping[str, int], layouts: Collection[Layout], where: str) -> None:
    known = [layout.name for layout in layouts if layout.j1939]
    for name, address in senders.items():
        if name not in known:
            there = ", ".join(known) or "none"
            raise InputError(f"{where}: a sender is chosen for {name}; messages of J1939 with wanted signals: {there}")
        if not 0 <= address < NULL:
            raise InputError(f"{where}: sender {address} is chosen for {name}; an address is one of 0x00 to 0xFD")


def _check_buses(buses: Mapping[str, str], layouts: Collection[Layout], where: str) -> None:
    known = [layout.name for layout in layouts]
    for name, bus in buses.items():
        if name not in known:
            there = ", ".join(known)
            raise InputError(f"{where}: bus {bus} is given to {name}; messages with wanted signals: {there}")

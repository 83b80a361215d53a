"""Compilation of a DBC's text to the decode table; cantools reads the DBC, and is not used again afterwards."""

from collections.abc import Collection, Mapping
from math import inf

from cantools.database import load_string
from cantools.database.can import Database, Message
from cantools.database.can import Signal as DbcSignal
from cantools.database.errors import Error as DatabaseError

from faultline.service.core.errors import InputError
from faultline.service.core.signals.decode import PRIORITY_MASK, Cut, DecodeTable, Field, Layout, Only, Selector

LONGEST = 8
"""Bytes of a message of J1939 that comes in one frame (SAE J1939-21)."""

CONVERSIONS: Mapping[tuple[str, str], float] = {
    ("kPa", "Pa"): 1e3,
    ("bar", "Pa"): 1e5,
    ("%", "1"): 1e-2,
    ("rpm", "1/s"): 1 / 60,
}
"""Factor from a DBC's unit to a bundle's unit; equal units need none."""


def compile_dbc(text: str, units: Mapping[str, str], where: str) -> DecodeTable:
    """Return the table for the signals in `units` (name to unit), from a DBC's text; `where` names the file in errors.

    Raises:
        InputError: the text is no valid DBC, or a wanted signal is absent, ambiguous, or in a unit that cannot be
            converted to the one wanted.
    """
    try:
        database = load_string(text, "dbc", strict=True)
    except DatabaseError as error:
        raise InputError(f"{where}: not a valid DBC file: {' '.join(str(error).split())}") from error
    assert isinstance(database, Database)
    layouts: dict[tuple[int, bool], Layout] = {}
    carriers: dict[str, list[str]] = {name: [] for name in units}
    for message in database.messages:
        wanted = [signal for signal in message.signals if signal.name in units]
        for signal in wanted:
            carriers[signal.name].append(message.name)
        if wanted:
            if message.is_extended_frame and not _says_formats(database):
                raise InputError(
                    f"{where}: does not say whether {message.name} is J1939's: give it the attribute VFrameFormat "
                    "(J1939PG, or ExtendedCAN), or raw values that mean *not available* would be taken for numbers"
                )
            if message.protocol == "j1939" and message.length > LONGEST:
                raise InputError(
                    f"{where}: {message.name} has {message.length} bytes, which come by J1939's transport protocol, "
                    f"to which this does not listen: take {wanted[0].name} from another message"
                )
            j1939 = message.is_extended_frame and message.protocol == "j1939"
            identifier = message.frame_id & PRIORITY_MASK if j1939 else message.frame_id
            if (before := layouts.get((identifier, message.is_extended_frame))) is not None:
                raise InputError(f"{where}: {before.name} and {message.name} have one identifier; remove one of them")
            layouts[identifier, message.is_extended_frame] = _layout(message, identifier, wanted, units, where)
    _check_carriers(carriers, where)
    return DecodeTable(layouts)


def _says_formats(database: Database) -> bool:
    """Return True if it knows the attribute that tells J1939 from other messages of 29 bits."""
    return database.dbc is not None and "VFrameFormat" in database.dbc.attribute_definitions


def _layout(
    message: Message, identifier: int, wanted: Collection[DbcSignal], units: Mapping[str, str], where: str
) -> Layout:
    fields = tuple(_field(message, signal, units[signal.name], where) for signal in wanted)
    used = {cut for field in fields for cut, _ in field.only}
    selectors = [
        Selector(_cut(message, each), _selected(message, each.name), _only(message, each))
        for each in message.signals
        if each.is_multiplexer
    ]
    return Layout(
        name=message.name,
        identifier=identifier,
        size=message.length,
        j1939=message.protocol == "j1939",
        period_s=message.cycle_time / 1000.0 if message.cycle_time else None,
        fields=fields,
        selectors=tuple(selector for selector in selectors if selector.cut in used),
    )


def _field(message: Message, signal: DbcSignal, unit: str, where: str) -> Field:
    given = signal.unit or ""
    factor = 1.0 if given == unit else CONVERSIONS.get((given, unit))
    if factor is None:
        place = f"{where}: {message.name}.{signal.name}"
        raise InputError(f"{place}: unit {given!r} cannot be converted to {unit!r}, which the bundle needs")
    low, high = signal.minimum, signal.maximum
    slack = 1e-9 * max(abs(float(low or 0.0)), abs(float(high or 0.0)), 1.0)  # of what a decimal rounds
    return Field(
        name=signal.name,
        cut=_cut(message, signal),
        signed=signal.is_signed,
        is_float=signal.is_float,
        scale=float(signal.scale) * factor,
        offset=float(signal.offset) * factor,
        low=-inf if low is None else (float(low) - slack) * factor,
        high=inf if high is None else (float(high) + slack) * factor,
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


def _check_carriers(carriers: Mapping[str, list[str]], where: str) -> None:
    absent = [name for name, messages in carriers.items() if not messages]
    if absent:
        raise InputError(f"{where}: no message carries {', '.join(absent)}; use the DBC that the bundle was made for")
    for name, messages in carriers.items():
        if len(messages) > 1:
            raise InputError(
                f"{where}: signal {name} is in several messages ({', '.join(messages)}); rename all but one"
            )

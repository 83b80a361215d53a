"""Frames to signals: a table compiled once from a DBC, in the units of the bundle.

A frame gives all its signals or none. J1939 frames are matched on parameter group and source address (the priority may
differ), so that a second sender of the same group is another key and never overwrites a value.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from cantools.database import load_string
from cantools.database.can import Database, Message
from cantools.database.can import Signal as DbcSignal
from cantools.database.errors import Error as DatabaseError

from service.core.errors import InputError
from service.core.signals import Quality, j1939_quality

PRIORITY_MASK = 0x03FF_FFFF
"""Bits of a 29-bit identifier below the priority: data page, PGN and source address."""

CONVERSIONS: Mapping[tuple[str, str], float] = {
    ("kPa", "Pa"): 1e3,
    ("bar", "Pa"): 1e5,
    ("%", "1"): 1e-2,
    ("rpm", "1/s"): 1 / 60,
}
"""Factor from a DBC's unit to a bundle's unit; equal units need none."""


@dataclass(frozen=True, slots=True)
class _Field:
    """How to cut one signal out of a frame read as one integer: value = raw * scale + offset, in the bundle's unit."""

    name: str
    shift: int  # bits to the right in the frame's integer
    length: int  # bits
    signed: bool
    big_endian: bool
    scale: float
    offset: float


@dataclass(frozen=True, slots=True)
class _Layout:
    """The fields of one frame and what it must look like to be read."""

    size: int  # bytes
    j1939: bool
    fields: tuple[_Field, ...]


class DecodeTable:
    """Decodes the wanted signals of a bus; everything else is ignored, what is malformed is counted.

    `short_frames` counts frames that matched but were shorter than their DBC message: none of their signals were taken.
    """

    def __init__(self, layouts: Mapping[int, _Layout]) -> None:
        self._layouts = layouts
        self.short_frames = 0

    @property
    def identifiers(self) -> tuple[int, ...]:
        """29-bit identifiers without priority (11-bit ones as negative keys) that carry wanted signals."""
        return tuple(self._layouts)

    def decode(self, can_id: int, is_extended: bool, data: bytes) -> list[tuple[str, float, Quality]]:
        """Name, value and quality of every wanted signal in the frame; empty where it carries none or is too short."""
        layout = self._layouts.get(_key(can_id, is_extended))
        if layout is None:
            return []
        if len(data) < layout.size:
            self.short_frames += 1
            return []
        little = int.from_bytes(data[: layout.size], "little")
        big = int.from_bytes(data[: layout.size], "big")
        signals = []
        for field in layout.fields:
            raw = ((big if field.big_endian else little) >> field.shift) & ((1 << field.length) - 1)
            quality = j1939_quality(raw, field.length) if layout.j1939 else Quality.GOOD
            if field.signed and raw >> (field.length - 1):
                raw -= 1 << field.length
            signals.append((field.name, raw * field.scale + field.offset, quality))
        return signals


def compile_dbc(text: str, units: Mapping[str, str], where: str) -> DecodeTable:
    """The table for the signals in `units` (name to unit), from a DBC's text; `where` names the file in errors.

    Raises:
        InputError: the text is no valid DBC, or a wanted signal is absent, ambiguous, multiplexed, a float, or in a
            unit that cannot be converted to the one wanted.
    """
    try:
        database = load_string(text, "dbc", strict=True)
    except DatabaseError as error:
        raise InputError(f"{where}: not a valid DBC file: {' '.join(str(error).split())}") from error
    assert isinstance(database, Database)
    layouts: dict[int, _Layout] = {}
    carriers: dict[str, list[str]] = {name: [] for name in units}
    for message in database.messages:
        wanted = [signal for signal in message.signals if signal.name in units]
        for signal in wanted:
            carriers[signal.name].append(message.name)
        if wanted:
            layouts[_key(message.frame_id, message.is_extended_frame)] = _layout(message, wanted, units, where)
    _check_carriers(carriers, where)
    return DecodeTable(layouts)


def _key(can_id: int, is_extended: bool) -> int:
    return can_id & PRIORITY_MASK if is_extended else -1 - can_id


def _layout(message: Message, wanted: Iterable[DbcSignal], units: Mapping[str, str], where: str) -> _Layout:
    fields = tuple(_field(message, signal, units[signal.name], where) for signal in wanted)
    return _Layout(message.length, message.protocol == "j1939", fields)


def _field(message: Message, signal: DbcSignal, unit: str, where: str) -> _Field:
    place = f"{where}: {message.name}.{signal.name}"
    if signal.is_float or signal.multiplexer_ids:
        raise InputError(
            f"{place}: multiplexed and floating-point signals cannot be bundle inputs; use an integer signal"
        )
    given = signal.unit or ""
    factor = 1.0 if given == unit else CONVERSIONS.get((given, unit))
    if factor is None:
        raise InputError(f"{place}: unit {given!r} cannot be converted to {unit!r}, which the bundle needs")
    big_endian = signal.byte_order == "big_endian"
    shift = signal.start
    if big_endian:  # the DBC numbers the bits of each byte from the right, bytes from the left
        first = 8 * (signal.start // 8) + 7 - signal.start % 8
        shift = 8 * message.length - first - signal.length
    return _Field(
        name=signal.name,
        shift=shift,
        length=signal.length,
        signed=signal.is_signed,
        big_endian=big_endian,
        scale=signal.scale * factor,
        offset=signal.offset * factor,
    )


def _check_carriers(carriers: Mapping[str, list[str]], where: str) -> None:
    absent = [name for name, messages in carriers.items() if not messages]
    if absent:
        raise InputError(f"{where}: no message carries {', '.join(absent)}; use the DBC that the bundle was made for")
    for name, messages in carriers.items():
        if len(messages) > 1:
            raise InputError(
                f"{where}: signal {name} is in several messages ({', '.join(messages)}); rename all but one"
            )

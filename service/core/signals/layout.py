"""Where a message's signals are, and how their raw values become numbers in the bundle's units."""

import struct
from collections.abc import Sequence
from dataclasses import InitVar, dataclass, field
from math import ceil, floor, inf, isfinite

from faultline.service.core.j1939.identifiers import SOURCE_MASK
from faultline.service.core.signals.values import Quality, j1939_quality

FLOATS = {16: struct.Struct(">e"), 32: struct.Struct(">f"), 64: struct.Struct(">d")}
"""By the bits that a floating-point number may have."""

_GOOD = Quality.GOOD


@dataclass(frozen=True, slots=True)
class Cut:
    """Where a signal's bits are in a frame that is read as one integer."""

    shift: int  # bits to the right
    length: int  # bits
    big_endian: bool

    def raw(self, little: int, big: int) -> int:
        """The bits, of the frame read from either end."""
        return ((big if self.big_endian else little) >> self.shift) & ((1 << self.length) - 1)


Only = tuple[tuple[Cut, frozenset[int]], ...]
"""Multiplexed: there only where each of these has one of its values, the outermost first."""


@dataclass(frozen=True, slots=True)
class Selector:
    """A multiplexer with all values that it may have."""

    cut: Cut
    known: frozenset[int]
    only: Only


@dataclass(frozen=True, slots=True)
class Field:
    """One signal: value = raw * scale + offset in the bundle's unit, valid from `low` to `high` [bundle's unit]."""

    name: str
    cut: Cut
    signed: bool
    is_float: bool
    scale: float
    offset: float
    low: float
    high: float
    only: Only = ()

    @property
    def is_plain(self) -> bool:
        """Whether it is an unsigned integer of the little end that is in every frame."""
        return not (self.signed or self.is_float or self.cut.big_endian or self.only) and self.scale > 0.0

    def plain(self, j1939: bool) -> "Plain":
        """How a good value of a plain field is read: raw values from `least` to below `beyond` are good."""
        top = 1 << self.cut.length
        if j1939:
            words = (top - 2, top - 1) if self.cut.length < 8 else (0xFB << (self.cut.length - 8),)
            top = next((raw for raw in words if j1939_quality(raw, self.cut.length) is not _GOOD), top)
        least = 0 if self.low == -inf else max(0, ceil((self.low - self.offset) / self.scale))
        beyond = top if self.high == inf else min(top, floor((self.high - self.offset) / self.scale) + 1)
        return self.name, self.cut.shift, (1 << self.cut.length) - 1, least, beyond, self.scale, self.offset, self

    def read(self, little: int, big: int, j1939: bool) -> tuple[str, float, Quality]:
        """Name, value and quality."""
        raw = self.cut.raw(little, big)
        if self.is_float:
            (number,) = FLOATS[self.cut.length].unpack(raw.to_bytes(self.cut.length // 8, "big"))
            quality = Quality.GOOD if isfinite(number) else Quality.ERROR
        else:
            quality = j1939_quality(raw, self.cut.length) if j1939 else Quality.GOOD
            number = raw - (1 << self.cut.length) if self.signed and raw >> (self.cut.length - 1) else raw
        value = number * self.scale + self.offset
        if quality is Quality.GOOD and not (self.low <= value <= self.high and isfinite(value)):
            quality = Quality.OUT_OF_RANGE
        return self.name, value, quality


Plain = tuple[str, int, int, int, int, float, float, Field]
"""Name, shift, mask, the least good raw value and the one beyond the last, scale and offset; and the field, for others.
"""


@dataclass(frozen=True)
class Layout:
    """One message, of `size` bytes and sent every `period_s` [s] if that is known.

    Frames carry it whose identifier equals `identifier` in the bits of `mask`; of J1939 the priority counts for
    nothing, nor does the sender where the DBC names none. `j1939` says that some raw values are no numbers.
    """

    name: str
    identifier: int
    mask: int
    size: int
    j1939: bool
    period_s: float | None
    fields: InitVar[Sequence[Field]]
    selectors: tuple[Selector, ...] = ()
    signals: tuple[str, ...] = field(init=False)
    plain: tuple[Plain, ...] = field(init=False)
    others: tuple[Field, ...] = field(init=False)
    is_plain: bool = field(init=False)
    is_from_any: bool = field(init=False)

    def __post_init__(self, fields: Sequence[Field]) -> None:
        """Most signals are integers from the right that are always there: their numbers are read without a call."""
        object.__setattr__(self, "signals", tuple(one.name for one in fields))
        plain = [one for one in fields if one.is_plain]
        object.__setattr__(self, "plain", tuple(one.plain(self.j1939) for one in plain))
        object.__setattr__(self, "others", tuple(one for one in fields if not one.is_plain))
        object.__setattr__(self, "is_plain", not self.others and not self.selectors)
        object.__setattr__(self, "is_from_any", not self.mask & SOURCE_MASK)

"""Frames to signals, in the units of the bundle, by a table that was compiled from a DBC (`core.signals.dbc`).

A frame gives all its signals or none. J1939 frames are matched on parameter group and source address (the priority may
differ), so that a second sender of the same group never overwrites a value; it is counted.

A second sender under the same address is known by when its frames come (`core.signals.arrivals`): their signals are
`DOUBTED`.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import InitVar, dataclass, field
from math import ceil, floor, inf, isfinite, nan
from typing import NamedTuple

from faultline.service.core.signals.arrivals import Arrival, Arrivals
from faultline.service.core.signals.values import Quality, j1939_quality

PRIORITY_MASK = 0x03FF_FFFF
"""Bits of a 29-bit identifier below the priority: data page, PGN and source address."""
GROUP_MASK = 0x03FF_FF00
"""The same without the source address."""
CLAIM = 0x00EE_FF00
"""The group in which a device claims its address, with its NAME (SAE J1939-81), without priority and source."""
STANDARD, EXTENDED = 0x7FF, 0x1FFF_FFFF
SENDERS = 8
"""Other source addresses of a message that are remembered."""

_GOOD = Quality.GOOD
_FLOATS = {16: struct.Struct(">e"), 32: struct.Struct(">f"), 64: struct.Struct(">d")}


class Wanted(NamedTuple):
    """Frames to be let through by a bus: those whose identifier equals `identifier` in the bits of `mask`."""

    identifier: int
    mask: int
    is_extended: bool


@dataclass(frozen=True, slots=True)
class Cut:
    """Position of a signal's bits in a frame that is read as one integer."""

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
        """Return True if it is an unsigned little-endian integer that is in every frame."""
        return not (self.signed or self.is_float or self.cut.big_endian or self.only) and self.scale > 0.0

    def plain(self, j1939: bool) -> "Plain":
        """Return scale and range of a plain field: raw values from `least` to below `beyond` are good."""
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
            (number,) = _FLOATS[self.cut.length].unpack(raw.to_bytes(self.cut.length // 8, "big"))
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

    `identifier` is without priority if it is one of J1939; `j1939` says that some raw values are no numbers.
    """

    name: str
    identifier: int
    size: int
    j1939: bool
    period_s: float | None
    fields: InitVar[Sequence[Field]]
    selectors: tuple[Selector, ...] = ()
    signals: tuple[str, ...] = field(init=False)
    plain: tuple[Plain, ...] = field(init=False)
    others: tuple[Field, ...] = field(init=False)
    is_plain: bool = field(init=False)

    def __post_init__(self, fields: Sequence[Field]) -> None:
        """Most signals are integers from the right that are always there: their numbers are read without a call."""
        object.__setattr__(self, "signals", tuple(one.name for one in fields))
        plain = [one for one in fields if one.is_plain]
        object.__setattr__(self, "plain", tuple(one.plain(self.j1939) for one in plain))
        object.__setattr__(self, "others", tuple(one for one in fields if not one.is_plain))
        object.__setattr__(self, "is_plain", not self.others and not self.selectors)


@dataclass
class Rejected:
    """Frames that matched and were not taken, by message."""

    short: dict[str, int] = field(default_factory=dict)  # shorter than in the DBC: none of their signals was taken
    other_source: dict[str, int] = field(default_factory=dict)  # the same parameter group of another sender
    unknown_selector: dict[str, int] = field(default_factory=dict)  # multiplexed by a value that the DBC does not know
    claimed: dict[str, int] = field(default_factory=dict)  # another device has claimed its sender's address
    senders: dict[str, set[int]] = field(default_factory=dict)  # source addresses of `other_source`, some
    early: dict[str, int] = field(default_factory=dict)  # far too soon after the one before to be the same sender's

    @property
    def total(self) -> int:
        """Return the count over all reasons and messages."""
        kinds = (self.short, self.other_source, self.unknown_selector, self.claimed, self.early)
        return sum(sum(counts.values()) for counts in kinds)


class DecodeTable:
    """Decodes the wanted signals of a bus; everything else is ignored.

    Frames are counted by message: those `taken`, and those that were `rejected`, why.
    """

    def __init__(self, layouts: Mapping[tuple[int, bool], Layout]) -> None:
        """`layouts` by identifier, one of J1939 without priority, and whether it has 29 bits."""
        extended = {identifier: layout for (identifier, is_extended), layout in layouts.items() if is_extended}
        self._j1939 = {identifier: layout for identifier, layout in extended.items() if layout.j1939}
        self._other = {identifier: layout for identifier, layout in extended.items() if not layout.j1939}
        self._standard = {n: layout for (n, is_extended), layout in layouts.items() if not is_extended}
        self._groups: dict[int, list[Layout]] = {}
        for identifier, layout in self._j1939.items():
            self._groups.setdefault(identifier & GROUP_MASK, []).append(layout)
        self._names: dict[int, bytes] = {}  # of devices, by the address that they claimed
        self.taken = {layout.name: 0 for layout in layouts.values()}
        self.repeated = dict(self.taken)
        self.rejected = Rejected()
        self._arrivals = {layout.name: Arrivals(layout.period_s) for layout in layouts.values() if layout.period_s}

    @property
    def layouts(self) -> tuple[Layout, ...]:
        """Return the layouts of the messages that carry wanted signals."""
        return (*self._j1939.values(), *self._other.values(), *self._standard.values())

    @property
    def wanted(self) -> tuple[Wanted, ...]:
        """Return the filters of a bus: of a J1939 group the frames of all senders, so that a second one is seen."""
        groups = {Wanted(n, GROUP_MASK, True) for n in self._groups}
        groups |= {Wanted(CLAIM | n & 0xFF, PRIORITY_MASK, True) for n in self._j1939}
        others = {Wanted(n, EXTENDED, True) for n in self._other} | {Wanted(n, STANDARD, False) for n in self._standard}
        return tuple(sorted(groups | others))

    def carries(self, can_id: int, is_extended: bool) -> bool:
        """True if frames of this identifier carry wanted signals."""
        if not is_extended:
            return can_id in self._standard
        return can_id & PRIORITY_MASK in self._j1939 or can_id in self._other

    def strangers(self) -> list[str]:
        """Return what to mend in the DBC: messages that never came, while their group did, of other addresses."""
        found = []
        for layout in self._j1939.values():
            senders = self.rejected.senders.get(layout.name)
            if senders and not self.taken[layout.name]:
                there = ", ".join(f"0x{each:02X}" for each in sorted(senders))
                own = f"{layout.name} never came from 0x{layout.identifier & 0xFF:02X}"
                found.append(f"{own}, its parameter group came from {there}: give the DBC that source address")
        return found

    def run_at(self, speed: float) -> None:
        """Set how many times real time goes by: a sender that is held up is held up in real time."""
        for arrivals in self._arrivals.values():
            arrivals.speed = max(1.0, speed)

    def decode(
        self, can_id: int, is_extended: bool, data: bytes, t: float | None = None
    ) -> list[tuple[str, float, Quality]]:
        """Return name, value and quality of every wanted signal in the frame that came at log time `t` [s].

        Empty where it carries none, is too short, or repeats the one before. Without `t` its arrival is not judged.
        """
        if is_extended:
            layout = self._j1939.get(can_id & PRIORITY_MASK) or self._other.get(can_id)
        else:
            layout = self._standard.get(can_id)
        if layout is None:
            if is_extended:
                self._other_extended(can_id, data)
            return []
        if len(data) != layout.size:
            if len(data) < layout.size:
                _count(self.rejected.short, layout.name)
                return []
            data = data[: layout.size]
        arrivals = None if t is None else self._arrivals.get(layout.name)
        if t is not None and arrivals is not None and (came := arrivals.judge(t, data)) is not Arrival.DUE:
            return self._undue(layout, came)
        self.taken[layout.name] += 1
        little = int.from_bytes(data, "little")
        found: list[tuple[str, float, Quality]] = []
        take = found.append
        for name, shift, mask, least, beyond, scale, offset, one in layout.plain:
            raw = little >> shift & mask
            if least <= raw < beyond:
                take((name, raw * scale + offset, _GOOD))
            else:
                take(one.read(little, 0, layout.j1939))
        return found if layout.is_plain else [*found, *self._others(layout, little, int.from_bytes(data, "big"))]

    def _undue(self, layout: Layout, came: Arrival) -> list[tuple[str, float, Quality]]:
        """Count a frame that came too soon; one that is no repetition makes its signals doubted."""
        if came is Arrival.REPEATED:
            self.repeated[layout.name] += 1
            return []
        _count(self.rejected.early, layout.name)
        return [(name, nan, Quality.DOUBTED) for name in layout.signals]

    def _other_extended(self, can_id: int, data: bytes) -> None:
        """Count what another sender says under a wanted group, and take note of claims of addresses."""
        if (group := self._groups.get(can_id & GROUP_MASK)) is not None:
            for each in group:
                _count(self.rejected.other_source, each.name)
                senders = self.rejected.senders.setdefault(each.name, set())
                if len(senders) < SENDERS:
                    senders.add(can_id & 0xFF)
        elif can_id & GROUP_MASK == CLAIM:
            self._claimed(can_id & 0xFF, data)

    def _claimed(self, address: int, name: bytes) -> None:
        """A device claims an address; who speaks under it from now on is another one if its NAME is."""
        theirs = [layout.name for identifier, layout in self._j1939.items() if identifier & 0xFF == address]
        if theirs and len(name) == 8 and self._names.setdefault(address, name) != name:
            self._names[address] = name
            for message in theirs:
                _count(self.rejected.claimed, message)

    def _others(self, layout: Layout, little: int, big: int) -> Iterator[tuple[str, float, Quality]]:
        for selector in layout.selectors:
            if _there(selector.only, little, big) and selector.cut.raw(little, big) not in selector.known:
                _count(self.rejected.unknown_selector, layout.name)
        yield from (one.read(little, big, layout.j1939) for one in layout.others if _there(one.only, little, big))


def _there(only: Only, little: int, big: int) -> bool:
    return all(cut.raw(little, big) in values for cut, values in only)


def _count(counts: dict[str, int], name: str) -> None:
    counts[name] = counts.get(name, 0) + 1

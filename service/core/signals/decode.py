"""Frames to signals, in the units of the bundle, by a table that was compiled from a DBC (`core.signals.dbc`).

A frame gives all its signals or none, and so does a message of J1939 that comes in parts (`core.j1939.transport`), with
its last one. J1939's frames are matched on parameter group and source address (the priority may differ), so that a
second sender of the same group never overwrites a value; it is counted (`core.signals.senders`).

A second sender under the same address is known by when its frames come (`core.signals.arrivals`): their signals are
`DOUBTED`. So are those of a message that the DBC gives to any sender, and that several send.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from math import nan
from types import MappingProxyType
from typing import NamedTuple, Self

from faultline.service.core.j1939.identifiers import (
    ADDRESS_CLAIMED,
    DESTINATION_MASK,
    FRAME,
    PRIORITY_MASK,
    SOURCE_MASK,
    TP_CM,
    TP_DT,
    group_of,
    identifier_of,
    is_addressed,
    numbers_of,
)
from faultline.service.core.j1939.transport import Reassembler
from faultline.service.core.signals.arrivals import Arrival, Arrivals
from faultline.service.core.signals.layout import Layout, Only
from faultline.service.core.signals.senders import Senders
from faultline.service.core.signals.values import Quality

STANDARD, EXTENDED = 0x7FF, 0x1FFF_FFFF
BOUND = 1024
"""Identifiers of messages from any sender or to any destination that are kept; more are looked up anew."""

NONE: Mapping[str, str] = MappingProxyType({})
_GOOD = Quality.GOOD
_ALL_SENDERS = PRIORITY_MASK & ~SOURCE_MASK


class Wanted(NamedTuple):
    """Frames to be let through by a bus: those whose identifier equals `identifier` in the bits of `mask`."""

    identifier: int
    mask: int
    is_extended: bool


@dataclass
class Rejected:
    """Frames that matched and were not taken, by message."""

    short: dict[str, int] = field(default_factory=dict)  # shorter than in the DBC: none of their signals was taken
    other_source: dict[str, int] = field(default_factory=dict)  # the same parameter group of another sender
    unknown_selector: dict[str, int] = field(default_factory=dict)  # multiplexed by a value that the DBC does not know
    claimed: dict[str, int] = field(default_factory=dict)  # another device has claimed its sender's address
    senders: dict[str, set[int]] = field(default_factory=dict)  # source addresses of `other_source`, some
    early: dict[str, int] = field(default_factory=dict)  # far too soon after the one before to be the same sender's
    unclear: dict[str, int] = field(default_factory=dict)  # from any sender by the DBC, and several send it

    @property
    def total(self) -> int:
        """Return the count over all reasons and messages."""
        kinds = (self.short, self.other_source, self.unknown_selector, self.claimed, self.early, self.unclear)
        return sum(sum(counts.values()) for counts in kinds)


class DecodeTable:
    """Decodes the wanted signals of a bus; everything else is ignored.

    Frames are counted by message: those `taken`, and those that were `rejected`, why. `parts` puts together the
    messages that are longer than a frame of J1939; None where none is wanted. `units` are those of the wanted signals
    by name, also of signals that a table beside the bus gives. `buses` are the tables of other buses of the vehicle
    whose messages are wanted too, by the buses' names; what is counted is counted here for all of them.
    """

    def __init__(self, layouts: Mapping[tuple[int, bool], Layout], units: Mapping[str, str] = NONE) -> None:
        """`layouts` by identifier, one of J1939 without priority, and whether it has 29 bits."""
        self.units = units
        self.buses: dict[str, DecodeTable] = {}
        self._layouts = tuple(layouts.values())
        extended = [layout for (_, is_extended), layout in layouts.items() if is_extended]
        j1939 = [layout for layout in extended if layout.j1939]
        self._exact = {layout.identifier: layout for layout in j1939 if layout.mask == PRIORITY_MASK}
        self._j1939 = dict(self._exact)  # and identifiers that were seen of the others
        self._other = {layout.identifier: layout for layout in extended if not layout.j1939}
        self._standard = {n: layout for (n, is_extended), layout in layouts.items() if not is_extended}
        self._senders = senders = Senders(j1939)
        self.parts = Reassembler(self._name_of) if any(layout.size > FRAME for layout in j1939) else None
        groups = {*senders.groups, ADDRESS_CLAIMED} | ({TP_CM, TP_DT} if self.parts is not None else set())
        self._near = frozenset(number for pgn in groups for number in numbers_of(pgn)) if j1939 else frozenset()
        self.taken = {layout.name: 0 for layout in layouts.values()}
        self.repeated = dict(self.taken)
        self.rejected = Rejected(other_source=senders.others, claimed=senders.claimed, senders=senders.other)
        self.arrivals = {layout.name: Arrivals(layout.period_s) for layout in layouts.values() if layout.period_s}

    def bear(self, jitter_s: Mapping[str, float]) -> None:
        """Bear the jitter [s] of the messages that signals come with, by signal (`core.signals.arrivals`)."""
        for layout in self._layouts:
            if (arrivals := self.arrivals.get(layout.name)) is not None:
                arrivals.jitter_s = max((jitter_s.get(name, 0.0) for name in layout.signals), default=0.0)
        for table in self.buses.values():
            table.bear(jitter_s)

    def period_s(self, signal: str) -> float | None:
        """Return the period [s] of the message that a signal comes with; None where the DBC says none, or no such."""
        for table in (self, *self.buses.values()):
            for layout in table.layouts:
                if signal in layout.signals:
                    return layout.period_s
        return None

    def add_bus(self, name: str, table: Self) -> None:
        """Add the messages of another bus, whose frames `table` decodes; they are counted here from now on."""
        self.buses[name] = table
        for counts, other in ((self.taken, table.taken), (self.repeated, table.repeated)):
            counts.update(other)
        table.taken, table.repeated, table.rejected = self.taken, self.repeated, self.rejected
        table.sources.count_in(self.sources)

    def of_bus(self, name: str) -> "DecodeTable":
        """Return the table of a bus; this one for the bus without a name."""
        return self.buses[name] if name else self

    @property
    def layouts(self) -> tuple[Layout, ...]:
        """Return the layouts of the messages that carry wanted signals, without those of other buses."""
        return self._layouts

    @property
    def all_layouts(self) -> tuple[Layout, ...]:
        """Return the layouts of the messages of all buses."""
        return sum((table.layouts for table in self.buses.values()), self._layouts)

    @property
    def wanted(self) -> tuple[Wanted, ...]:
        """Return the filters of a bus: of a J1939 group the frames of all senders, so that a second one is seen."""
        found = {Wanted(n, STANDARD, False) for n in self._standard} | {Wanted(n, EXTENDED, True) for n in self._other}
        found |= {whole_group(pgn) for pgn in self._senders.groups}
        claim = identifier_of(ADDRESS_CLAIMED, 0)
        if (addresses := self._senders.addresses) is None:
            found.add(Wanted(claim, _ALL_SENDERS, True))
        else:
            found |= {Wanted(claim | address, PRIORITY_MASK, True) for address in addresses}
        if self.parts is not None:
            found |= {whole_group(TP_CM), whole_group(TP_DT)}
        return tuple(sorted(found))

    def carries(self, can_id: int, is_extended: bool) -> bool:
        """True if frames of this identifier carry wanted signals, or parts of messages of their senders."""
        if is_extended and self.parts is not None and group_of(can_id) in (TP_CM, TP_DT):
            addresses = self._senders.addresses
            return addresses is None or can_id & SOURCE_MASK in addresses
        return self.layout_of(can_id, is_extended) is not None

    def layout_of(self, can_id: int, is_extended: bool) -> Layout | None:
        """Return the message that frames of this identifier carry whole; None if it is none that is wanted."""
        if not is_extended:
            return self._standard.get(can_id)
        return self._exact.get(can_id & PRIORITY_MASK) or self._other.get(can_id) or self._senders.match(can_id)

    @property
    def near(self) -> Collection[int]:
        """What stands in 29-bit identifiers of J1939, in place of the group's number, of the frames that count."""
        return self._near

    @property
    def sources(self) -> Senders:
        """Who sends the messages of J1939."""
        return self._senders

    @property
    def senders(self) -> Mapping[str, Mapping[int, int]]:
        """Frames by source address, of each message that the DBC gives to any sender."""
        return self._senders.counts

    def remarks(self) -> list[str]:
        """Return what is worth knowing of a log, a sentence each: senders of what the DBC gives to any, lost parts."""
        sole, not_whole = self._senders.sole(), self.parts.not_whole() if self.parts is not None else []
        for table in self.buses.values():
            sole += table.sources.sole()
            not_whole += table.parts.not_whole() if table.parts is not None else []
        found = [f"of any sender, by the DBC: {', '.join(sole)}"] if sole else []
        return [*found, f"messages that are not whole, and not used: {', '.join(not_whole)}"] if not_whole else found

    def strangers(self) -> list[str]:
        """Return what to decide or mend, a sentence each: messages that several send, or that came from others only."""
        found = self._senders.unclear(self.taken)
        return found + [text for table in self.buses.values() for text in table.strangers()]

    def undecided(self, identifiers: Collection[tuple[int, bool]]) -> list[str]:
        """Return, of all identifiers of a log (and whether they have 29 bits), which messages several send."""
        return self._senders.undecided([can_id for can_id, is_extended in identifiers if is_extended])

    def incomplete(self) -> Counter[str]:
        """Return by message how many came in parts that were not all there."""
        found: Counter[str] = Counter()
        for (name, _why), count in self.parts.losses.items() if self.parts is not None else ():
            found[name] += count
        for table in self.buses.values():
            found += table.incomplete()
        return found

    def run_at(self, speed: float) -> None:
        """Set how many times real time goes by: a sender that is held up is held up in real time."""
        for arrivals in self.arrivals.values():
            arrivals.speed = max(1.0, speed)
        if self.parts is not None:
            self.parts.speed = max(1.0, speed)
        for table in self.buses.values():
            table.run_at(speed)

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
            is_near = is_extended and can_id >> 8 & 0x3FFFF in self._near
            return self._looked_up(can_id, data, t) if is_near else []
        if layout.is_from_any and not self._senders.is_sole(layout, can_id & SOURCE_MASK):
            _count(self.rejected.unclear, layout.name)
            return _doubted(layout)
        if len(data) != layout.size:
            if len(data) < layout.size:
                _count(self.rejected.short, layout.name)
                return []
            data = data[: layout.size]
        arrivals = None if t is None else self.arrivals.get(layout.name)
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

    def _looked_up(self, can_id: int, data: bytes, t: float | None) -> list[tuple[str, float, Quality]]:
        """As `decode`, of an identifier of 29 bits that is not known yet, or carries no whole message."""
        if self.parts is not None and group_of(can_id) in (TP_CM, TP_DT):
            whole = self.parts.take(0.0 if t is None else t, can_id, data)
            return [] if whole is None else self.decode(whole.identifier, True, whole.data, t)
        layout = self._senders.match(can_id)
        if layout is None:
            self._senders.take_other(can_id, data)
            return []
        if len(self._j1939) >= BOUND + len(self._exact):
            self._j1939 = dict(self._exact)
        self._j1939[can_id & PRIORITY_MASK] = layout
        return self.decode(can_id, True, data, t)

    def _name_of(self, identifier: int) -> str | None:
        """The message that is announced to come in parts; None if it is not wanted."""
        layout = self._senders.match(identifier)
        if layout is None:
            self._senders.take_other(identifier, b"")
        return layout.name if layout is not None and layout.size > FRAME else None

    def _undue(self, layout: Layout, came: Arrival) -> list[tuple[str, float, Quality]]:
        """Count a frame that came too soon; one that is no repetition makes its signals doubted."""
        if came is Arrival.REPEATED:
            self.repeated[layout.name] += 1
            return []
        _count(self.rejected.early, layout.name)
        return _doubted(layout)

    def _others(self, layout: Layout, little: int, big: int) -> Iterator[tuple[str, float, Quality]]:
        for selector in layout.selectors:
            if _there(selector.only, little, big) and selector.cut.raw(little, big) not in selector.known:
                _count(self.rejected.unknown_selector, layout.name)
        yield from (one.read(little, big, layout.j1939) for one in layout.others if _there(one.only, little, big))


def whole_group(pgn: int) -> Wanted:
    """Return all frames of a parameter group of J1939, from whomever to whomever."""
    mask = _ALL_SENDERS & ~DESTINATION_MASK if is_addressed(pgn) else _ALL_SENDERS
    return Wanted(pgn << 8, mask, True)


def _doubted(layout: Layout) -> list[tuple[str, float, Quality]]:
    return [(name, nan, Quality.DOUBTED) for name in layout.signals]


def _there(only: Only, little: int, big: int) -> bool:
    return all(cut.raw(little, big) in values for cut, values in only)


def _count(counts: dict[str, int], name: str) -> None:
    counts[name] = counts.get(name, 0) + 1

"""How the frames of one table come: which do not, which come from more than one, which are not as the DBC says."""

from collections.abc import Iterator, Mapping, Sequence

from service.core.decode import DecodeTable, Layout
from service.core.health import Condition, Kind
from service.core.manifest import Input
from service.core.signals import Qualities, Quality

WINDOW_S = 10.0
"""Frames are counted over so long."""
TOO_MANY = 1.5
"""More than so many times as many frames as the DBC's cycle time allows are of more than one sender."""
SLACK = 3
"""Frames more that a window may have: its ends, and one that waited."""
EXPECTED_S = 30.0
"""With the ignition on every sender has spoken by then."""

DOUBTFUL = ("second-sender", "address-claim")

_WORTH: Mapping[int, Kind] = {
    Quality.MISSING: "missing",
    Quality.LATE: "missing",
    Quality.NOT_AVAILABLE: "not-available",
    Quality.ERROR: "error",
    Quality.RESERVED: "error",
    Quality.OUT_OF_RANGE: "out-of-range",
    Quality.FROZEN: "frozen",
    Quality.JUMP: "jump",
}
"""What is `DOUBTED` has been found here."""


class Traffic:
    """Looks at a table's counts now and then. State: the counts at the last window's end."""

    def __init__(self, table: DecodeTable, inputs: Sequence[Input], begin_s: float) -> None:
        self._table = table
        self._signals = [channel.signal for channel in inputs]
        self._messages = {layout.name: layout for layout in table.layouts}
        self._begin = self._heard = begin_s
        self._total = sum(table.taken.values())
        self._counts = self._snapshot()
        self._found: set[Condition] = set()

    def look(self, t: float, quality: Qualities | None) -> set[Condition]:
        """What is wrong at time `t` [s], with what the signals (nz,) were worth at the last tick, if there was one."""
        total = sum(self._table.taken.values())
        if total > self._total:
            self._total, self._heard = total, t
        if t - self._begin >= WINDOW_S:
            before, self._counts = self._counts, self._snapshot()
            self._found = {*self._in_window(t - self._begin, before)}
            self._begin = t
        if t - self._heard >= EXPECTED_S:
            return self._found | {Condition("no-traffic", ", ".join(self._messages))}
        worth = [] if quality is None else zip(self._signals, quality.tolist(), strict=True)
        return self._found | {Condition(_WORTH[q], signal) for signal, q in worth if q in _WORTH}

    @property
    def doubted(self) -> frozenset[str]:
        """The signals of messages that are not surely their sender's, as far as the last window showed."""
        doubted = [self._messages[each.of] for each in self._found if each.kind in DOUBTFUL]
        return frozenset(signal for layout in doubted for signal in layout.signals)

    def _in_window(self, seconds: float, before: Mapping[str, Mapping[str, int]]) -> Iterator[Condition]:
        now = self._counts
        for name, layout in self._messages.items():
            more = {what: counts.get(name, 0) - before[what].get(name, 0) for what, counts in now.items()}
            if _too_many(layout, more["taken"], seconds) or (more["other_source"] and not _is_proprietary(layout)):
                yield Condition("second-sender", name)
            if more["claimed"]:
                yield Condition("address-claim", name)
            if more["short"]:
                yield Condition("short-frames", name)
            if more["unknown_selector"]:
                yield Condition("unknown-selector", name)

    def _snapshot(self) -> dict[str, dict[str, int]]:
        rejected = self._table.rejected
        counts = {
            "taken": self._table.taken,
            "other_source": rejected.other_source,
            "short": rejected.short,
            "unknown_selector": rejected.unknown_selector,
            "claimed": rejected.claimed,
        }
        return {what: dict(each) for what, each in counts.items()}


def _too_many(layout: Layout, count: int, seconds: float) -> bool:
    return layout.period_s is not None and count > TOO_MANY * seconds / layout.period_s + SLACK


def _is_proprietary(layout: Layout) -> bool:
    """Whether the group is its senders' own (PF 239 or 255, SAE J1939-21): each may mean something else by it."""
    return layout.identifier >> 16 & 0xFF in (0xEF, 0xFF)

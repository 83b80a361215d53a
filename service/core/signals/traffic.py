"""Traffic check of one table: frames that are absent, of several senders, or not as in the DBC."""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from faultline.service.core.manifest import Input
from faultline.service.core.records.health import Condition, Kind
from faultline.service.core.signals.decode import DecodeTable
from faultline.service.core.signals.layout import Layout
from faultline.service.core.signals.values import Qualities, Quality

WINDOW_S = 10.0
"""What is wrong with frames is told for so long after the last one."""
TOO_MANY: Mapping[float, float] = {3.0: 1.5, 10.0: 1.5, 60.0: 1.25}
"""Within so many seconds, of real time, more than so many times as many frames as the DBC's cycle time allows are of
more than one sender: two are seen within three seconds, and one that adds every third frame within a minute. Of a
message slower than 25 Hz a frame that comes too early tells at once (`core.signals.arrivals`)."""
SLACK = 3
"""Frames more that a window may have: its ends, and one that waited."""
COUNTED_S = 1.0
"""Frames are counted so often."""
EXPECTED_S = 30.0
"""With the ignition on every sender has spoken by then; of real time, as log time begins with the first frame."""
SILENT_S, QUIET_S = 5.0, 2.0
"""All senders together are silent for a reason of their own, as the ignition: after `QUIET_S` no single signal is
missing, after `SILENT_S` nothing comes any more; later where messages come less often than every second."""

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


class _Count(NamedTuple):
    """Counts by what and message, of all frames up to time `t` [s]."""

    t: float
    by: Mapping[str, Mapping[str, int]]


class Traffic:
    """Looks at a table's counts now and then. State: the counts of the last minute.

    Frames are counted by the time at which they came, which may be long before they are taken. `speed` is how many
    times real time goes by: a sender that is held up is held up in real time.
    """

    def __init__(self, table: DecodeTable, inputs: Sequence[Input], begin_s: float, speed: float = 1.0) -> None:
        self._table = table
        self._signals = [channel.signal for channel in inputs]
        self._messages = {layout.name: layout for layout in table.all_layouts}
        self._heard: float | None = None  # when the last expected frame came
        self._begin, self._stretch = begin_s, max(1.0, speed)
        slowest = max((layout.period_s or 0.0 for layout in table.all_layouts), default=0.0)
        self._quiet_s, self._silent_s = max(QUIET_S, 2.0 * slowest), max(SILENT_S, 3.0 * slowest)
        self._total = self._expected()
        self._counts = deque([_Count(begin_s, self._counted())])
        self._doubted: dict[str, float] = {}  # signal: since when
        self._looked = begin_s

    def note(self, t: float) -> None:
        """Note that all frames up to time `t` [s] have been decoded, if there were any."""
        if (total := self._expected()) > self._total:
            self._total, self._heard = total, t
        if t - self._counts[-1].t >= self._stretch * COUNTED_S:
            self._counts.append(_Count(t, self._counted()))
            while t - self._counts[1].t >= self._stretch * max(TOO_MANY):
                self._counts.popleft()

    def look(self, t: float, quality: Qualities | None) -> set[Condition]:
        """Return the conditions at time `t` [s]; `quality` is that of the signals (nz,) at the last tick, if any."""
        silent = t - (self._begin if self._heard is None else self._heard)
        crowded, claimed, others = dict(self._crowded()), {*self._more("claimed")}, {*self._more("other_source")}
        doubts = dict.fromkeys(claimed, self._stretch * COUNTED_S) | crowded
        since = {signal: t - age for name, age in doubts.items() for signal in self._messages[name].signals}
        self._doubted = {signal: min(at, self._doubted.get(signal, at)) for signal, at in since.items()}
        self._looked = t
        strangers = {name for name in others if not _is_proprietary(self._messages[name])}
        several = {*crowded, *strangers, *self._more("early"), *self._more("unclear")}
        found = {Condition("second-sender", name) for name in several}
        found |= {Condition("address-claim", name) for name in claimed}
        found |= {Condition("short-frames", name) for name in self._more("short")}
        found |= {Condition("unknown-selector", name) for name in self._more("unknown_selector")}
        found |= {Condition("incomplete", name) for name in self._more("incomplete")}
        if silent >= (self._stretch * EXPECTED_S if self._heard is None else self._silent_s):
            return found | {Condition("no-traffic", ", ".join(self._messages))}
        if quality is None or silent >= self._quiet_s:
            return found
        worth = zip(self._signals, quality.tolist(), strict=True)
        return found | {Condition(_WORTH[q], signal) for signal, q in worth if q in _WORTH}

    @property
    def doubted(self) -> Mapping[str, float]:
        """Return the signals of messages with doubted senders, and for how long [s] before the last look."""
        return {signal: self._looked - since for signal, since in self._doubted.items()}

    def _expected(self) -> int:
        """Return the number of expected frames that came, complete or not."""
        table, rejected = self._table, self._table.rejected
        counts = table.taken, table.repeated, rejected.short, rejected.early, rejected.unclear
        return sum(sum(each.values()) for each in counts)

    def _crowded(self) -> Iterator[tuple[str, float]]:
        """Yield messages that come more often than one sender sends them, and within how long that was seen [s]."""
        now = self._counts[-1]
        for window, times in TOO_MANY.items():
            if now.t - self._counts[0].t < self._stretch * window:
                break  # what waited for us to begin is no crowd
            before = self._before(self._stretch * window)
            for name, layout in self._messages.items():
                more = now.by["taken"][name] - before.by["taken"][name]
                if layout.period_s is not None and more > times * (now.t - before.t) / layout.period_s + SLACK:
                    yield name, self._stretch * window

    def _more(self, what: str) -> Iterator[str]:
        """Yield messages of which such frames came lately."""
        before, counts = self._before(WINDOW_S).by[what], self._counted()[what]
        return (name for name in self._messages if counts.get(name, 0) > before.get(name, 0))

    def _before(self, seconds: float) -> _Count:
        """Return the counts so long ago, or the first there are."""
        until = self._counts[-1].t - seconds
        return next((each for each in reversed(self._counts) if each.t <= until), self._counts[0])

    def _counted(self) -> dict[str, dict[str, int]]:
        rejected = self._table.rejected
        counts = {
            "taken": self._table.taken,
            "other_source": rejected.other_source,
            "short": rejected.short,
            "unknown_selector": rejected.unknown_selector,
            "claimed": rejected.claimed,
            "early": rejected.early,
            "unclear": rejected.unclear,
            "incomplete": self._table.incomplete(),
        }
        return {what: dict(each) for what, each in counts.items()}


def _is_proprietary(layout: Layout) -> bool:
    """Return True if the group is proprietary (PF 239 or 255, SAE J1939-21): each sender may mean something else."""
    return layout.identifier >> 16 & 0xFF in (0xEF, 0xFF)

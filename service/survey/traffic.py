"""Statistics of the messages of a log, from its batches: counts, rates, lengths, gaps and some of the data."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from heapq import nlargest

import numpy as np

from faultline.service.core.j1939.identifiers import TP_CM, TP_DT
from faultline.service.core.j1939.transport import Reassembler
from faultline.service.core.signals.values import FloatArray
from faultline.service.logs.batch import Batch
from faultline.service.logs.seen import keys_of, parts_of

GAP_PERIODS, GAP_S = 10.0, 1.0
"""A silence is a gap if it is longer than so many periods of the message, and than this [s]."""

_MOST_GAPS = 20  # of a message that are remembered, the longest
_STEPS = 1000  # between frames, of which the median is the period
_SPACED, _MOST_DATA = 8, 4000  # frames of each batch, and of all, whose data are kept

_FORMATS = [TP_CM >> 8, TP_DT >> 8]


@dataclass
class MessageTraffic:
    """The data frames of one identifier on one channel. Times are after the log's first data frame [s]."""

    channel: int
    identifier: int
    is_extended: bool
    count: int = 0
    first_s: float = 0.0
    last_s: float = 0.0
    shortest: int = 64
    longest: int = 0
    lengths: dict[int, int] = field(default_factory=dict)
    data: list[bytes] = field(default_factory=list)
    _steps: list[float] = field(default_factory=list)
    _silences: list[tuple[float, float]] = field(default_factory=list)  # how long, from when

    def take(self, data: bytes) -> None:
        """Take one that came in parts; when it came is not kept."""
        self.count += 1
        self.lengths[len(data)] = self.lengths.get(len(data), 0) + 1
        if len(self.data) < _MOST_DATA:
            self.data.append(data)

    @property
    def rate(self) -> float | None:
        """Frames a second, None of a single one."""
        return (self.count - 1) / (self.last_s - self.first_s) if self.last_s > self.first_s else None

    @property
    def period_s(self) -> float | None:
        """The median of the time from frame to frame [s]; None where there are not enough."""
        return float(np.median(self._steps)) if len(self._steps) > 1 else None

    def gaps(self, end_s: float) -> list[tuple[float, float]]:
        """When each of the longest silences began and how long it was [s], up to the log's end."""
        if self.period_s is None:
            return []
        least = max(GAP_S, GAP_PERIODS * self.period_s)
        silences = [*self._silences, (end_s - self.last_s, self.last_s)]
        return sorted((begin, length) for length, begin in silences if length > least)

    def add(self, time: FloatArray, batch: Batch) -> None:
        """Take the frames of a batch, at `time` (N,)."""
        lengths = batch.length
        if not self.count:
            self.first_s = self.last_s = float(time[0])
            time_before = time[:-1]
            steps = np.diff(time)
        else:
            time_before = np.concatenate([[self.last_s], time[:-1]])
            steps = time - time_before
        self._steps += steps[: _STEPS - len(self._steps)].tolist() if len(self._steps) < _STEPS else []
        long = np.flatnonzero(steps > GAP_S)
        if len(long):
            found = zip(steps[long].tolist(), time_before[long].tolist(), strict=True)
            self._silences = nlargest(_MOST_GAPS, [*self._silences, *found])
        self.count += len(time)
        self.last_s = float(time[-1])
        for length, count in enumerate(np.bincount(lengths).tolist()):
            if count:
                self.lengths[length] = self.lengths.get(length, 0) + count
        self.shortest, self.longest = min(self.lengths), max(self.lengths)
        if len(self.data) < _MOST_DATA:
            some = batch[slice(None, None, max(1, len(batch) // _SPACED))]
            self.data += [frame.data for frame in some.frames()]


class LogTraffic:
    """State: the messages so far, by key (`logs.seen`), and the frames without data of each channel."""

    def __init__(self, start_s: float, *, has_times: bool) -> None:
        self._start_s, self._has_times = start_s, has_times
        self.messages: dict[int, MessageTraffic] = {}
        self.without_data: dict[int, int] = {}

    def add(self, batch: Batch) -> None:
        """Take a batch."""
        has_data = batch.has_data
        for channel, count in enumerate(np.bincount(batch.channel[~has_data]).tolist()):
            self.without_data[channel] = self.without_data.get(channel, 0) + count
        batch = batch[has_data]
        keys = keys_of(batch)
        order = np.argsort(keys, kind="stable")
        begins = np.flatnonzero(np.diff(keys[order], prepend=keys[order][:1] + np.uint64(1)))
        time = batch.time - self._start_s if self._has_times else np.zeros(len(batch))
        for rows in np.split(order, begins[1:]) if len(order) else []:
            key = int(keys[rows[0]])
            if key not in self.messages:
                self.messages[key] = MessageTraffic(*parts_of(key))
            self.messages[key].add(time[rows], batch[rows])


class WholeMessages:
    """Puts together what comes in parts of messages that `name_of` names. State: a reassembler of each channel.

    `messages` are those that were whole, by channel and identifier; `announced` the identifiers of all.
    """

    def __init__(self, name_of: Callable[[int], str | None]) -> None:
        self._name_of = name_of
        self._reassemblers: dict[int, Reassembler] = {}
        self.messages: dict[tuple[int, int], MessageTraffic] = {}
        self.announced: set[int] = set()

    def add(self, batch: Batch) -> None:
        """Take a batch."""
        is_part = np.isin(batch.identifier >> 16 & 0x3FF, _FORMATS) & batch.is_extended & batch.has_data
        if is_part.any():
            batch = batch[is_part]
            for channel, frame in zip(batch.channel.tolist(), batch.frames(), strict=True):
                if channel not in self._reassemblers:
                    self._reassemblers[channel] = Reassembler(self._named)
                time = 0.0 if frame.t != frame.t else frame.t
                whole = self._reassemblers[channel].take(time, frame.can_id, frame.data)
                if whole is not None:
                    key = channel, whole.identifier
                    self.messages.setdefault(key, MessageTraffic(*key, is_extended=True)).take(whole.data)

    def losses(self, name: str) -> Counter[str]:
        """Return how many messages of this name were not whole, by why."""
        found: Counter[str] = Counter()
        for each in self._reassemblers.values():
            found.update({why: count for (of, why), count in each.losses.items() if of == name})
            found.update({"cut off by the end": each.unfinished[name]} if each.unfinished[name] else {})
        return found

    def _named(self, identifier: int) -> str | None:
        self.announced.add(identifier)
        return self._name_of(identifier)

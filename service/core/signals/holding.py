"""Samples of a whole column at once: what `Sampler` does value by value, equal in every bit.

A column ends in the same state as if each of its values had been received; the next one goes on from there.
"""

from collections.abc import Sequence
from math import inf, isfinite, isnan
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from faultline.service.core.signals.latest import DOUBTED_S, NO_NUMBER, Latest
from faultline.service.core.signals.received import Column, Received
from faultline.service.core.signals.values import FloatArray, Indices, Mask, Qualities, Quality

_GOOD, _MISSING, _LATE, _DOUBTED = (int(one) for one in (Quality.GOOD, Quality.MISSING, Quality.LATE, Quality.DOUBTED))
_FROZEN, _JUMP = int(Quality.FROZEN), int(Quality.JUMP)
_IS_NO_NUMBER = np.array([int(one) in NO_NUMBER for one in Quality])


class Doubt(NamedTuple):
    """A signal that came to be doubted from its sample at `since` [s] on, by a frame before which came one at `t`."""

    t: float
    signal: str
    since: float


class Held(NamedTuple):
    """What was known of an input after each of K values, which came at `came` (K,) [s]: (K + 1,) with the state before.

    `value`, `time` and `quality` are those of `Latest`, and `doubted_until`; `last_good` was it before the first.
    """

    latest: Latest
    came: FloatArray
    value: FloatArray
    time: FloatArray
    quality: Qualities
    doubted_until: FloatArray
    last_good: float

    def at(self, t: FloatArray, last: Indices) -> tuple[FloatArray, Qualities]:
        """Values (n,) and what each is worth (n,) at log times `t` (n,) [s], after `last` (n,) of the K values each."""
        quality = self.quality[last]
        is_late = (t - self.time[last] > self.latest.maximum_age) & (quality != _MISSING)
        is_doubted = (self.latest.is_doubted | (t < self.doubted_until[last])) & (quality == _GOOD)
        quality[is_doubted] = _DOUBTED
        quality[is_late] = _LATE
        return self.value[last], quality

    def since(self) -> FloatArray:
        """Return when each value came (K + 1,) [s], NaN where there is none."""
        good = np.maximum.accumulate(np.where(self.quality == _GOOD, np.arange(len(self.quality)), -1))
        return np.where(good < 0, self.last_good, self.time[good])


class Samples:
    """What all inputs were at any time of one piece of a log.

    `complete_s` is the log time [s] from which on each has had a usable value, None where one has none; `doubts` are in
    the order in which they came.
    """

    def __init__(self, inputs: Sequence[Latest], received: Received) -> None:
        self._held: list[Held] = []
        came = {id(column.row): received.time[column.row] for column in received.columns.values()}
        doubts: list[tuple[int, Doubt]] = []
        complete = received.first_s
        for latest in inputs:
            column = received.columns.get(latest.signal, _NOTHING)
            was_usable = not isnan(latest.value)
            held, found = _hold(latest, column, came.get(id(column.row), _NEVER), received.before)
            self._held.append(held)
            doubts += found
            if not was_usable:
                usable = np.flatnonzero(~np.isnan(held.value))
                complete = max(complete, float(held.came[usable[0] - 1]) if len(usable) else inf)
        self.complete_s = complete if complete < inf else None
        self.doubts = [doubt for _, doubt in sorted(doubts, key=lambda each: each[0])]

    def at(self, t: FloatArray) -> tuple[FloatArray, Qualities]:
        """Values (n, nz) [bundle units] and what each is worth (n, nz) at log times `t` (n,) [s]."""
        values, qualities = np.empty((len(t), len(self._held))), np.empty((len(t), len(self._held)), np.int8)
        last: dict[int, Indices] = {}  # signals of one message came together
        for k, held in enumerate(self._held):
            key = id(held.came)
            last[key] = last[key] if key in last else np.searchsorted(held.came, t, "right")
            values[:, k], qualities[:, k] = held.at(t, last[key])
        return values, qualities

    def ages(self, t: FloatArray) -> FloatArray:
        """Return the time from each value's frame to log times `t`, (n, nz) [s]; NaN where there never was one."""
        return np.stack([t - held.since()[np.searchsorted(held.came, t, "right")] for held in self._held], axis=1)


_NEVER = np.zeros(0)
_NOTHING = Column(np.zeros(0, np.intp), np.zeros(0), np.zeros(0, np.int8))


def _hold(latest: Latest, column: Column, came: FloatArray, before: FloatArray) -> tuple[Held, list[tuple[int, Doubt]]]:
    """Take a column whose values `came` (K,) [s]; return what was known after each, and the doubts with their rows.

    `before` (N,) are the times of the frames before the rows.
    """
    doubted = column.quality == _DOUBTED
    if not doubted.any():
        return _taken(latest, came, column.value, column.quality, None), []
    held = _taken(latest, came, column.value, column.quality, doubted)
    found = []
    for k in np.flatnonzero(doubted & (came >= held.doubted_until[:-1])).tolist():
        row, last = int(column.row[k]), float(held.time[k])
        since = last if isfinite(last) else float(came[k])
        found.append((row, Doubt(float(before[row]), latest.signal, since)))
    return held, found


def _taken(latest: Latest, came: FloatArray, value: FloatArray, quality: Qualities, doubted: Mask | None) -> Held:
    """Return what was known after each of K values, those of them that are `doubted` (K,) taken for none."""
    until, last_good = np.full(len(came) + 1, latest.doubted_until), latest.last_good
    if doubted is None:
        return Held(latest, came, *_judged(latest, came, value, quality), until, last_good)
    until[1:][doubted] = came[doubted] + DOUBTED_S
    until = np.maximum.accumulate(until)
    values, times, qualities = _judged(latest, came[~doubted], value[~doubted], quality[~doubted])
    after = np.concatenate([[0], np.cumsum(~doubted)])
    latest.doubted_until = float(until[-1])
    return Held(latest, came, values[after], times[after], qualities[after], until, last_good)


def _judged(
    latest: Latest, t: FloatArray, value: FloatArray, quality: Qualities
) -> tuple[FloatArray, FloatArray, Qualities]:
    """Take K values that are not doubted; return value, time and quality after each (K + 1,), and before the first."""
    is_good = quality == _GOOD
    good = slice(None) if is_good.all() else np.flatnonzero(is_good)
    times, qualities = _behind(latest.time, t), _behind(latest.quality, quality)
    if is_good.any():
        qualities[1:][good] = _plausible(latest, times, value, qualities, good)
    values = _behind(latest.value, value)
    is_believed = qualities == _GOOD
    if not is_believed[1:].all():
        is_believed[0] = True
        values = values[np.maximum.accumulate(np.where(is_believed, np.arange(len(values)), 0))]
    if qualities[-1] != _GOOD and (good := np.flatnonzero(qualities == _GOOD)).size:
        latest.last_good = float(times[good[-1]])
    latest.value, latest.time, latest.quality = float(values[-1]), float(times[-1]), int(qualities[-1])
    return values, times, qualities


def _plausible(
    latest: Latest, times: FloatArray, value: FloatArray, qualities: Qualities, good: Indices | slice
) -> Qualities:
    """What the values (K,) in the rows `good` (G,) are worth (G,), as `Latest.plausible` says of each.

    `times` and `qualities` (K + 1,) begin with those before the first value.
    """
    at, now = times[1:][good], value[good]
    before = _behind(latest.number, now)[:-1]
    last_quality = qualities[:-1][good]
    is_away = at - times[:-1][good] > latest.maximum_age
    found = np.zeros(len(now), np.int8)
    if isfinite(latest.frozen_s):
        rests = now == before
        if rests.any():
            rests &= ~is_away & ~_IS_NO_NUMBER.take(last_quality) & (latest.lower < now) & (now < latest.upper)
        changed = np.maximum.accumulate(_behind(latest.changed, np.where(rests, -inf, at)))
        found[rests & (at - changed[1:] > latest.frozen_s)] = _FROZEN
        latest.changed = float(changed[-1])
    if isfinite(latest.largest_step):
        with np.errstate(all="ignore"):
            is_far = np.abs(now - before) > latest.largest_step
        if is_far.any():
            far = np.flatnonzero(is_far & (found == _GOOD) & ~is_away & (last_quality != _MISSING))
            _mark_jumps(found, now, far, latest)
    latest.number = float(now[-1])
    return found


def _behind(first: float, column: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The column (K,) as (K + 1,) that begins with another value."""
    found = np.empty(len(column) + 1, column.dtype)
    found[0], found[1:] = first, column
    return found


def _mark_jumps(found: Qualities, value: FloatArray, far: Indices, latest: Latest) -> None:
    """Mark those in the rows `far` that are far from the last one that was good too."""
    found[far] = _JUMP  # until one is found to be good
    good = np.maximum.accumulate(np.where(found == _GOOD, np.arange(len(found)), -1))
    last = -1
    for k in far.tolist():
        last = max(last, int(good[k]))
        believed = latest.value if last < 0 else float(value[last])
        if not abs(float(value[k]) - believed) > latest.largest_step:
            found[k] = _GOOD
            last = k

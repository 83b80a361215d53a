"""The day: how far this drive's residuals lie from the vehicle's usual ones, learnt while nothing is suspected.

From one drive to the next a fluid's temperature, sensors' zeros and the level in the tank move all residuals, often by
more than a fault does; within a drive they hardly do. So what the first minutes show is taken off, by as much as days
are known to stray (`service.core.straying`): the mean of a mode moves those of modes that have not been visited yet.
A fault that was there from the start is taken off too where a day could look like it: only what days cannot do tells of
it, and `service.core.unlike` looks at that.

What a tick shows counts half a minute to a minute later, if nothing is suspected until then: what a fault does before
it is suspected must not become the day. And a day moves on: its sums forget, and no day is known better than `WANDER`.
"""

import numpy as np

from service.core.generators import NOTHING
from service.core.manifest import Evidence
from service.core.modes import EDGE
from service.core.signals import Mask, Vector
from service.core.straying import Level, Means, Straying, Visit

GUARD_TICKS = 150
"""30 s: what is newer waits, one to two times as long."""

REMEMBERED_TICKS = 6000
"""20 min: when so many ticks of a mode are known, half of them are forgotten."""

WANDER = 0.1
"""How far a day moves while it is used, in parts of how far days differ."""

WIDENED = 3.0
"""Detectors see residuals in parts of their spread and of so many standard deviations of what is unknown of the day."""


class Day:
    """What is known of the day. `level` is that; it changes every `GUARD_TICKS` only."""

    def __init__(self, evidence: Evidence) -> None:
        self._straying = Straying(evidence)
        self._offset, self._spread = np.array(evidence.offset), np.array(evidence.spread)
        self._shape = 3, *self._straying.offset.shape
        self._pending = 3 + len(evidence.hypotheses), *self._straying.offset.shape
        self.forget()

    def forget(self) -> None:
        """Begins anew: nothing is known."""
        self._known = np.zeros(self._shape)  # sums as in `Means`
        self._level = self._straying.unknown
        self.discard()

    def discard(self) -> None:
        """Something is suspected: what has been seen of late is not taken for the day's."""
        self._older, self._newer = np.zeros(self._pending), np.zeros(self._pending)
        self._visit = Visit(self._shape[-1])
        self._ticks = 0

    def add(self, mode: int, r: Vector, usable: Mask, shift: Vector = NOTHING, *, suspected: bool = False) -> None:
        """Takes the residuals (K,) of a tick and the shifts (H, K) of the hypotheses; not the day's if `suspected`."""
        self._visit.in_mode(mode)
        if mode != EDGE:
            part = self._newer[:, mode]
            part[0] += usable
            part[1] += usable * (2.0 * self._visit.length + 1.0)
            part[2] += np.where(usable, r, 0.0)
            if len(shift):
                part[3:] += np.where(usable, shift, 0.0)
            self._visit.length = self._visit.length + usable
        self._ticks += 1
        if self._ticks % GUARD_TICKS == 0:
            if not suspected:
                self._known += self._older[:3]
            self._older, self._newer = self._newer, np.zeros(self._pending)
            self._known[:, self._known[0] >= REMEMBERED_TICKS] /= 2.0
            self._learn()

    def taken_off(self, mode: int, r: Vector) -> Vector:
        """The residuals (K,) of a tick as detectors see them: without the day, and drawn to the offset.

        The less is known of the day, the nearer: a detector's threshold then is the spread of days, and not that of a
        drive. At an edge the day is the mean of those of all modes.
        """
        mean, variance = self._level.mean, self._level.variance
        mean, variance = (mean.mean(axis=0), variance.mean(axis=0)) if mode == EDGE else (mean[mode], variance[mode])
        wider = np.sqrt(1.0 + WIDENED**2 * variance / self._spread[mode] ** 2)
        return np.asarray(self._offset[mode] + (r - self._offset[mode] - mean) / wider)

    def _learn(self) -> None:
        level = self._straying.known(_means(self._known))
        self._level = Level(level.mean, level.covariance + WANDER**2 * self._straying.unknown.covariance)

    @property
    def recent(self) -> Means:
        """What has been seen of late, which is not taken for the day's yet."""
        return _means(self._older + self._newer)

    @property
    def level(self) -> Level:
        """Where the day puts the means."""
        return self._level


def _means(sums: Vector) -> Means:
    ticks, squares, total, *shift = sums
    return Means(ticks, np.minimum(squares, ticks**2), total, np.array(shift).reshape(-1, *ticks.shape))

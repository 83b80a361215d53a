"""The day: how far this drive's residuals lie from the vehicle's usual ones, learnt while nothing is suspected.

From one drive to the next a fluid's temperature, sensors' zeros and the level in the tank move all residuals, often by
more than a fault does; within a drive they hardly do. So what the first minutes show is taken off, by as much as days
are known to stray (`core.decision.straying`): the mean of a mode moves those of modes that have not been visited yet.
A fault that was there from the start is taken off too where a day could look like it: only what days cannot do tells of
it, and `core.decision.unlike` looks at that.

What a tick shows counts half a minute to a minute later, if nothing is suspected until then: what a fault does before
it is suspected must not become the day. And a day moves on. Its sums forget, no day is known better than `WANDER`, and
one that nothing has been learnt of for a while comes back to the usual one, as an Ornstein-Uhlenbeck process does:

    mean <- mean * f,  P <- P0 + f^2 (P - P0),  f = exp(-t / tau)
"""

import numpy as np

from faultline.service.core.decision.straying import Level, Means, Straying, Visit
from faultline.service.core.manifest import Evidence
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.signals.values import FloatArray, Mask
from faultline.service.core.time_scale import Span, TimeScale

GUARD = Span(settlings=1.5)
"""What is newer waits, one to two times as long."""

REMEMBERED = Span(settlings=60, seconds=1200)
"""When so much of a mode is known, half of it is forgotten."""

WANDER = 0.1
"""How far a day moves while it is learnt, in parts of how far days differ."""

TAU = Span(settlings=1800, seconds=36_000)
"""A day that nothing is learnt of moves by a seventh of how far days differ in a hundredth of that, by
two fifths in a tenth."""

WIDENED = 3.0
"""Detectors see residuals in parts of their spread and of so many standard deviations of what is unknown of the day."""


class Day:
    """What is known of the day. `level` is that; it changes every `GUARD` only."""

    def __init__(self, evidence: Evidence, time: TimeScale) -> None:
        self._guard, self._tau = time.ticks(GUARD), time.ticks(TAU)
        self._remembered = time.ticks(REMEMBERED)
        self._straying = Straying(evidence)
        followers = evidence.followers
        self._offset = np.column_stack([evidence.offset, *(f.offset for f in followers)])  # (modes, K + F)
        self._spread = np.column_stack([evidence.spread, *(f.spread for f in followers)])
        self._shape = 3, *self._straying.offset.shape
        self.forget()

    def forget(self) -> None:
        """Begins anew: nothing is known."""
        self._known = np.zeros(self._shape)  # sums as in `Means`, since what was known `before` them
        self._before = self._straying.unknown
        self._put(self._before)
        self._aged = 0  # ticks of which nothing was learnt
        self.discard()

    def begin(self, seen: Means) -> None:
        """Begins anew with what has been seen."""
        self.forget()
        self._learn(np.array([seen.ticks, seen.squares, seen.total]))

    def discard(self) -> None:
        """Something is suspected: what has been seen of late is not taken for the day's."""
        self._older, self._newer = np.zeros(self._shape), np.zeros(self._shape)
        self._visit = Visit(self._shape[-1])
        self._ticks = 0

    def add(self, mode: int, r: FloatArray, usable: Mask) -> None:
        """Takes the residuals (K,) of a tick at which nothing is suspected."""
        self._visit.in_mode(mode)
        if mode != EDGE:
            part = self._newer[:, mode - 1]
            part[0] += usable
            part[1] += usable * (2.0 * self._visit.length + 1.0)
            part[2] += np.where(usable, r, 0.0)
            self._visit.length = self._visit.length + usable
        self._ticks += 1
        if self._ticks % self._guard == 0:
            learnt, self._older, self._newer = self._older, self._newer, np.zeros(self._shape)
            self._learn(learnt)

    def wait(self) -> None:
        """A tick of which nothing is learnt: a day moves on, and what waited to be learnt is old."""
        self._aged += 1
        if self._aged % self._guard == 0:
            f, unknown = float(np.exp(-self._guard / self._tau)), self._straying.unknown.covariance
            covariance = unknown + f**2 * (self._level.covariance - unknown)
            self._before = Level(f * self._level.mean, covariance)
            self._put(self._before)
            self._known[:] = 0.0
            self.discard()

    def settle(self) -> None:
        """Nothing more is to come: what has been seen of late is the day's too."""
        self._learn(self._older + self._newer)
        self.discard()

    def taken_off(self, mode: int, r: FloatArray) -> FloatArray:
        """The residuals (K + F,) of a tick as detectors see them: without the day, and drawn to the offset.

        Those of followers behind the others. The less is known of the day, the nearer: a detector's threshold then is
        the spread of days, and not that of a drive. At an edge the day is the mean of those of all modes.
        """
        return np.asarray(self._offset[mode] + (r - self._offset[mode] - self._mean[mode]) / self._wider[mode])

    def _learn(self, sums: FloatArray) -> None:
        if not sums[0].any():  # nothing could tell
            return
        self._known += sums
        self._known[:, self._known[0] >= self._remembered] /= 2.0
        ticks, squares, total = self._known
        seen = Means(ticks, np.minimum(squares, ticks**2), total, np.zeros((0, *ticks.shape)))
        level = self._straying.known(seen, self._before)
        self._put(Level(level.mean, level.covariance + WANDER**2 * self._straying.unknown.covariance))

    def _put(self, level: Level) -> None:
        mean, variance = (np.vstack([each.mean(axis=0), each]) for each in self._straying.everywhere(level))
        self._level, self._mean = level, mean
        self._wider = np.sqrt(1.0 + WIDENED**2 * variance / self._spread**2)

    @property
    def level(self) -> Level:
        """Where the day puts the means."""
        return self._level

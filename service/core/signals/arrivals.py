"""Arrival times of one periodic message: frames that come too early for one sender.

A sender that is held up catches up: its next frames may come at once. So a frame is judged by the backlog s [s], the
largest sum of recent delays, a CUSUM of the intervals dt against the period T that forgets:

    s <- max(0, s) exp(-dt / tau) + d             d = dt - T, and 0 where that is between 0 and max(LATE T, JITTER_S)
    early:  s < -max(EARLY T, JITTER_S, jitter)

at the speed of a replay tau and JITTER_S are as many times as long in log time. `jitter` is what drives without a
second sender have shown of the message, where that is more (`known_jitter`): one that comes up to its period too soon
cannot be judged by when it comes, and is counted only.

A frame that is early is either a second sender's or follows one that was. Which of the two is forged nobody knows, so
both are doubted (`core.signals.sampling`). Small delays count for nothing: a sender whose period is up to a quarter
longer than the DBC's cycle time would grant a forger credit with each frame. And what counts is forgotten.
"""

from collections.abc import Callable
from enum import Enum, auto
from math import exp

import numpy as np

from faultline.service.core.signals.values import FloatArray, Mask

EARLY = 0.45
"""Parts of the period. Genuine frames of all demo logs come after 0.8 periods or more, with 20 ms of jitter after 0.6;
below one half, a second sender of the same period is seen whatever its phase, from its own frames or the genuine."""

LATE = 0.25
"""Parts of the period: a delay that is shorter excuses no early frame. One that was held up is late by more."""

JITTER_S = 0.04
"""Two delays of 20 ms, of gateways and busy buses [s, real time]: of messages faster than 11 Hz some phases of a second
sender are not seen, and those faster than 25 Hz, or in a replay at 5x than 5 Hz, are counted only
(`core.signals.traffic`)."""

REPEATED = 0.25
"""Parts of the period within which the same bytes again are a gateway's repetition of the frame before; `JITTER_S` if
that is longer, but never half a period."""

TAU_S = 1.0
"""Time constant after which a delay is forgotten [s, real time]."""

FEWEST, KEPT, MARGIN = 100, 0.98, 1.25
"""Intervals that show a jitter, the part of the period that they must be on average, and what is granted above it."""

STARTING_S = 10.0
"""Backlog before the first frame [s]: controllers say much when they start, and queues are emptied at once."""


class Arrival(Enum):
    """Result of judging a frame's arrival."""

    DUE = auto()
    REPEATED = auto()
    EARLY = auto()


class Arrivals:
    """Judges the frames of one message by period [s]. State: time and bytes of the last one that was due, backlog.

    `speed`: seconds of log time a second, 1 on a vehicle. `jitter_s`: by how much its frames are known to come too
    soon.

    >>> arrivals = Arrivals(0.2)
    >>> came = [arrivals.judge(0.2 * k, bytes(8)) for k in range(100)]
    >>> arrivals.judge(19.801, b"forged !").name, arrivals.judge(19.802, bytes(8)).name, arrivals.judge(20.0, b"a").name
    ('EARLY', 'REPEATED', 'DUE')
    """

    def __init__(self, period_s: float) -> None:
        self._period = period_s
        self._last: float | None = None
        self._data = b""
        self._backlog = STARTING_S
        self.speed = 1.0
        self.jitter_s = 0.0

    @property
    def _early(self) -> float:
        """How far the backlog may be below zero [s]."""
        return max(EARLY * self._period, JITTER_S * self.speed, self.jitter_s)

    def judge(self, t: float, data: bytes) -> Arrival:
        """Take the frame that came at log time `t` [s]; a time before the last one begins a new log."""
        if self._last is None or t < self._last:
            self._last, self._data, self._backlog = t, data, STARTING_S * self.speed
            return Arrival.DUE
        dt = t - self._last
        jitter, late = JITTER_S * self.speed, dt - self._period
        if data == self._data and dt < min(max(REPEATED * self._period, jitter), self._period / 2.0):
            return Arrival.REPEATED
        if 0.0 < late < max(LATE * self._period, jitter):
            late = 0.0
        backlog = max(0.0, self._backlog) * exp(-dt / (TAU_S * self.speed)) + late
        if backlog < -self._early:
            return Arrival.EARLY
        self._last, self._data, self._backlog = t, data, backlog
        return Arrival.DUE

    def judge_all(self, t: FloatArray, same: Mask, data: Callable[[int], bytes]) -> tuple[Mask, Mask]:
        """Take frames that came at log times `t` (K,) [s], in order; return which are due, and which are early (K,).

        `same` (K,) says which have the bytes of the one before; `data` gives those of one of them.
        """
        dt = np.diff(t)
        late = dt - self._period
        jitter = JITTER_S * self.speed
        is_near = dt < min(max(REPEATED * self._period, jitter), self._period / 2.0)
        suspects = 1 + np.flatnonzero(same[1:] & is_near | (late < -self._early))
        late[(late > 0.0) & (late < max(LATE * self._period, jitter))] = 0.0
        is_due, is_early = np.ones(len(t), np.bool_), np.zeros(len(t), np.bool_)
        k = 0
        while k < len(t):
            if k and is_due[k - 1]:  # after one that was due, all are up to the next that is suspect
                end = next(iter(suspects[np.searchsorted(suspects, k) :].tolist()[:1]), len(t))
                if end > k:
                    self._last, self._data = float(t[end - 1]), data(end - 1)
                    rows = slice(k - 1, end - 1)
                    self._backlog = _after(self._backlog, -dt[rows] / (TAU_S * self.speed), late[rows])
                    k = end
                    continue
            came = self.judge(float(t[k]), data(k))
            is_due[k], is_early[k] = came is Arrival.DUE, came is Arrival.EARLY
            k += 1
        return is_due, is_early


def known_jitter(t: FloatArray, period_s: float) -> float:
    """Return by how much frames of one sender that came at times `t` (K,) [s] are known to come too soon [s].

    0 where a frame that is early by less than the rule bears was the earliest, or where more frames came than the
    period allows: then there was a second sender.
    """
    dt = np.diff(t)
    if len(dt) < FEWEST or dt.mean() < KEPT * period_s:
        return 0.0
    soonest = period_s - float(dt.min())
    return MARGIN * soonest if soonest > max(EARLY * period_s, JITTER_S) else 0.0


def _after(backlog: float, exponent: FloatArray, delay: FloatArray) -> float:
    """Return the backlog after K frames, `delay` (K,) [s] and `exponent` (K,) of the forgetting before each.

    Without a backlog, the next one is the next delay: only from a delay above 0 until it is made up for, one by one.
    """
    positive = np.flatnonzero(delay > 0.0)
    k, some = 0, 8
    while k < len(delay):
        if backlog > 0.0:
            rows = slice(k, k + some)
            for forgotten, late in zip(exponent[rows].tolist(), delay[rows].tolist(), strict=True):
                backlog = backlog * exp(forgotten) + late
                k += 1
                if not backlog > 0.0:
                    break
            some *= 2
        else:
            after = positive[np.searchsorted(positive, k) :]
            k, some = int(after[0]) if len(after) else len(delay) - 1, 8
            backlog = float(delay[k])
            k += 1
    return backlog

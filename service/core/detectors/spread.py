"""A test on the residual's variance: is it louder or quieter than without a fault?

    v <- v + (min((s - s')^2 / 2, 9) - v) / tau        s': the tick before, tau: memory in ticks; alarm where |ln v| > J

The mean square of successive differences (von Neumann 1941) is a variance that a lasting level does not enter; s is
in parts of its mode's own spread of differences, so that v is about 1 without a fault. The p_tp residuals get quieter
under a clogged pump filter (thesis ch. 7.4). What it sees is no deviation of the level: its alarm is no conflict.
"""

import math

from faultline.service.core.detectors.threshold import Threshold

LARGEST = 9.0
"""A single difference counts as three spreads at most: the step between two modes is no variance."""


class Spread(Threshold):
    """A two-sided threshold test on ln v, which is bounded by 2 J."""

    def __init__(self, J: float, hold_ticks: int, memory_ticks: float) -> None:
        super().__init__(J, hold_ticks)
        self._part = 1.0 / memory_ticks
        self._least, self._most = math.exp(-2.0 * J), math.exp(2.0 * J)
        self._v = 1.0
        self._before: tuple[int, float] | None = None  # tick and its s

    def update(self, tick: int, s: float) -> None:
        """Takes the standardised residual of a tick; over a gap there is no difference to be had."""
        if self._before is not None and self._before[0] == tick - 1:
            square = min((s - self._before[1]) ** 2 / 2.0, LARGEST)
            self._v = min(self._most, max(self._least, self._v + (square - self._v) * self._part))
        self._before = tick, s
        super().update(tick, math.log(self._v))

"""A test of variance ratios: is a residual louder or quieter than it was in this drive before?

    F = v' / v,   z = ((1 - a) F^(1/3) - (1 - a')) / sqrt(a F^(2/3) + a'),   a = 2 / (9 d),   d = 2 n / 3

    v, v'    mean square of successive differences in the n ticks before, and in the last n' ticks
    d, d'    their degrees of freedom: of white noise, the differences of which are correlated

The mean square of successive differences (von Neumann 1941) is a variance that a lasting level does not enter; z
is Paulson's normal form of the F test (1942). Of three windows that end now, the longest half of it and a quarter, the
largest |z| is compared with J. What is standardised is in parts of its mode's own spread of differences. A vehicle's
drives differ in their variance, so that each is compared with itself: what is there from its start is not seen. While
it alarms, nothing is added to what was before. The p_tp residuals get quieter under a clogged pump filter (thesis ch.
7.4). What it sees is no deviation of the level: its alarm is no conflict.
"""

import math
from collections import deque

from faultline.service.core.detectors.threshold import Threshold

LARGEST = 9.0
"""A single difference counts as three spreads at most: the step between two modes is no variance."""

BLOCKS = 60
"""Of the longest window: the test is made once a block."""

WINDOWS = (BLOCKS, BLOCKS // 2, BLOCKS // 4)
BEFORE = BLOCKS // 4
"""Blocks of a drive that must have gone before a window."""


class Spread(Threshold):
    """A two-sided threshold test on z; the longest window has so many ticks."""

    def __init__(self, J: float, hold_ticks: int, window_ticks: float) -> None:
        super().__init__(J, hold_ticks)
        self._ticks = max(1, round(window_ticks / BLOCKS))  # of a block
        self._blocks: deque[float] = deque()  # means of the last ones, oldest first
        self._before, self._count = 0.0, 0  # sum and number of those that have left the longest window
        self._sum, self._number = 0.0, 0  # of the block that is not full
        self._z = 0.0
        self._last: tuple[int, float] | None = None  # tick and its s

    def update(self, tick: int, s: float) -> None:
        """Takes the standardised residual of a tick; over a gap there is no difference to be had."""
        if self._last is not None and self._last[0] == tick - 1:
            self._sum += min((s - self._last[1]) ** 2 / 2.0, LARGEST)
            self._number += 1
            if self._number == self._ticks:
                self._add(self._sum / self._ticks)
                self._sum, self._number = 0.0, 0
        self._last = tick, s
        super().update(tick, self._z)

    def _add(self, block: float) -> None:
        """Takes the mean of a block, and makes the test."""
        self._blocks.append(block)
        if len(self._blocks) > BLOCKS:
            left = self._blocks.popleft()
            if not self.alarm:
                self._before, self._count = self._before + left, self._count + 1
        self._z = max((self._of(window) for window in WINDOWS), key=abs)

    def _of(self, window: int) -> float:
        """Return z of the last blocks; 0 where too little went before."""
        earlier = len(self._blocks) - window
        n = self._count + max(earlier, 0)
        if earlier < 0 or n < BEFORE:
            return 0.0
        last = list(self._blocks)
        before = (self._before + sum(last[:earlier])) / n
        recent = sum(last[earlier:]) / window
        if not before:  # a signal that stood still
            return math.inf if recent else 0.0
        root = math.cbrt(recent / before)
        a, b = (1.0 / (3.0 * self._ticks * blocks) for blocks in (n, window))
        return ((1.0 - a) * root - (1.0 - b)) / math.sqrt(a * root**2 + b)

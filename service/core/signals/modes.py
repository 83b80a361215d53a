"""The operating mode of a tick: one of the system's, or the edge between them.

In each mode residuals are as loud as its operation makes them, and for some time after a step their size says nothing:
each mode has its own scale in every detector (thesis 6.1.4, 7.4).
"""

from collections.abc import Sequence

import numpy as np

from faultline.service.core.manifest import Input, Modes
from faultline.service.core.signals.values import FloatArray, Mask
from faultline.service.core.time_scale import ticks_of

EDGE = 0
"""Index of the edge in `Modes.names`; the steady ones follow."""


class ModeTracker:
    """Follows the mode. State: the last good value of every watched input and the ticks since the last edge."""

    def __init__(self, modes: Modes, inputs: Sequence[Input], period_s: float) -> None:
        names = [channel.signal for channel in inputs]
        self._limit = np.array([modes.edges.get(name, np.inf) for name in names])
        self._above = np.full((len(modes.steady), len(names)), -np.inf)
        self._below = np.full((len(modes.steady), len(names)), np.inf)
        bounded = [bool(mode.where) for mode in modes.steady]
        for row, mode in enumerate(modes.steady):
            for name, bounds in mode.where.items():
                column = names.index(name)
                self._above[row, column] = -np.inf if bounds.above is None else bounds.above
                self._below[row, column] = np.inf if bounds.below is None else bounds.below
        self._needed = (np.isfinite(self._above) | np.isfinite(self._below)).any(axis=0)
        self._order = sorted(range(len(bounded)), key=lambda row: not bounded[row])  # the one without bounds is last
        self._settle = ticks_of(modes.settle_s, period_s)
        self._last = np.full(len(names), np.nan)
        self._since_edge = 0

    def update(self, z: FloatArray, usable: Mask) -> int:
        """Return the mode's index in `Modes.names` at this tick, from the samples `z` (nz,) and which are usable (nz,).

        Without a usable signal of its bounds the mode is *edge*: nothing is known of what the residuals should be.
        """
        with np.errstate(invalid="ignore"):
            moved = np.abs(z - self._last) > self._limit
            holds = ~(((z <= self._above) | (z >= self._below)) & self._needed).any(axis=1)
        known = bool(usable[self._needed].all())
        self._since_edge = 0 if (moved & usable).any() or not known else self._since_edge + 1
        self._last = np.where(usable, z, self._last)
        if self._since_edge < self._settle or not known:
            return EDGE
        return 1 + next(row for row in self._order if holds[row])

"""The operating mode of a tick: idle, partial or maximum dose, or the edge between them.

Residuals are louder under partial dosing (the valve's ripple), quiet at maximum, and for some seconds after a step
their size says nothing: each mode has its own scale in every detector (thesis 6.1.4, 7.4).
"""

from collections.abc import Sequence

import numpy as np

from faultline.service.core.manifest import MODES, Input, Modes
from faultline.service.core.signals.values import FloatArray, Mask

IDLE, PARTIAL, MAXIMUM, EDGE = range(len(MODES))


class ModeTracker:
    """Follows the mode. State: the last good value of every watched input and the ticks since the last edge."""

    def __init__(self, modes: Modes, inputs: Sequence[Input]) -> None:
        names = [channel.signal for channel in inputs]
        self._modes = modes
        self._column = names.index(modes.signal)
        self._limit = np.array([modes.edges.get(name, np.inf) for name in names])
        self._last = np.full(len(names), np.nan)
        self._since_edge = 0

    def update(self, z: FloatArray, usable: Mask) -> int:
        """Return the mode's index in `MODES` at this tick, from the samples `z` (nz,) and whether each is usable (nz,).

        Without a usable mode signal the mode is *edge*: nothing is known of what the residuals should be.
        """
        with np.errstate(invalid="ignore"):
            moved = np.abs(z - self._last) > self._limit
        self._since_edge = 0 if (moved & usable).any() or not usable[self._column] else self._since_edge + 1
        self._last = np.where(usable, z, self._last)
        if self._since_edge < self._modes.settle_ticks:
            return EDGE
        level = z[self._column]
        if level < self._modes.idle_below:
            return IDLE
        return MAXIMUM if level > self._modes.maximum_above else PARTIAL

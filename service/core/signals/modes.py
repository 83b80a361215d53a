"""The operating mode of a tick: one of the system's, or the edge between them.

In each mode residuals are as loud as its operation makes them, and for some time after a step their size says nothing:
each mode has its own scale in every detector (thesis 6.1.4, 7.4).
"""

from collections.abc import Sequence

import numpy as np

from faultline.service.core.manifest import Input, Modes
from faultline.service.core.signals.gate import Gate
from faultline.service.core.signals.regions import Regions
from faultline.service.core.signals.values import FloatArray, Mask
from faultline.service.core.time_scale import ticks_of

EDGE = 0
"""Index of the edge in `Modes.names`; the steady ones follow."""


STEP = 0.25
"""A step may take this part of `settle_s`: a pump that starts takes some seconds to its speed."""


class ModeTracker:
    """Follows the mode. State: good values of the inputs for as long as a step may take, the ticks since an edge.

    An outlier is no step (`core.signals.gate`), and what lasts after it was held back is one. `limit` (nz,) are the
    steps that make an edge, `regions` those of the modes, tried in the `order`; an edge lasts `settle` ticks, and
    `last` (n, nz) are the values before.
    """

    def __init__(self, modes: Modes, inputs: Sequence[Input], period_s: float, part: float = STEP) -> None:
        names = [channel.signal for channel in inputs]
        self.limit = np.array([modes.edges.get(name, np.inf) for name in names])
        self.regions = Regions([mode.where for mode in modes.steady], inputs)
        bounded = [bool(mode.where) for mode in modes.steady]
        self.order = sorted(range(len(bounded)), key=lambda row: not bounded[row])  # the one without bounds is last
        self._gate = Gate(inputs)
        self._steps = np.isfinite(self.limit)
        self.settle = ticks_of(modes.settle_s, period_s)
        self.last = np.full((max(1, round(part * modes.settle_s / period_s)), len(names)), np.nan)
        self._now = 0
        self._since_edge = 0

    def update(self, z: FloatArray, usable: Mask) -> int:
        """Return the mode's index in `Modes.names` at this tick, from the samples `z` (nz,) and which are usable (nz,).

        Without a usable signal of its bounds the mode is *edge*: nothing is known of what the residuals should be.
        """
        z = self._gate.passed(z, usable)
        with np.errstate(invalid="ignore"):
            moved = (np.abs(z - self.last) > self.limit).any(axis=0)
        holds = self.regions.holding(z)
        known = bool(usable[self.regions.needed].all())
        is_edge = bool((moved & usable).any() or self._gate.jumped[self._steps].any())
        self._since_edge = 0 if is_edge or not known else self._since_edge + 1
        last, self._now = self.last[self._now], (self._now + 1) % len(self.last)
        self.last[slice(None) if is_edge else self._now] = np.where(usable, z, last)  # what was before it is over
        if self._since_edge < self.settle or not known:
            return EDGE
        return 1 + next(row for row in self.order if holds[row])

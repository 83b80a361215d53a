"""Regions of operation: boxes of signals, as an operating mode or the consequence of a fault has one."""

from collections.abc import Mapping, Sequence

import numpy as np

from faultline.service.core.manifest import Bounds, Input
from faultline.service.core.signals.values import FloatArray, Mask


class Regions:
    """The n regions of some `bounds` by signal; in one without bounds everything is.

    `above`, `below` (n, nz) are the bounds, NaN where there is none, and `needed` (nz,) the signals that have some.
    """

    def __init__(self, bounds: Sequence[Mapping[str, Bounds]], inputs: Sequence[Input]) -> None:
        names = [channel.signal for channel in inputs]
        self.above = np.full((len(bounds), len(names)), np.nan)
        self.below = np.full((len(bounds), len(names)), np.nan)
        for row, by_signal in enumerate(bounds):
            for name, each in by_signal.items():
                column = names.index(name)
                self.above[row, column] = np.nan if each.above is None else each.above
                self.below[row, column] = np.nan if each.below is None else each.below
        self.needed = (np.isfinite(self.above) | np.isfinite(self.below)).any(axis=0)

    def __len__(self) -> int:
        return len(self.above)

    def holding(self, z: FloatArray) -> Mask:
        """Return the regions (n,) in which the samples `z` (nz,) are."""
        with np.errstate(invalid="ignore"):
            return np.asarray(~((z <= self.above) | (z >= self.below)).any(axis=1))

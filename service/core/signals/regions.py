"""Regions of operation: boxes of signals, as an operating mode or the consequence of a fault has one."""

from collections.abc import Mapping, Sequence

import numpy as np

from faultline.service.core.manifest import Bounds, Input
from faultline.service.core.signals.values import FloatArray, Mask


class Regions:
    """The regions of some `bounds` by signal; in one without bounds everything is. `needed` (nz,) have bounds."""

    def __init__(self, bounds: Sequence[Mapping[str, Bounds]], inputs: Sequence[Input]) -> None:
        names = [channel.signal for channel in inputs]
        self._above = np.full((len(bounds), len(names)), -np.inf)
        self._below = np.full((len(bounds), len(names)), np.inf)
        for row, by_signal in enumerate(bounds):
            for name, each in by_signal.items():
                column = names.index(name)
                self._above[row, column] = -np.inf if each.above is None else each.above
                self._below[row, column] = np.inf if each.below is None else each.below
        self.needed = (np.isfinite(self._above) | np.isfinite(self._below)).any(axis=0)

    def holding(self, z: FloatArray) -> Mask:
        """Return the regions (n,) in which the samples `z` (nz,) are."""
        with np.errstate(invalid="ignore"):
            return np.asarray(~(((z <= self._above) | (z >= self._below)) & self.needed).any(axis=1))

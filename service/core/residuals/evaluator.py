"""Evaluation of samples: the operating modes and the residuals of ticks in a row."""

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from faultline.service.core.residuals.generators import Generators, Residuals
from faultline.service.core.signals.modes import ModeTracker
from faultline.service.core.signals.values import FloatArray, Indices, Mask


class Evaluator(Protocol):
    """Interface of what gives ticks their mode and residuals. A second one is native code, off the vehicle."""

    def evaluate(self, z: FloatArray, usable: Mask, ages: FloatArray) -> Iterator[tuple[Indices, Residuals]]:
        """Yield the modes (m,) and residuals of some ticks in a row after the other, until all n have been.

        They are of samples (n, nz), which are usable, and their ages [s].
        """


class TickByTick:
    """Evaluates each tick when it is asked for: it is the only one of its row."""

    def __init__(self, generators: Generators, modes: ModeTracker) -> None:
        self._generators, self._modes = generators, modes

    def evaluate(self, z: FloatArray, usable: Mask, ages: FloatArray) -> Iterator[tuple[Indices, Residuals]]:
        """Yield the mode (1,) and residuals of each tick of samples (n, nz), which are usable, and their ages [s]."""
        for sample, is_usable, age in zip(z, usable, ages, strict=True):
            residuals = self._generators.step(sample, is_usable, age)
            yield np.array([self._modes.update(sample, is_usable)]), residuals.in_a_row

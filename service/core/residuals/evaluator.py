"""Evaluation of samples: the operating mode and the residuals of one tick after another."""

from collections.abc import Iterator
from typing import Protocol

from faultline.service.core.residuals.generators import Generators, Residuals
from faultline.service.core.signals.modes import ModeTracker
from faultline.service.core.signals.values import FloatArray, Mask


class Evaluator(Protocol):
    """Interface of what gives ticks their mode and residuals. A second one is native code, off the vehicle."""

    def evaluate(self, z: FloatArray, usable: Mask, ages: FloatArray) -> Iterator[tuple[int, Residuals]]:
        """Yield mode and residuals of the next n ticks, of samples (n, nz), which are usable, and their ages [s]."""


class TickByTick:
    """Evaluates each tick when it is asked for."""

    def __init__(self, generators: Generators, modes: ModeTracker) -> None:
        self._generators, self._modes = generators, modes

    def evaluate(self, z: FloatArray, usable: Mask, ages: FloatArray) -> Iterator[tuple[int, Residuals]]:
        """Yield mode and residuals of the next n ticks, of samples (n, nz), which are usable, and their ages [s]."""
        for sample, is_usable, age in zip(z, usable, ages, strict=True):
            residuals = self._generators.step(sample, is_usable, age)
            yield self._modes.update(sample, is_usable), residuals

"""Scales of signals and states, from the recordings: a network sees numbers about one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from faultline.training.reckoned import Example

Array = npt.NDArray[np.float64]
Columns = npt.NDArray[np.intp]
Kind = Literal["spread", "range"]


@dataclass(frozen=True)
class Scaling:
    """A value is offset + size * scaled: of signals (nz,) and of states (F,)."""

    z_offset: Array
    z_size: Array
    x_offset: Array
    x_size: Array

    def z(self, z: Array) -> Array:
        """Signals (..., nz), scaled."""
        return np.asarray((z - self.z_offset) / self.z_size)

    def y(self, y: Array, predicts: Columns) -> Array:
        """Predictions (..., T) of the signals `predicts` (T,), scaled."""
        return np.asarray((y - self.z_offset[predicts]) / self.z_size[predicts])

    def x(self, x: Array) -> Array:
        """States (..., F), scaled."""
        return np.asarray((x - self.x_offset) / self.x_size)


def scaling_of(examples: Sequence[Example], kind: Kind) -> Scaling:
    """By mean and standard deviation ("spread"), or to 0..1 (thesis 5.10: "range"), of signals and states."""
    z_offset, z_size = _scale(np.concatenate([example.z for example in examples]), kind)
    x_offset, x_size = _scale(np.concatenate([example.x for example in examples]), kind)
    return Scaling(z_offset, z_size, x_offset, np.where(x_size > 0.0, x_size, 1.0))


def _scale(values: Array, kind: Kind) -> tuple[Array, Array]:
    if kind == "spread":
        return values.mean(axis=0), values.std(axis=0)
    lowest = values.min(axis=0)
    return lowest, values.max(axis=0) - lowest

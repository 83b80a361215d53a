"""Which residuals are numerically independent: structurally different tests may compute the same signal."""

import numpy as np
import numpy.typing as npt

UNEXPLAINED = 0.1
"""Part of a standardised residual's spread that the ones before it must leave unexplained."""


def independent(s: npt.NDArray[np.float64]) -> list[int]:
    """Columns of the residuals `s` (K, T) that no combination of earlier columns explains.

    Of tests that compute the same signal the first is taken, so that the choice does not hang on rounding.

    >>> r = np.random.default_rng(0).normal(size=(200, 3))
    >>> independent(np.column_stack([r[:, 0], 5 * r[:, 0], r[:, 1], r[:, 0] - r[:, 1]]))
    [0, 2]
    """
    R = np.linalg.qr(s / np.sqrt((s**2).mean(axis=0)), mode="r")
    left = np.abs(np.diag(R)) / np.sqrt(len(s))
    return [int(column) for column in np.flatnonzero(left > UNEXPLAINED)]

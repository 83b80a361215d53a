"""Which residuals are numerically independent: structurally different tests may compute the same signal."""

import numpy as np
import numpy.typing as npt
from scipy.linalg import qr

UNEXPLAINED = 0.1
"""Part of a standardised residual's spread that the ones already chosen must leave unexplained."""


def independent(s: npt.NDArray[np.float64]) -> list[int]:
    """Columns of the residuals `s` (K, T) that are independent: the leading pivots of a QR with column pivoting.

    >>> r = np.random.default_rng(0).normal(size=(200, 3))
    >>> independent(np.column_stack([r[:, 0], 5 * r[:, 0], r[:, 1]]))
    [1, 2]
    """
    scaled = s / np.sqrt((s**2).mean(axis=0))
    _, R, pivots = qr(scaled, mode="economic", pivoting=True)
    left = np.abs(np.diag(R)) / np.sqrt(len(s))
    return sorted(int(pivot) for pivot, part in zip(pivots, left, strict=True) if part > UNEXPLAINED)

"""Which residuals are numerically independent: structurally different tests may compute the same signal."""

from collections.abc import Callable, Collection, Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

UNEXPLAINED = 0.1
"""Part of a standardised residual's spread that the ones before it must leave unexplained."""
ALIKE = 0.05
"""Parts by which what is left of two residuals may differ, and the choice hangs on rounding."""


def independent(s: Array) -> list[int]:
    """Columns of the residuals `s` (K, T) that no combination of earlier columns explains.

    Of tests that compute the same signal the first is taken, so that the choice does not hang on rounding.

    >>> r = np.random.default_rng(0).normal(size=(200, 3))
    >>> independent(np.column_stack([r[:, 0], 5 * r[:, 0], r[:, 1], r[:, 0] - r[:, 1]]))
    [0, 2]
    """
    R = np.linalg.qr(s / np.sqrt((s**2).mean(axis=0)), mode="r")
    left = np.abs(np.diag(R)) / np.sqrt(len(s))
    return [int(column) for column in np.flatnonzero(left > UNEXPLAINED)]


def most_apart(s: Array, columns: Collection[int], may: Callable[[Sequence[int]], bool]) -> list[int]:
    """Return those of these columns of residuals `s` (K, T) that explain each other least, by QR with pivoting.

    One more is taken as long as the columns together `may` be independent; of columns that are as far apart, the first.

    >>> r = np.random.default_rng(0).normal(size=(200, 3))
    >>> s = np.column_stack([r[:, 0], r[:, 0] + 0.2 * r[:, 1], r[:, 1], r[:, 2]])
    >>> most_apart(s, [0, 1, 2], lambda taken: len(taken) <= 2)
    [0, 2]
    """
    own = sorted(columns)
    left = s[:, own] / np.sqrt((s[:, own] ** 2).mean(axis=0))
    taken: list[int] = []
    while there := [k for k in range(len(own)) if k not in taken and may([own[j] for j in (*taken, k)])]:
        size = np.sqrt((left[:, there] ** 2).mean(axis=0))
        taken.append(there[int(np.flatnonzero(size >= (1.0 - ALIKE) * size.max())[0])])
        direction = left[:, taken[-1]] / (np.linalg.norm(left[:, taken[-1]]) or 1.0)
        left = left - np.outer(direction, direction @ left)
    return sorted(own[k] for k in taken)

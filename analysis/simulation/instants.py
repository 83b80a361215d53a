"""Small linear systems A X = B, one for every instant, whose zeros are in the same places.

Gauss and Jordan's elimination in which every entry is an array over time: what is zero at all instants costs nothing,
and a step is some additions of arrays, where factorising one small matrix after the other mostly costs the calls. All
instants have the same pivots: of the entries that are large in their rows, the one that fills in least (Markowitz 1957,
with a threshold). Where that one happens to be small after all, LAPACK solves the instant.
"""

from collections import Counter
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

Entries = Mapping[tuple[int, int], float | Array]
"""A matrix by row and column: an array over time, a number that holds at all instants, or, if not there, zero."""

Row = dict[int, float | Array]
"""By column."""

LARGE = 1e-3
"""Of the largest entry in its row, as root mean squares over time: what may be a pivot."""

SMALL = 1e-6
"""Of the largest entry in its row, at an instant: a pivot below would lose more digits than this."""


class UndeterminedError(Exception):
    """A is singular at some instant, which leaves the variable `column` open, and maybe others."""

    def __init__(self, column: int) -> None:
        super().__init__(f"variable {column}")
        self.column = column


def solved(A: Entries, B: Entries, sizes: Array, shape: tuple[int, int]) -> Array:
    """X (n, m, K) at K instants, (m, K) being the `shape`, if the variables are of the `sizes` (n,).

    Raises:
        UndeterminedError: there is no X.
    """
    width, count = shape
    with np.errstate(all="ignore"):  # what divides by zero is not good, and what is not finite stays so
        rows, good = _eliminated(A, B, sizes, count)
        found = np.zeros((len(sizes), width, count))
        for j, row in enumerate(rows):
            for column, value in row.items():
                found[j, column] = value * sizes[j]
        bad = np.flatnonzero(~good)
        if bad.size:
            found[:, :, bad] = _one_by_one(A, B, sizes, width, bad)
    return found


def _eliminated(A: Entries, B: Entries, sizes: Array, count: int) -> tuple[list[Row], npt.NDArray[np.bool_]]:
    """X by variable, in units of its size, and at which instants (K,) the pivots are good for it."""
    n = len(sizes)
    left, right = _rows(A, n, sizes), _rows(B, n, np.ones(1 + max((j for _, j in B), default=0)))
    typical = [{j: _typical(value) for j, value in row.items()} for row in left]
    good = np.ones(count, dtype=np.bool_)
    found: list[Row] = [{} for _ in range(n)]
    for _ in range(n):
        place = _pivot(typical, left, right)
        if place is None:
            return found, np.zeros_like(good)
        i, j = place
        found[j], typical[i] = right[i], {}
        pivot, row = left[i].pop(j), left[i]
        good &= _is_good(pivot, row)
        _scale(row, 1.0 / pivot)
        _scale(right[i], 1.0 / pivot)
        for other in range(n):
            factor = left[other].pop(j, None)
            if factor is None:
                continue
            _subtract(left[other], factor, row)
            _subtract(right[other], factor, right[i])
            if typical[other].pop(j, None) is not None:
                typical[other].update((column, _typical(left[other][column])) for column in row)
    return found, good


def _rows(matrix: Entries, n: int, sizes: Array) -> list[Row]:
    """The n rows, without numbers that are zero, in which variables of the `sizes` are of size one."""
    rows: list[Row] = [{} for _ in range(n)]
    for (i, j), value in matrix.items():
        if isinstance(value, np.ndarray) or value != 0.0:
            rows[i][j] = value * sizes[j]
    return rows


def _typical(value: float | Array) -> float:
    """The root mean square."""
    return float(np.sqrt(value @ value / len(value))) if isinstance(value, np.ndarray) else abs(value)


def _pivot(typical: list[dict[int, float]], left: list[Row], right: list[Row]) -> tuple[int, int] | None:
    """The row and column to eliminate with next, `typical` being what may be; none if nothing is left to do it with."""
    users = Counter(column for row in left for column in row)
    best, least = None, float("inf")
    for i, sizes in enumerate(typical):
        enough = LARGE * max(sizes.values(), default=0.0)
        for j, size in sizes.items():
            work = (len(left[i]) - 1 + len(right[i])) * (users[j] - 1)
            if size >= enough and size > 0.0 and work < least:
                best, least = (i, j), work
    return best


def _is_good(pivot: float | Array, row: Row) -> npt.NDArray[np.bool_]:
    """At which instants (K,) or whether at all: the rest of the `row` is not too large for it."""
    most = np.abs(pivot) / SMALL
    good = most > 0.0
    for value in row.values():
        good = good & (most >= np.abs(value))
    return np.asarray(good)


def _scale(row: Row, factor: float | Array) -> None:
    for column, value in row.items():
        row[column] = value * factor


def _subtract(row: Row, factor: float | Array, other: Row) -> None:
    for column, value in other.items():
        change = factor * value
        row[column] = row[column] - change if column in row else -change


def _one_by_one(A: Entries, B: Entries, sizes: Array, width: int, at: npt.NDArray[np.int64]) -> Array:
    """X (n, m, ...) at some instants."""
    n = len(sizes)
    left, right = np.zeros((len(at), n, n)), np.zeros((len(at), n, width))
    for whole, matrix in ((left, A), (right, B)):
        for (i, j), value in matrix.items():
            whole[:, i, j] = value[at] if isinstance(value, np.ndarray) else value
    left *= sizes
    weights = 1.0 / np.maximum(np.abs(left).max(axis=2), 1e-300)[:, :, None]
    try:
        found = np.linalg.solve(left * weights, right * weights)
    except np.linalg.LinAlgError:
        _, size, V = np.linalg.svd(np.nan_to_num(left * weights))
        raise UndeterminedError(int(np.abs(V[size[:, -1].argmin(), -1]).argmax())) from None
    return np.asarray((found * sizes[:, None]).transpose(1, 2, 0))

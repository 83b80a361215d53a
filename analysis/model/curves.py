"""Curves and maps: functions of one or two plain numbers, given by points, with a slope everywhere.

Between points a curve is straight, and at a point it is bent over a share of the distance to its neighbours: with the
slopes s_k between points, it is

    f(x) = y_0 + s_0 (x - x_0) + sum_k (s_k - s_{k-1}) / 2 ((x - x_k) + h_k(x)),    h_k(x) = sqrt((x - x_k)^2 + w_k^2)

of smooth hinges h_k in place of the size |x - x_k|, which has no slope at zero. Beyond its ends it goes on straight. So
it is a weighted sum of 1, x and the hinges, with weights that are linear in the values. A map is such a sum in x, whose
weights are sums in y.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt
import sympy as sp

MOST_POINTS, MOST_VALUES = 40, 150
"""A curve has at most so many points, and a map so many values: each is a term of its formula."""
ROUND = 0.1
"""Distance over which a bend is rounded, in parts of that to the nearer neighbour."""


@dataclass(frozen=True, kw_only=True)
class Curve:
    """A curve with values `y` at `x`, or a map with the rows `z` of values at each of `x`, for all of `y`."""

    x: tuple[float, ...]
    y: tuple[float, ...]
    z: tuple[tuple[float, ...], ...] = ()
    description: str = ""
    source: str = ""

    @property
    def count(self) -> int:
        """The number of its arguments."""
        return 2 if self.z else 1

    def __call__(self, *arguments: sp.Expr) -> sp.Expr:
        """The formula of its value."""
        weights = _weights(self.x) @ np.asarray(self.z or self.y, dtype=np.float64)
        across = _basis(self.x, arguments[0])
        if not self.z:
            return _sum(weights, across)
        return sp.Add(
            *(
                _sum(row, _basis(self.y, arguments[1])) * each
                for row, each in zip(weights @ _weights(self.y).T, across, strict=True)
            )
        )


Curves = Mapping[str, Curve]
"""Curves and maps by their names in formulas."""

NO_CURVES: Curves = {}


def _basis(x: Sequence[float], at: sp.Expr) -> list[sp.Expr]:
    """One, the argument, and a hinge for each point between the ends."""
    widths = [ROUND * min(point - before, after - point) for before, point, after in zip(x, x[1:], x[2:], strict=False)]
    hinges = [
        sp.sqrt((at - sp.Float(point)) ** 2 + sp.Float(width**2)) for point, width in zip(x[1:-1], widths, strict=True)
    ]
    return [sp.Integer(1), at, *hinges]


def _weights(x: Sequence[float]) -> npt.NDArray[np.float64]:
    """Return the matrix (points, points) that turns values into the weights of the basis."""
    points = np.asarray(x, dtype=np.float64)
    slopes = np.diff(np.eye(len(points)), axis=0) / np.diff(points)[:, None]  # by value
    bends = np.diff(slopes, axis=0) / 2
    steady = -slopes[0] * points[0] - points[1:-1] @ bends
    steady[0] += 1.0
    return np.vstack([steady, slopes[0] + bends.sum(axis=0), bends])


def _sum(weights: npt.NDArray[np.float64], basis: Sequence[sp.Expr]) -> sp.Expr:
    return sp.Add(*(sp.Float(w) * each for w, each in zip(weights.tolist(), basis, strict=True) if w))


def trouble(curve: Curve) -> str:
    """Why the points are none of a curve or a map; empty where they are."""
    axes = {"x": curve.x, "y": curve.y} if curve.z else {"x": curve.x}
    if wrong := [name for name, axis in axes.items() if not 2 <= len(axis) <= MOST_POINTS]:
        return f"{wrong[0]} has {len(axes[wrong[0]])} points; give 2 to {MOST_POINTS}"
    if wrong := [name for name, axis in axes.items() if any(right <= left for left, right in pairwise(axis))]:
        return f"{wrong[0]} must rise from point to point"
    if not curve.z and len(curve.y) != len(curve.x):
        return f"y has {len(curve.y)} values for the {len(curve.x)} points of x"
    if curve.z and (len(curve.z) != len(curve.x) or any(len(row) != len(curve.y) for row in curve.z)):
        return f"z must have {len(curve.x)} rows, one for each x, of {len(curve.y)} values, one for each y"
    if len(curve.z) * len(curve.y) > MOST_VALUES:
        return f"z has {len(curve.z) * len(curve.y)} values; give {MOST_VALUES} at most"
    return ""

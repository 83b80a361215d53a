"""The most likely x of a model, near a start: Levenberg's damped steps on whitened differences, within bounds.

The bounded step is exact (Stark and Parker 1995), so an effect that physics lets go one way only stays at nothing where
the data would have it go the other. scipy's trust region method keeps off the bounds, at which most effects belong.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from faultline.analysis.calibration.likelihood import Likelihood
from faultline.analysis.calibration.problem import Problem
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]

STEPS = 15

ENOUGH = 0.05
"""A step that promises less [nats] is not made."""

FIRST, LARGER, SMALLER, LAST = 1.0, 4.0, 8.0, 1e8
"""Damping, in parts of the prior's precision: what a step that led nowhere gets, by how much it grows and shrinks, and
where it ends: there is no better place near. A narrow valley that bends is followed in such steps; cut ones crawl, and
so do Marquardt's, in parts of the curvature, where all flows may be larger at no price."""

AT_BOUND = 1e-6
"""So near to a bound in standard deviations of the prior, an unknown does not move."""


@dataclass(frozen=True)
class Optimum:
    """`x` (n,), its `cost` [nats] (half the squares of whitened differences and of x), and the `curvature` (n, n).

    `inside` (n,) tells which unknowns are not at a bound. `promised` [nats] is what another step would bring, were the
    model linear.
    """

    x: Array
    cost: float
    curvature: Array
    inside: npt.NDArray[np.bool_]
    promised: float

    @property
    def log_evidence(self) -> float:
        """Of the data under the model, but for a constant that no model has of its own (Laplace's approximation)."""
        free = self.curvature[np.ix_(self.inside, self.inside)]
        return -self.cost - 0.5 * float(np.linalg.slogdet(free)[1])


def descend(likelihood: Likelihood, problem: Problem, x: Array, steps: int = STEPS) -> Optimum:
    """The optimum near `x`, or how far so many `steps` come.

    Raises:
        InputError: the model cannot be run at `x`.
    """
    x = np.clip(x, *problem.bounds)
    e, damping = likelihood.left(problem, x), 0.0
    for number in range(steps + 1):
        J = likelihood.slopes(problem, x)
        H, g = J.T @ J + np.eye(len(x)), -(J.T @ e + x)
        room = problem.bounds - x
        # J's own factor, not that of H: a start far away may have slopes beside whose squares the prior's 1 is lost
        R = np.asarray(np.linalg.qr(J, mode="r"))
        step = _bounded(R, 1.0, g, *room)
        promised = float(g @ step - 0.5 * step @ H @ step)
        if promised < ENOUGH or number == steps:
            break
        before = _cost(e, x)
        while damping < LAST:
            if damping:
                step = _bounded(R, 1.0 + damping, g, *room)
            trial = np.clip(x + step, *problem.bounds)
            try:
                left = likelihood.left(problem, trial)
                if _cost(left, trial) < before:
                    break
            except InputError:  # too far: the model cannot be run there
                pass
            damping = max(LARGER * damping, FIRST)
        else:
            break
        x, e, damping = trial, left, damping / SMALLER if damping > FIRST else 0.0
    inside = np.abs(problem.bounds - x).min(axis=0) > AT_BOUND
    return Optimum(x, _cost(e, x), H, inside, promised)


def _cost(e: Array, x: Array) -> float:
    return 0.5 * float(e @ e + x @ x)


def _bounded(R: Array, precision: float, g: Array, lower: Array, upper: Array) -> Array:
    """The step within bounds that raises g'd - d'(R'R + precision I)d / 2 most."""
    root = np.asarray(np.linalg.qr(np.concatenate([R, np.sqrt(precision) * np.eye(len(g))]), mode="r"))
    half = solve_triangular(root, g, trans="T")
    free = solve_triangular(root, half)
    if (free >= lower).all() and (free <= upper).all():
        return np.asarray(free)
    room = (np.minimum(lower, 0.0) - 1e-12, np.maximum(upper, 0.0) + 1e-12)  # the solver wants some between them
    return np.asarray(lsq_linear(root, half, bounds=room, method="bvls").x)

"""Global search over an effect's own parameters, for where the usual beginnings of the local search lead nowhere.

Where the gradient is zero, as of a valve that would open above all pressures recorded, no descent moves. Here trials
are spread quasi-randomly (Sobol 1967) over the effect's own parameters, within their bounds and some standard
deviations of their priors. A trial costs one free run. For the rest the model is taken as linear, as in variable
projection (Golub and Pereyra 1973): the other parameters take their least-squares step, and so does the effect's
strength, along the secant from no effect to the trial. The best trials become beginnings of the usual descent.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import qmc

from faultline.analysis.calibration.likelihood import Likelihood
from faultline.analysis.calibration.problem import Problem
from faultline.analysis.discrepancy.name.search import ENOUGH
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

TRIALS = (16, 64, 128)
"""For one own parameter, two, and more: powers of two, for which a Sobol sequence is balanced."""

WEAKEST, STRONGEST = 1e-3, 10.0
"""A strength is tried from here to there, in spreads, evenly on a logarithmic scale: what an engineer takes for usual
may be off by orders of magnitude."""

FURTHEST = 5.0
"""Standard deviations of its prior, to which another parameter is tried, unless a bound is nearer."""

EXTRAPOLATED = 2.0
"""Times a trial's strength, to which the secant is followed."""

APART = 1.0
"""Standard deviations of a prior between two beginnings: nearer ones lead to the same place."""

SEED = 1


@dataclass(frozen=True)
class Trials:
    """The result: `begins` (k, n) for descents, the most promising first, of `tried` sizes, `failed` of them to run.

    `promised` [nats] is by how much the best, by the linear account, is better than no effect.
    """

    begins: Array
    promised: float
    tried: int
    failed: int


def search(likelihood: Likelihood, problem: Problem, x: Array, own: Flags, strengths: Flags, most: int = 3) -> Trials:
    """Search globally over the effect's `own` parameters (n,), of which the `strengths` (n,) are zero at `x` (n,).

    Raises:
        InputError: the model cannot be run at `x`.
    """
    linear = _Linear(likelihood, problem, x, own, strengths)
    tried, ends = spread(problem, x, own, strengths), list[tuple[float, Array]]()
    for trial in tried:
        try:
            ends.append(linear.best(trial))
        except InputError:  # it cannot be run with this size; it may with others
            continue
    ends.sort(key=lambda end: end[0])
    promised = max(linear.nothing - ends[0][0], 0.0) if ends else 0.0
    begins = _distinct([end for cost, end in ends if linear.nothing - cost > ENOUGH], own & ~strengths, most)
    return Trials(np.reshape(begins, (-1, len(x))), promised, len(tried), len(tried) - len(ends))


def spread(problem: Problem, x: Array, own: Flags, strengths: Flags) -> Array:
    """Return the trials (T, n): `x` with other values of the `own` parameters."""
    place = np.flatnonzero(own)
    count = TRIALS[min(len(place), len(TRIALS)) - 1]
    points = qmc.Sobol(len(place), seed=SEED).random(count)
    trials = np.tile(x, (count, 1))
    for k, u in zip(place, points.T, strict=True):
        lower, upper = problem.bounds[:, k]
        trials[:, k] = _sizes(u, lower, upper) if strengths[k] else np.clip(FURTHEST * (2.0 * u - 1.0), lower, upper)
    return trials


def _sizes(u: Array, lower: float, upper: float) -> Array:
    """Strengths [spreads] at the parts `u` (T,) of their logarithmic scale, of either sign where bounds let them."""
    both = lower < 0.0 < upper
    sign = np.where(u < 0.5, -1.0, 1.0) if both else np.full(len(u), 1.0 if upper > 0.0 else -1.0)
    part = np.mod(2.0 * u, 1.0) if both else u
    reach = np.minimum(np.where(sign > 0.0, upper, -lower), STRONGEST)
    return np.asarray(sign * np.minimum(WEAKEST, reach) * (reach / np.minimum(WEAKEST, reach)) ** part)


def _distinct(ends: list[Array], beside: Flags, most: int) -> list[Array]:
    """The first of `ends` (n,), and of the rest what differs from all before in a parameter `beside` strengths."""
    found = list[Array]()
    for end in ends:
        if all(np.abs(end - other)[beside].max(initial=0.0) > APART for other in found):
            found.append(end)
    return found[:most]


class _Linear:
    """The cost near `x` (n,) as a function of all but the effect, linear in what it does there, and along secants."""

    def __init__(self, likelihood: Likelihood, problem: Problem, x: Array, own: Flags, strengths: Flags) -> None:
        self._likelihood, self._problem, self._x = likelihood, problem, x
        self._rest, self._own, self._strengths = ~own, own, strengths
        self._e, self._J = likelihood.left(problem, x), likelihood.slopes(problem, x)[:, ~own]
        self._H = cho_factor(self._J.T @ self._J + np.eye(self._J.shape[1]))

    @property
    def nothing(self) -> float:
        """The least cost [nats] without the effect."""
        return self._at(self._e)[0]

    def best(self, trial: Array) -> tuple[float, Array]:
        """The least cost [nats] on the secant from no effect to the `trial` (n,), and where (n,) that is.

        With e the differences without the effect, c their change up to the trial, and J the derivatives to all other
        parameters, it minimises |e + a c + J d|^2 + |x + d|^2 + a^2 |strengths|^2 over the step d and the part a.
        """
        change = self._likelihood.left(self._problem, trial) - self._e
        moved = cho_solve(self._H, self._J.T @ change)
        visible, strong = change - self._J @ moved, trial[self._strengths]
        power = float(visible @ change + strong @ strong)
        pull = float(moved @ self._x[self._rest] - visible @ self._e)
        part = float(np.clip(pull / power, 0.0, EXTRAPOLATED))
        cost, step = self._at(self._e + part * change)
        end = np.where(self._strengths, part * trial, trial)
        end[self._rest] += step
        return cost + 0.5 * float(end[self._own] @ end[self._own]), np.clip(end, *self._problem.bounds)

    def _at(self, left: Array) -> tuple[float, Array]:
        """The least cost [nats] where the differences are `left` (M,), and the step of all but the effect."""
        x = self._x[self._rest]
        g = self._J.T @ left + x
        step = -cho_solve(self._H, g)
        return 0.5 * float(left @ left + x @ x + g @ step), step

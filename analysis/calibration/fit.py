"""Maximum a posteriori calibration of a model's free run.

The unknowns x (see `problem`), each N(0, 1) beforehand, minimise

    sum over sections |Sigma^(-1/2) (y - y_hat(x))|^2 + |x|^2

with Sigma as in `noise`, from several starts (the datasheet, and draws from the prior), by scipy's trust region method
with exact derivatives. What Sigma is follows from the data: first from how the measurements flicker in each operating
mode, then from what a fit leaves. The covariance is the inverse of the curvature there, with each standard error at
least what the scatter between blocks of `BLOCK` says (the sandwich of White 1982): noise may be worse than thought.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import OptimizeResult

from faultline.analysis.calibration.noise import Levels, by_square, levels_of
from faultline.analysis.calibration.problem import Problem, Unknowns
from faultline.analysis.calibration.sections import Section, by_median
from faultline.analysis.simulation import System
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]

ROUGH, FINE = 1e-3, 1e-7
"""Relative change of the cost at which the search ends: from a start, and at last."""

ROUNDS = 3
"""How often the weights are made anew from what the fit leaves; the last two differ by little."""

SAME = 5.0
"""Two searches whose costs (half a chi square) differ by less have come to the same place, for all `ROUGH` can tell."""

BLOCK = 1.0
"""Settling times. Longer than anything here remembers."""

SHORT_BLOCKS = 10
"""Recordings shorter than two blocks are cut into so many: one block has no scatter."""

AT_BOUND = 1e-3
"""So near to a bound in standard deviations of the prior, a parameter has run into it."""


@dataclass(frozen=True)
class Fit:
    """The result: x and its covariance (n, n), the `information` (n, n) of the data without the priors, and the noise.

    `starts` is how many searches there were and how many of them came to the best place; `at_bound` the parameters that
    have run into a bound.
    """

    system: System
    unknowns: Unknowns
    x: Array
    covariance: Array
    information: Array
    levels: Levels
    starts: tuple[int, int]
    at_bound: tuple[str, ...]

    @property
    def values(self) -> dict[str, float]:
        """The calibrated parameters."""
        return self.unknowns.theta(self.x)


def fit(system: System, sections: Sequence[Section], say: Callable[[str], None], starts: int = 4) -> Fit:
    """Calibrates the parameters that are symbols of `system`, on fault-free sections; `say` hears how it goes.

    Raises:
        InputError: the model cannot be run from any start.
    """
    problem, model = Problem(system, sections), system.model
    measured = [np.concatenate([s.value for s in section.samples.values()]) for section in sections]
    levels = levels_of(model, sections, measured, by_median)
    weights = problem.weights(np.zeros(problem.unknowns.size), levels)
    rng = np.random.default_rng(1)
    found: list[OptimizeResult] = []
    for number in range(starts):
        x = np.zeros(problem.unknowns.size)
        if number:
            x[: len(system.parameters)] = rng.standard_normal(len(system.parameters))
        say(f"start {number + 1} of {starts}")
        try:
            found.append(problem.search(np.clip(x, *problem.bounds), weights, ROUGH))
        except InputError:  # from there the model cannot be run; at least one start must
            if number + 1 == starts and not found:
                raise
    best = min(found, key=lambda result: float(result.cost))
    same = sum(float(result.cost - best.cost) < SAME for result in found)
    x = best.x
    for number in range(ROUNDS):
        say(f"weights from what is left, round {number + 1} of {ROUNDS}")
        levels = levels_of(model, sections, problem.left(x), by_square)
        x = problem.search(x, problem.weights(x, levels), FINE).x
    return _result(problem, x, levels, (starts, same))


def _result(problem: Problem, x: Array, levels: Levels, starts: tuple[int, int]) -> Fit:
    """The fit at `x`."""
    information, scores = np.zeros((len(x), len(x))), []
    whole = sum(float(section.t[-1]) for section in problem.sections)
    parts = zip(problem.sections, problem.weights(x, levels), problem.slopes(x), problem.left(x), strict=True)
    for section, whitening, J, e in parts:
        J, e = whitening(J), whitening(e)
        information += J.T @ J
        length = BLOCK * section.time.settling_s
        if whole < 2 * length:
            length = whole / SHORT_BLOCKS
        block = (np.concatenate([s.t for s in section.samples.values()]) / length).astype(int)
        scores += [J[block == k].T @ e[block == k] for k in np.unique(block)]
    prior = np.eye(len(x))
    covariance = np.linalg.inv(information + prior)
    between = np.array(scores).T @ np.array(scores) * len(scores) / (len(scores) - 1)
    scattered = np.diag(covariance @ (between + prior) @ covariance)
    inflation = np.sqrt(np.maximum(1.0, scattered / np.diag(covariance)))
    names = problem.system.parameters
    near = np.abs(problem.bounds - x).min(axis=0)[: len(names)] < AT_BOUND
    return Fit(
        system=problem.system,
        unknowns=problem.unknowns,
        x=x,
        covariance=covariance * np.outer(inflation, inflation),
        information=information,
        levels=levels,
        starts=starts,
        at_bound=tuple(name for name, there in zip(names, near, strict=True) if there),
    )

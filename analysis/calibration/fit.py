"""Maximum a posteriori calibration of a model's free run.

The unknowns x (see `problem`), each N(0, 1) beforehand, minimise

    sum over sections |Sigma^(-1/2) (y - y_hat(x))|^2 + |x|^2

with Sigma as in `noise`, from several starts (the datasheet, and draws from the prior), by scipy's trust region method
with exact derivatives. Where fewer than half of these searches agree, or the best ends at a bound or where the data do
not depend on a parameter at all, a global search gives other starts. What Sigma is follows from the data: first from
how the measurements flicker in each operating mode, then from what a fit leaves; and so do the measured inputs, whose
errors would else flatten what is fitted (`likelihood.corrected`).
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import OptimizeResult

from faultline.analysis.calibration.global_starts import global_starts
from faultline.analysis.calibration.likelihood import Likelihood, bins_of, corrected, levels_of
from faultline.analysis.calibration.noise import Weigh
from faultline.analysis.calibration.problem import Nuisance, Problem, Unknowns, carried, with_own
from faultline.analysis.calibration.sections import Section
from faultline.analysis.calibration.uncertainty import uncertainty
from faultline.analysis.simulation import System
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

ROUGH, FINE = 1e-3, 1e-7
"""Relative change of the cost at which the search ends: from a start, and at last."""

ROUNDS = 3
"""How often the weights are made anew from what the fit leaves; the last two differ by little."""

SAME = 5.0
"""Two searches whose costs (half a chi square) differ by less have come to the same place, for all `ROUGH` can tell."""

UNTOLD, LITTLE = 1e-6, 1.0
"""Of a prior's precision. Data that tell less than the first of a parameter have no gradient, as of a threshold beyond
them; those of which they tell less than the second are searched with it."""

AT_BOUND = 1e-3
"""So near to a bound in standard deviations of the prior, a parameter has run into it."""


@dataclass(frozen=True)
class Globally:
    """A global search that followed on the first `starts`: why, and what it came to.

    Of so many sets of parameters `tried` the model could not be run with `failed`. The searches from the best of them
    ended `gain` [nats] better than those before.
    """

    reason: str
    starts: tuple[int, int]
    tried: int
    failed: int
    gain: float


@dataclass(frozen=True)
class Fit:
    """The result: x and its covariance (n, n), the `information` (n, n) of the data without the priors, and the noise.

    `starts` is how many searches there were and how many of them came to the best place: of those that followed on a
    global search, if there was one. `at_bound` are the parameters that have run into a bound.
    """

    system: System
    unknowns: Unknowns
    x: Array
    covariance: Array
    information: Array
    levels: Array
    starts: tuple[int, int]
    at_bound: tuple[str, ...]
    globally: Globally | None = None

    @property
    def values(self) -> dict[str, float]:
        """The calibrated parameters."""
        return self.unknowns.theta(self.x)


def fit(system: System, sections: Sequence[Section], say: Callable[[str], None], starts: int = 4) -> Fit:
    """Calibrates the parameters that are symbols of `system`, on fault-free sections; `say` hears how it goes.

    Raises:
        InputError: the model cannot be run from any start.
    """
    problem, model = Problem(system, sections, lagging=True), system.model
    bins, outputs = [bins_of(section) for section in sections], [*system.outputs]
    measured = [np.concatenate([s.value for s in section.samples.values()]) for section in sections]
    levels = levels_of(model, outputs, bins, [part.mean(y) for part, y in zip(bins, measured, strict=True)])
    weights = Likelihood(problem, np.zeros(problem.unknowns.size), levels, bins).weights
    rng = np.random.default_rng(1)
    begins = [np.zeros(problem.unknowns.size) for _ in range(starts)]
    for x in begins[1:]:
        x[: len(problem.unknowns.parameters)] = rng.standard_normal(len(problem.unknowns.parameters))
    found = _searched(problem, weights, begins, say)
    agreed, globally = (starts, _same(found)), None
    doubt = _doubt(problem, found, agreed)
    if doubt is not None:
        reason, begin, open_ones = doubt
        say(f"a global search, as {reason}")
        other = global_starts(problem, weights, begin, open_ones, starts)
        more = _searched(problem, weights, other.x, say)
        if not found and not more:
            raise InputError(
                f"{model.name}: no free run is found from any start; check the parameters and their priors"
            )
        gain = _cost(found) - _cost([*found, *more]) if found else 0.0
        globally = Globally(reason, agreed, other.tried, other.failed, gain)
        agreed, found = (len(other.x), _same(more) if _cost(more) < _cost(found) + SAME else 0), [*found, *more]
    best = min(found, key=lambda result: float(result.cost))
    x, nearer = best.x, problem
    for number in range(ROUNDS):
        say(f"weights from what is left, round {number + 1} of {ROUNDS}")
        levels = levels_of(model, outputs, bins, [part.mean(e) for part, e in zip(bins, problem.left(x), strict=True)])
        if number:
            sections = corrected(problem, x, levels, bins)
            nearer = Problem(system, sections, lagging=True, commands=problem.commands)
        x = nearer.search(x, Likelihood(nearer, x, levels, bins).weights, FINE).x
    information, covariance = uncertainty(nearer, x, levels)
    ended = _at_bound(problem, x)
    return Fit(system, problem.unknowns, x, covariance, information, levels, agreed, ended, globally)


def nuisances(found: Fit, sections: Sequence[Section]) -> list[Nuisance]:
    """What a fit leaves open of other sections: by log its own conditions, as the sections show them."""
    problem = Problem(found.system, sections, lagging=True, commands=found.unknowns.delays)
    x = carried(found.x, found.unknowns, problem.unknowns)
    x[problem.unknowns.own] = 0.0
    likelihood = Likelihood(problem, x, found.levels, [bins_of(section) for section in sections])
    x = with_own(problem, x, likelihood.weighed)
    return [problem.unknowns.nuisance(x, log) for log in range(problem.unknowns.logs)]


def _searched(
    problem: Problem, weights: Sequence[Weigh], starts: Sequence[Array], say: Callable[[str], None]
) -> list[OptimizeResult]:
    """The optima near `starts`, but for those from which the model cannot be run."""
    found: list[OptimizeResult] = []
    for number, x in enumerate(starts, start=1):
        say(f"start {number} of {len(starts)}")
        with suppress(InputError):
            found.append(problem.search(np.clip(x, *problem.bounds), weights, ROUGH))
    return found


def _cost(found: Sequence[OptimizeResult]) -> float:
    """The least [nats]; infinite of none."""
    return min((float(result.cost) for result in found), default=np.inf)


def _same(found: Sequence[OptimizeResult]) -> int:
    """How many came to the same place as the best."""
    return sum(float(result.cost) - _cost(found) < SAME for result in found)


def _doubt(
    problem: Problem, found: Sequence[OptimizeResult], agreed: tuple[int, int]
) -> tuple[str, Array, Flags] | None:
    """Why the searches from the first starts leave a doubt, the best x (n,), and which of x (n,) are open; or None."""
    names, size = problem.unknowns.parameters, problem.unknowns.size
    of_parameters = np.arange(size) < len(names)
    if not found or 2 * agreed[1] < agreed[0]:
        x = min(found, key=lambda result: float(result.cost)).x if found else np.zeros(size)
        return f"only {agreed[1]} of {agreed[0]} searches came to the same place", x, of_parameters
    best = min(found, key=lambda result: float(result.cost))
    told = np.sum(best.jac**2, axis=0) - 1.0  # one is the prior's
    ended = _at_bound(problem, best.x)
    untold = [name for name, information in zip(names, told.tolist(), strict=False) if information < UNTOLD]
    if not ended and not untold:
        return None
    reasons = [f"{', '.join(ended)} ran into a bound"] if ended else []
    reasons += [f"where the searches ended the data do not depend on {', '.join(untold)}"] if untold else []
    bound = np.isin(np.arange(size), [names.index(name) for name in ended])
    return " and ".join(reasons), best.x, of_parameters & (bound | (told < LITTLE))


def _at_bound(problem: Problem, x: Array) -> tuple[str, ...]:
    names = problem.unknowns.parameters
    near = np.abs(problem.bounds - x).min(axis=0)[: len(names)] < AT_BOUND
    return tuple(name for name, there in zip(names, near, strict=True) if there)

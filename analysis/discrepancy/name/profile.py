"""Intervals of parameters that enter non-linearly, by the profile likelihood.

A time constant that is longer than the recordings is known from below only, and its curvature at the best place says
nothing of that. Here a parameter is held at one value after another, all others are fitted again, and what keeps the
data nearly as likely as the best is in the interval (Venzon and Moolgavkar 1988; Raue and others 2009). What is usual
of an effect's parameters is left out, as far as that goes: the interval is what the recordings say. Where they stay as
likely up to the end of what is possible, that end is open.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.likelihood import Likelihood
from faultline.analysis.calibration.problem import Problem
from faultline.analysis.discrepancy.name.search import descend
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]
Ends = tuple[float | None, float | None]

RISE = 1.92
"""Nats by which the data are less likely at the ends of a 95 % interval: half of chi-square's quantile."""

WIDE = 10.0
"""Times the spread of an effect's parameters beforehand, which is then hardly any opinion."""

FURTHEST = 0.6
"""Of such spreads, to which a parameter without a bound is followed."""

STEPS, REFINED = 5, 2
"""Of each fit with the parameter held, which begins where the one before ended; how often an end is looked for more
closely."""

GROWS, LONGEST = 1.6, 0.1
"""From one step to the next, the first of which is a standard deviation; the longest, in such spreads."""


def widened(problem: Problem, x: Array, own: Sequence[int]) -> Array:
    """Widen the spreads of the parameters with the numbers `own`, and return the same place as `x` (n,) with them."""
    unknowns, x, place = problem.unknowns, x.copy(), np.array(own)
    factor = np.ones(len(unknowns.parameters))
    factor[place] = WIDE
    problem.unknowns = unknowns._replace(priors=unknowns.priors * factor, spreads=unknowns.spreads * factor)
    problem.bounds[:, place] /= WIDE
    x[place] /= WIDE
    return x


def profile(likelihood: Likelihood, problem: Problem, x: Array, k: int, sd: float, scale: float = 1.0) -> Ends:
    """Return the ends of the interval of `x`[k], None of one that is open.

    `sd` is its standard deviation by the curvature at `x` (n,), the best place; `scale` is by how much noise is larger
    than was thought.
    """
    found = {float(x[k]): _held(likelihood, problem, x, k, float(x[k]))}
    limits = np.clip(problem.bounds[:, k], -FURTHEST, FURTHEST)
    rise = RISE * scale
    for side, limit in ((-1.0, float(limits[0])), (1.0, float(limits[1]))):
        value, step = float(x[k]), sd
        while value != limit and found[value][0] < _least(found) + rise:
            ahead = value + side * min(step, LONGEST)
            ahead = limit if side * (ahead - limit) > 0.0 else ahead
            found[ahead] = _held(likelihood, problem, found[value][1], k, ahead)
            value, step = ahead, step * GROWS
    for _ in range(REFINED):
        for middle in _between(found, rise):
            near = min(found, key=lambda value: abs(value - middle))
            found[middle] = _held(likelihood, problem, found[near][1], k, middle)
    return _ends(found, rise)


Found = dict[float, tuple[float, Array]]
"""By value of the parameter: the cost [nats], and where (n,) that is."""


def _held(likelihood: Likelihood, problem: Problem, x: Array, k: int, value: float) -> tuple[float, Array]:
    """The fit with the parameter held; infinite where the model cannot be run."""
    bounds = problem.bounds.copy()
    start = x.copy()
    start[k] = value
    problem.bounds[:, k] = value
    try:
        best = descend(likelihood, problem, start, STEPS)
    except InputError:
        return float("inf"), start
    finally:
        problem.bounds[:] = bounds
    return best.cost, best.x


def _least(found: Found) -> float:
    return min(cost for cost, _ in found.values())


def _between(found: Found, rise: float) -> list[float]:
    """Half way between the neighbours that an end of the interval is between."""
    values, inside = sorted(found), _inside(found, rise)
    return [0.5 * (a + b) for a, b in pairwise(values) if inside[a] != inside[b]]


def _inside(found: Found, rise: float) -> dict[float, bool]:
    least = _least(found)
    return {value: cost < least + rise for value, (cost, _) in found.items()}


def _ends(found: Found, rise: float) -> Ends:
    """Where the cost passes `rise` on straight lines; open where it does not on the way to the end."""
    values, inside, limit = sorted(found), _inside(found, rise), _least(found) + rise
    crossed = [
        a + (b - a) * (limit - found[a][0]) / (found[b][0] - found[a][0])
        if np.isfinite(found[a][0] + found[b][0])
        else (a if inside[a] else b)
        for a, b in pairwise(values)
        if inside[a] != inside[b]
    ]
    low = None if inside[values[0]] else crossed[0]
    high = None if inside[values[-1]] else crossed[-1]
    return low, high

"""What a reference gauge would read if it were one rival or another: for those that no experiment tells apart.

Two sensors may be off together, and not everything is measured. But every rival's fitted model says what each unknown
is; where two of them differ by more than either is sure of, one reading in the workshop decides.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.problem import Problem
from faultline.analysis.calibration.sections import fitting
from faultline.analysis.discrepancy.effects.compiled import system_with
from faultline.analysis.discrepancy.find.quantities import mode_of, quantities
from faultline.analysis.discrepancy.name.attempt import Attempt, Study
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]

DRAWS = 8
"""Of the parameters as they are uncertain: for a standard deviation to a quarter of it."""

DECIDES = 3.0
"""Standard deviations between two rivals' readings."""

SEED = 1

Readings = Mapping[tuple[str, str], tuple[float, float]]
"""Mean and standard deviation of an unknown in an operating mode."""


@dataclass(frozen=True)
class Gauge:
    """A reading of a `variable` [unit] in a `mode`: by rival what it would be, with its standard deviation.

    `told` are the pairs of rivals that it tells apart.
    """

    variable: str
    description: str
    unit: str
    mode: str
    expected: Mapping[str, tuple[float, float]]
    told: tuple[tuple[str, str], ...]


def gauge(
    study: Study, rivals: Sequence[Attempt], pairs: Sequence[tuple[str, str]], precision: Mapping[str, float]
) -> Gauge | None:
    """The reading that tells the most of these pairs apart, by the most; None if none tells any.

    `precision` has the units that a workshop has a gauge for, with its error as a part of the reading. The gauge is put
    in while the system runs as it did in the training recordings.
    """
    if not pairs or not precision:
        return None
    named = {name for pair in pairs for name in pair}
    by_rival = {rival.effects[-1]: readings(study, rival, precision) for rival in rivals if rival.effects[-1] in named}
    best, most = None, (0, 0.0)
    for key in sorted(set.intersection(*({*found} for found in by_rival.values()))):
        apart = {pair: _apart(*(by_rival[name][key] for name in pair)) for pair in pairs}
        told = tuple(pair for pair, deviations in apart.items() if deviations > DECIDES)
        worth = (len(told), min((apart[pair] for pair in told), default=0.0))
        if worth > most:
            variable, mode = key
            unknown, values = study.model.unknown[variable], {name: found[key] for name, found in by_rival.items()}
            best, most = Gauge(variable, unknown.description, unknown.unit, mode, values, told), worth
    return best


def readings(study: Study, rival: Attempt, precision: Mapping[str, float]) -> Readings:
    """What a gauge would read in every mode of the training recordings, of every unknown that one can read."""
    system = system_with(study.model, [study.library[name] for name in rival.effects])
    problem = Problem(system, [fitting(section, system) for section in study.training], lagging=True)
    mode = np.concatenate([mode_of(study.model, system, section) for section in problem.sections])
    names = [name for name, unknown in study.model.unknown.items() if unknown.unit in precision]
    drawn = [found for x in _draws(problem, rival) if (found := _means(problem, x, names, mode))]
    first = _means(problem, rival.x, names, mode)
    spread = {
        key: float(np.std([found[key] for found in drawn], ddof=1)) if len(drawn) > 1 else np.inf for key in first
    }
    exact = {key: precision[study.model.unknown[key[0]].unit] * abs(mean) for key, mean in first.items()}
    return {key: (mean, float(np.hypot(spread[key], exact[key]))) for key, mean in first.items()}


def _draws(problem: Problem, rival: Attempt) -> Iterable[Array]:
    """Values of all that is unknown, as uncertain as it is."""
    rng, place = np.random.default_rng(SEED), np.flatnonzero(rival.inside)
    root = np.linalg.inv(np.linalg.cholesky(rival.curvature[np.ix_(place, place)])).T
    for _ in range(DRAWS):
        x = rival.x.copy()
        x[place] += root @ rng.standard_normal(len(place))
        yield np.clip(x, *problem.bounds)


def _means(
    problem: Problem, x: Array, names: Sequence[str], mode: npt.NDArray[np.int64]
) -> dict[tuple[str, str], float]:
    """By unknown and mode; nothing if the model cannot be run there."""
    try:
        runs = [quantities(trajectory) for trajectory in problem.trajectories(x)]
    except InputError:
        return {}
    modes = problem.system.model.modes.names
    courses = {name: np.concatenate([run[name] for run in runs]) for name in names if name in runs[0]}
    return {(name, modes[k]): float(c[mode == k].mean()) for name, c in courses.items() for k in np.unique(mode)}


def _apart(one: tuple[float, float], other: tuple[float, float]) -> float:
    """How many standard deviations of their difference two readings are apart."""
    return abs(one[0] - other[0]) / max(float(np.hypot(one[1], other[1])), 1e-300)

"""A model with effects added, fitted and judged: how likely it makes the training data, and then the held-out data.

Both are probabilities with everything unknown integrated out, around the optimum (Laplace). The held-out data are
predicted: what the training has left uncertain may still move there, and every recording has conditions of its own.
All attempts have the same weights, those of the baseline, so that their evidences can be subtracted; the baseline is
among them, because an effect at its null value is the baseline's model exactly.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from faultline.analysis.calibration.likelihood import Likelihood, bins_of, blocks, levels_of
from faultline.analysis.calibration.problem import Problem, Unknowns, carried
from faultline.analysis.calibration.sections import Section, fitting
from faultline.analysis.discrepancy.effects.compiled import system_with
from faultline.analysis.discrepancy.effects.effect import Effect
from faultline.analysis.discrepancy.find.followed import Followed, followed
from faultline.analysis.discrepancy.find.latent import Known
from faultline.analysis.discrepancy.find.locate import Location, locate
from faultline.analysis.discrepancy.name.global_search import search
from faultline.analysis.discrepancy.name.profile import Ends, profile, widened
from faultline.analysis.discrepancy.name.search import Optimum, descend
from faultline.analysis.discrepancy.name.sensitivity import Direction, remaining
from faultline.analysis.model import Model
from faultline.analysis.simulation import System
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]

BLOCK = 0.5
"""Settling times. Longer than the slowest state remembers: what is left of blocks is independent."""

ROUNDS = 3
"""How often the baseline is fitted, with levels from what the one before left."""


@dataclass(frozen=True)
class Study:
    """What is known: the `model` as it is, a library of effects, and the sections to fit and those held out.

    The sections are those of the model's system; `fitting` makes them another's. `key` is a hash of model and data.
    """

    key: str
    model: Model
    library: Mapping[str, Effect]
    training: tuple[Section, ...]
    held: tuple[Section, ...]


@dataclass(frozen=True)
class Baseline:
    """Where the model without effects has been fitted: `x` (n,), and the `levels` (outputs, modes) of bins there."""

    x: Array
    levels: Array


@dataclass(frozen=True)
class Attempt:
    """What came out for a model with `effects`.

    `x` (n,) are its `unknowns`' most likely values, `curvature` (n, n) the precision there, `inside` (n,) those not at
    a bound. `cost` [nats] is what the search ended at, `promised` [nats] what was in sight there. `training` and
    `predicted` are log evidences [nats], comparable between attempts of one baseline. `blocks` are log likelihoods of
    `BLOCK` at the optimum, training first; `dispersion` is the mean square of what is left, 1 if only noise is.
    """

    effects: tuple[str, ...]
    unknowns: Unknowns
    x: Array
    curvature: Array
    inside: npt.NDArray[np.bool_]
    cost: float
    promised: float
    training: float
    predicted: float
    blocks: Array
    dispersion: float

    @property
    def evidence(self) -> float:
        """Of all data [nats]."""
        return self.training + self.predicted

    @property
    def values(self) -> dict[str, float]:
        """The parameters' values."""
        return self.unknowns.theta(self.x)

    @property
    def spreads(self) -> dict[str, float]:
        """The parameters' standard deviations, in their units; zero of one at a bound."""
        place = np.flatnonzero(self.inside)
        variance = np.zeros(len(self.x))
        variance[place] = np.diag(np.linalg.inv(self.curvature[np.ix_(place, place)]))
        n = len(self.unknowns.parameters)
        found = np.sqrt(variance[:n]) * np.abs(self.unknowns.theta_by_x(self.x))
        return dict(zip(self.unknowns.parameters, found.tolist(), strict=True))


@dataclass(frozen=True)
class Begin:
    """Where a search begins: the values `x` of other `unknowns`, and what is new at null, or `typical` in size.

    What is new may begin elsewhere, at `places` by name [standard deviations of its prior].
    """

    unknowns: Unknowns
    x: Array
    typical: bool = False
    places: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Glance:
    """What a few steps from some beginning come to: `cost` [nats], where, and what the next step promises [nats]."""

    effects: tuple[str, ...]
    unknowns: Unknowns
    x: Array
    cost: float
    promised: float


@dataclass(frozen=True)
class Scan:
    """A global search over the last effect's own parameters: of so many `sizes` it `failed` to run some.

    `promised` [nats] is what the best size brings by the linear account, `glances` what a few steps from the best come
    to.
    """

    effects: tuple[str, ...]
    glances: tuple[Glance, ...]
    sizes: int
    failed: int
    promised: float


class Judge:
    """Makes attempts, with the weights that hold at the baseline."""

    def __init__(self, study: Study, baseline: Baseline) -> None:
        self._study = study
        self._bins = [bins_of(section) for section in study.training], [bins_of(section) for section in study.held]
        numbers = [blocks(bins, BLOCK * study.model.settling_s) for bins in self._bins]
        self._blocks = np.concatenate([numbers[0], numbers[1] + numbers[0].max() + 1])
        problems = self._with(())
        self._baseline = baseline
        self._nominal = problems[0].unknowns
        self._likelihoods = [
            Likelihood(
                problem, carried(baseline.x, self._nominal, problem.unknowns), baseline.levels, bins, self._expected(k)
            )
            for k, (problem, bins) in enumerate(zip(problems, self._bins, strict=True))
        ]

    def _expected(self, held: int) -> list[Array]:
        """What the effects that are expected may do to the samples (N, D) of each section: one column a strength."""
        found: list[list[Array]] = []
        for name, effect in self._study.library.items():
            if effect.expected:
                problem = self._with((name,))[held]
                x = carried(self._baseline.x, self._nominal, problem.unknowns)
                own = [k for k, parameter in enumerate(problem.unknowns.parameters) if parameter in effect.strengths]
                found.append([slopes[:, own] for slopes in problem.slopes(x)])
        return [np.hstack(parts) for parts in zip(*found, strict=True)]

    def glance(self, effects: Sequence[str], begin: Begin, steps: int) -> Glance:
        """How far a few steps come.

        Raises:
            InputError: an effect has no place in the model, or the model cannot be run there.
        """
        training, _ = self._with(effects)
        found = descend(self._likelihoods[0], training, self._start(effects, begin, training.unknowns), steps)
        return Glance(tuple(effects), training.unknowns, found.x, found.cost, found.promised)

    def scan(self, effects: Sequence[str], begin: Begin, steps: int) -> Scan:
        """Search globally over the last effect's own parameters, and how far a few steps come from the best.

        Raises:
            InputError: an effect has no place in the model, or the model cannot be run without the last one.
        """
        training, _ = self._with(effects)
        x, effect = self._start(effects, begin, training.unknowns), self._study.library[effects[-1]]
        mine, strengths = {*map(effect.prefixed, effect.parameters)}, effect.strengths
        names = training.unknowns.parameters
        own, strong = (
            np.isin(np.arange(len(x)), [names.index(n) for n in of if n in names]) for of in (mine, strengths)
        )
        trials, glances, failed = search(self._likelihoods[0], training, x, own, strong), list[Glance](), 0
        for start in trials.begins:
            try:
                found = descend(self._likelihoods[0], training, start, steps)
            except InputError:  # the linear account went too far
                failed += 1
                continue
            glances.append(Glance(tuple(effects), training.unknowns, found.x, found.cost, found.promised))
        return Scan(tuple(effects), tuple(glances), trials.tried, trials.failed + failed, trials.promised)

    def attempt(self, effects: Sequence[str], begin: Begin | None = None) -> Attempt:
        """The attempt with `effects`, searched from there (none: from the baseline).

        Raises:
            InputError: an effect has no place in the model, or the model cannot be run there.
        """
        training, held = self._with(effects)
        begin = begin or Begin(self._nominal, self._baseline.x)
        best = descend(self._likelihoods[0], training, self._start(effects, begin, training.unknowns))
        predicted, after = predictive(self._likelihoods[1], held, best, training.unknowns)
        e = np.concatenate([self._likelihoods[0].left(training, best.x), after])
        return Attempt(
            effects=tuple(effects),
            unknowns=training.unknowns,
            x=best.x,
            curvature=best.curvature,
            inside=best.inside,
            cost=best.cost,
            promised=best.promised,
            training=best.log_evidence,
            predicted=predicted,
            blocks=np.asarray(-0.5 * np.bincount(self._blocks, e**2), dtype=np.float64),
            dispersion=float(e @ e) / len(e),
        )

    def intervals(self, attempt: Attempt) -> dict[str, Ends]:
        """The 95 % intervals of what effects with a parameter besides their strengths bring, by the profile likelihood.

        None is an end that is open: the training recordings say nothing against any value beyond.
        """
        found: dict[str, Ends] = {}
        place = {name: k for k, name in enumerate(attempt.unknowns.parameters)}
        for effect in (self._study.library[name] for name in attempt.effects):
            own = [name for name in map(effect.prefixed, effect.parameters) if name in place]
            if {*own} <= {*effect.strengths}:
                continue  # strengths alone are nearly linear: the curvature will do
            problem = self._with(attempt.effects)[0]
            x = widened(problem, attempt.x, [place[name] for name in own])
            for name in own:
                k = place[name]
                sd = attempt.spreads[name] / abs(float(problem.unknowns.theta_by_x(x)[k]))
                ends = profile(self._likelihoods[0], problem, x, k, sd or 0.01, max(attempt.dispersion, 1.0))
                low, high = (None if end is None else problem.unknowns.value(k, end) for end in ends)
                found[name] = low, high
        return found

    def left(self, attempt: Attempt) -> tuple[Array, npt.NDArray[np.int64]]:
        """What an attempt leaves of all data, whitened (M,), and the number of each bin's block."""
        training, held = self._with(attempt.effects)
        optimum = Optimum(attempt.x, attempt.cost, attempt.curvature, attempt.inside, attempt.promised)
        _, after = predictive(self._likelihoods[1], held, optimum, attempt.unknowns)
        return np.concatenate([self._likelihoods[0].left(training, attempt.x), after]), self._blocks

    def direction(self, effect: str, place: Begin | None = None) -> Direction:
        """What one effect would do to all data at the baseline, and what remains of it if all else may move.

        Its parameters beside its strengths are as in `place`, if one is given: where a global search found it.
        """
        strengths = self._study.library[effect].strengths
        problems = self._with((effect,))
        parts = []
        for likelihood, problem in zip(self._likelihoods, problems, strict=True):
            x = carried(self._baseline.x, self._nominal, problem.unknowns)
            if place is not None:
                for k, name in enumerate(problem.unknowns.parameters):
                    if name not in self._nominal.parameters and name not in strengths:
                        x[k] = place.x[place.unknowns.parameters.index(name)]
            parts.append((likelihood.slopes(problem, x), problem.unknowns.own))
        unknowns = problems[0].unknowns
        what = np.flatnonzero([name in strengths for name in unknowns.parameters])
        lower, upper = problems[0].bounds[:, what]
        zeros = [J[:, part] for J, part in parts]
        shared = np.concatenate([np.delete(J, np.r_[part], axis=1) for J, part in parts])
        apart = block_diag(*zeros)
        others = np.hstack([np.delete(shared, what, axis=1), apart])
        does = shared[:, what]
        return Direction(effect, does, remaining(does, others), lower, upper, unknowns.spreads[what])

    def locate(self, attempt: Attempt, *, held: bool = False) -> Location:
        """Where the model of an attempt misses something still, in the training or in the `held` out recordings."""
        problem = self._with(attempt.effects)[held]
        x = carried(attempt.x, attempt.unknowns, problem.unknowns)
        if held:
            x[problem.unknowns.own] = 0.0
        return locate(problem, x, self._likelihoods[held].weights)

    def followed(self, attempt: Attempt, x: Array, equation: str) -> Followed:
        """Runs of an attempt's model that follow the training recordings, from another `x` of it on.

        An unknown input of the equation is in place of what is missing.
        """
        return followed(self._with(attempt.effects)[0], x, self._likelihoods[0].weights, equation)

    def unforetold(self, attempt: Attempt) -> Location:
        """Where the held-out recordings depart from what the training foretells of them.

        Parameters are as sure as the training made them: what a large fault does is not taken for other parameters.
        """
        problem = self._with(attempt.effects)[1]
        x = carried(attempt.x, attempt.unknowns, problem.unknowns)
        x[problem.unknowns.own] = 0.0
        free, H = precision(problem, attempt.curvature, attempt.inside, attempt.unknowns)
        return locate(problem, x, self._likelihoods[1].weights, Known(free, np.asarray(np.linalg.cholesky(H).T)))

    def _with(self, effects: Sequence[str]) -> tuple[Problem, Problem]:
        """The problems of the model with effects: the training's and the held-out's."""
        entries = [self._study.library[name] for name in effects]
        return _problems(self._study, system_with(self._study.model, entries))

    def _start(self, effects: Sequence[str], begin: Begin, unknowns: Unknowns) -> Array:
        x = carried(begin.x, begin.unknowns, unknowns)
        if begin.typical:
            strengths = {name for effect in effects for name in self._study.library[effect].strengths}
            x[[k for k, name in enumerate(unknowns.parameters) if name in strengths]] = 1.0
        for k, name in enumerate(unknowns.parameters):
            x[k] = begin.places.get(name, x[k])
        return x


def baseline_of(study: Study) -> Baseline:
    """The model without effects, fitted to the training sections.

    Raises:
        InputError: it cannot be run.
    """
    problems = _problems(study, system_with(study.model, ()))
    bins = [[bins_of(section) for section in sections] for sections in (study.training, study.held)]
    x, outputs = np.zeros(problems[0].unknowns.size), [*problems[0].system.outputs]
    for _ in range(ROUNDS):
        left = [
            [
                part.mean(e)
                for part, e in zip(parts, problem.left(carried(x, problems[0].unknowns, problem.unknowns)), strict=True)
            ]
            for parts, problem in zip(bins, problems, strict=True)
        ]
        levels = levels_of(study.model, outputs, [*bins[0], *bins[1]], [*left[0], *left[1]])
        x = descend(Likelihood(problems[0], x, levels, bins[0]), problems[0], x).x
    return Baseline(x, levels)


def _problems(study: Study, system: System) -> tuple[Problem, Problem]:
    """The training's and the held-out's, with all outputs' lags unknown."""
    fitted, kept = ([fitting(section, system) for section in sections] for sections in (study.training, study.held))
    training = Problem(system, fitted, lagging=True)
    return training, Problem(system, kept, lagging=True, commands=training.commands)


def predictive(likelihood: Likelihood, problem: Problem, optimum: Optimum, known: Unknowns) -> tuple[float, Array]:
    """The log probability [nats] of held-out data given the training, and what they leave (M,) at their own optimum.

    `known` are the optimum's unknowns; each recording has conditions of its own.
    """
    e, J, H = foretold(likelihood, problem, optimum.x, optimum.curvature, optimum.inside, known)
    M, b = J.T @ J + H, J.T @ e
    step = np.linalg.solve(M, b)
    log_probability = -0.5 * float(e @ e - b @ step) - 0.5 * float(np.linalg.slogdet(M)[1] - np.linalg.slogdet(H)[1])
    return log_probability, e - J @ step


def foretold(
    likelihood: Likelihood,
    problem: Problem,
    x: Array,
    curvature: Array,
    inside: npt.NDArray[np.bool_],
    known: Unknowns,
) -> tuple[Array, Array, Array]:
    """What data differ from their prediction by (M,), what is unknown does to it (M, f), and its precision (f, f).

    All whitened: the prediction's covariance is 1 + J H^-1 J'.
    """
    begin = carried(x, known, problem.unknowns)
    begin[problem.unknowns.own] = 0.0
    free, H = precision(problem, curvature, inside, known)
    return likelihood.left(problem, begin), likelihood.slopes(problem, begin)[:, free], H


def precision(
    problem: Problem, curvature: Array, inside: npt.NDArray[np.bool_], known: Unknowns
) -> tuple[npt.NDArray[np.bool_], Array]:
    """Which unknowns (n,) of the problem are free (f), and how precisely (f, f) another fit tells them.

    The conditions of its own recordings are as uncertain as they are.
    """
    own, other, size = problem.unknowns.own, known.own, problem.unknowns.size
    place = np.flatnonzero(inside)
    between = np.linalg.inv(curvature[np.ix_(place, place)])[np.ix_(*2 * [~_within(place, other)])]
    kept = np.delete(np.arange(size), own)[np.delete(inside, other)]
    covariance = np.zeros((size, size))
    covariance[np.ix_(kept, kept)] = between
    covariance[own, own] = np.eye(own.stop - own.start)
    free = np.zeros(size, dtype=np.bool_)
    free[kept] = free[own] = True
    return free, np.linalg.inv(covariance[np.ix_(free, free)])


def _within(place: npt.NDArray[np.int64], part: slice) -> npt.NDArray[np.bool_]:
    return np.asarray((place >= part.start) & (place < part.stop))

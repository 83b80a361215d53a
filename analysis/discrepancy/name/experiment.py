"""The experiment that tells rivals apart: planned on their fitted models, written as a cycle file.

For every experiment of the system the model of the most probable rival is run in a closed loop. Every rival predicts
what would be measured with these inputs, and how uncertain the recordings so far leave that; the evidence to expect is
the divergence of one prediction from another (Kullback and Leibler; after Chen and Asprey 2003). The best experiment is
the one after which the fewest rivals are left to be expected. Where it leaves some, it is continued with what tells
most besides, for as long as the system lets a recording be.
"""

import dataclasses
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from math import sqrt

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from faultline.analysis.calibration.likelihood import Likelihood, bins_of
from faultline.analysis.calibration.problem import Problem, carried
from faultline.analysis.calibration.sections import Section, cut, fitting
from faultline.analysis.discrepancy.data import STEP
from faultline.analysis.discrepancy.effects.compiled import model_with, system_with
from faultline.analysis.discrepancy.effects.experiments import Control, Experiment, joined
from faultline.analysis.discrepancy.find.quantities import mode_of
from faultline.analysis.discrepancy.name.attempt import Attempt, Baseline, Study, foretold
from faultline.analysis.discrepancy.name.contest import QUANTILE, UNLIKELY, difference, scale
from faultline.analysis.model import Equation, Known, Model, Unknown
from faultline.analysis.model.expression import parse_expression
from faultline.analysis.recordings.track import Track
from faultline.analysis.simulation import Drive, System, run, system_of
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]

MANY = 10
"""More rivals than these are not planned for: the experiment is repeated for those that are left."""

RESOLVES = 0.5
"""Probability from which a pair counts as resolved."""

SURE = 0.95
"""Probability from which every pair is resolved well enough, so that an experiment is not continued ..."""

WORTH = 0.02
"""... nor where going on leaves hardly fewer rivals to be expected."""

AHEAD = 3
"""Experiments that a cycle is continued with in turn, the best by themselves first."""


@dataclass(frozen=True)
class Plan:
    """An experiment with the evidence [nats] to expect for each pair: the first is what is there, the second is not.

    `likely` is the probability that this evidence, with that of the recordings so far, rules the second one out.
    `left` is how many wrong rivals are to be expected after it, on average over which is right.
    `beyond` are further rivals, too many to plan for.
    """

    experiment: Experiment
    expected: Mapping[tuple[str, str], float]
    likely: Mapping[tuple[str, str], float]
    left: float
    beyond: tuple[str, ...] = ()

    @property
    def resolved(self) -> Mapping[tuple[str, str], float]:
        """Return the pairs that it tells apart, whichever is right, with the evidence [nats] of the harder case."""
        pairs = [(a, b) for a, b in self.expected if a < b]
        return {
            (a, b): min(self.expected[a, b], self.expected[b, a])
            for a, b in pairs
            if min(self.likely[a, b], self.likely[b, a]) > RESOLVES
        }

    @property
    def unresolved(self) -> tuple[tuple[str, str], ...]:
        """Return the other pairs."""
        return tuple(pair for pair in self.expected if pair[0] < pair[1] and pair not in self.resolved)


def propose(
    study: Study,
    baseline: Baseline,
    rivals: Sequence[Attempt],
    experiments: Sequence[Experiment],
    note: Callable[[str], None] = lambda _: None,
) -> list[Plan]:
    """The experiments by how well they tell the rivals apart, the best first; none where the model is not for them.

    `note` is called for each that could not be planned: a rival's model does not run there, or leaves the range in
    which it holds.
    """
    if not experiments:
        return []
    how = experiments[0].control
    if not {how.actuator, how.command} <= study.model.known.keys() or how.follows not in study.model.unknown:
        return []
    fitted = [_Rival(study, how, attempt) for attempt in rivals[:MANY]]
    noise = _noise_by_mode(study.model, fitted[0].system, study.training)
    beyond = tuple(rival.effects[-1] for rival in rivals[MANY:])

    def planned(experiments: Iterable[Experiment]) -> list[Plan]:
        plans = []
        for experiment in experiments:
            try:
                plans.append(_plan(study, baseline, experiment, fitted, noise, beyond))
            except InputError as error:
                note(f"no plan for {experiment.name}: {error}")
        return sorted(plans, key=lambda plan: plan.left)

    plans = planned(experiments)
    parts = [plan.experiment for plan in plans[:AHEAD]]
    sequence = parts[:1]
    while plans and min(plans[0].likely.values(), default=1.0) < SURE:
        further = {joined(after): after for after in (*([*sequence, part] for part in parts), 2 * sequence)}
        longer = planned(experiment for experiment in further if experiment.duration_s <= how.longest_s)
        if not longer or longer[0].left > plans[0].left - WORTH:
            break
        sequence, plans = further[longer[0].experiment], [longer[0], *plans]
    return plans


class _Rival:
    """A fitted model, open and in a closed loop."""

    def __init__(self, study: Study, how: Control, attempt: Attempt) -> None:
        effects = [study.library[name] for name in attempt.effects]
        self.attempt, self.name, self.how = attempt, attempt.effects[-1], how
        self.system, self._period_s = system_with(study.model, effects), study.model.period_s
        model = _closed(model_with(study.model, effects), how)
        self._loop = system_of(model, model.varying)

    def measured(self, experiment: Experiment, like: Section) -> dict[str, Track]:
        """Every signal as this model would have it, sampled as in the section `like`."""
        how, values = self.how, self.attempt.unknowns.usual(self.attempt.x)
        step_s = STEP * self._period_s
        t = np.arange(0.0, experiment.duration_s, step_s)
        asked = _asked(experiment, t)
        names = self._loop.inputs
        inputs = np.column_stack([asked[0] if name == SET_POINT else asked[1] for name in names])
        start = _start(self._loop, values, how.start)
        guess = np.where(start > 0.5 * how.start, asked[0][:, None], start)  # what follows, or not
        drive = Drive(step_s, inputs, start, guess)
        trajectory = run(self._loop, drive, values)
        followed = trajectory.w[:, self._loop.states.index(how.follows)]
        actuator = _actuator(how, asked[0], followed)
        sampled = np.arange(0.0, t[-1], self._period_s)
        restless = TINY * (-1.0) ** np.arange(len(sampled))  # one that held still would be taken for a command
        tracks = {
            how.actuator: Track(sampled, np.interp(sampled, t, actuator) + restless),
            how.command: Track(sampled, asked[1][np.minimum((sampled / step_s).astype(int), len(t) - 1)]),
        }
        for name, y in trajectory.outputs().items():
            period = float(np.median(np.diff(like.samples[name].t)))
            at = np.arange(0.0, t[-1], period)
            tracks[name] = Track(at, np.interp(at, t, y))
        return tracks


TINY = 1e-9
SET_POINT = "set_point_of_the_plan"


def _closed(model: Model, how: Control) -> Model:
    """The model with its actuator following a set point, which is a new signal."""
    known = {name: k for name, k in model.known.items() if name != how.actuator}
    unit = model.unknown[how.follows].unit
    known[SET_POINT] = Known(unit=unit, description="", min=0.0, max=np.inf, noise=1.0)
    unknown = {
        **model.unknown,
        how.actuator: Unknown(unit=model.known[how.actuator].unit, description="", initial=(), initial_text=()),
    }
    asked = f"({how.offset!r} + {how.gain!r}*({SET_POINT} - {how.follows}))"
    text = f"{how.actuator} - ({asked} + ({asked}**2 + 1)**(1/2))/2"
    names = [*known, *unknown, *model.parameters]
    law = Equation(name="plan", description="", text=text, expression=parse_expression(text, names, "plan"), fault=None)
    return dataclasses.replace(model, known=known, unknown=unknown, equations={**model.equations, "plan": law})


def _actuator(how: Control, set_point: Array, followed: Array) -> Array:
    asked = how.offset + how.gain * (set_point - followed)
    return np.asarray((asked + np.sqrt(asked**2 + 1.0)) / 2.0)


def _asked(experiment: Experiment, t: Array) -> tuple[Array, Array]:
    """Set point and command at the times `t`; a step of the command takes one instant, as a log has it."""
    how = experiment.control
    ends = how.before_s + np.cumsum([duration for duration, _, _ in experiment.segments])
    k = np.searchsorted(ends, t, side="right")
    level = np.array([*(p for _, p, _ in experiment.segments), experiment.segments[-1][1]])[k]
    command = np.array([*(d for _, _, d in experiment.segments), experiment.segments[-1][2]])[k]
    first = t < how.before_s
    wanted = np.where(first, how.start, level)
    most, set_point = how.ramp * float(t[1] - t[0]), wanted.copy()
    for i in range(1, len(t)):
        set_point[i] = set_point[i - 1] + min(max(wanted[i] - set_point[i - 1], -most), most)
    return set_point, np.where(first, 0.0, command)


def _start(system: System, values: Mapping[str, float], level: float) -> Array:
    """The states when what follows the set point has come to this level."""
    numbers = {name: p.value for name, p in system.model.parameters.items()} | dict(values)
    found = []
    for state in system.states:
        expressions = system.model.unknown[state].initial
        chosen = next((e for e in expressions if all(s.name in numbers for s in e.free_symbols)), expressions[0])
        gauge = {s.name: level for s in chosen.free_symbols if s.name not in numbers}
        found.append(float(chosen.subs({**numbers, **gauge})))
    return np.array(found)


def _plan(
    study: Study,
    baseline: Baseline,
    experiment: Experiment,
    rivals: Sequence[_Rival],
    noise: Mapping[int, Array],
    beyond: tuple[str, ...],
) -> Plan:
    """Evaluate an experiment: expected evidence and probability of exclusion of each pair."""
    first = rivals[0]
    tracks = first.measured(experiment, study.training[0])
    sections = [
        dataclasses.replace(
            section, noise=np.array([noise[k] for k in mode_of(study.model, first.system, section).tolist()])
        )
        for section in cut(study.model, first.system, tracks, experiment.name, STEP)
    ]
    problem = _problem(first, sections)
    x = carried(_punctual(first.attempt), first.attempt.unknowns, problem.unknowns)
    likelihood = Likelihood(problem, x, baseline.levels, [bins_of(section) for section in sections])
    of = {rival.name: _prediction(likelihood, rival, sections) for rival in rivals}
    expected = {(a, b): divergence(of[a], of[b]) for a, b in permutations(of, 2)}
    attempts = {rival.name: rival.attempt for rival in rivals}
    likely = {(a, b): ruled_out(attempts[a], attempts[b], nats) for (a, b), nats in expected.items()}
    left = sum(1.0 - p for p in likely.values()) / len(rivals)  # by evidence one may be ahead: they are rivals yet
    return Plan(experiment, expected, likely, left, beyond)


def ruled_out(true: Attempt, other: Attempt, nats: float) -> float:
    """The probability that a rival is no longer one, where the true one is to get so many `nats` more than it.

    A log ratio of likelihoods with the mean D has about the variance 2 D, as it has for normal distributions of the
    same covariance. It adds to what the recordings so far say of the two.
    """
    so_far, spread = difference(true, other)
    needed = max(UNLIKELY * scale(true), QUANTILE * sqrt(spread**2 + 2.0 * nats))
    return float(ndtr((so_far + nats - needed) / sqrt(2.0 * nats + TINY)))


def _problem(rival: _Rival, sections: Sequence[Section]) -> Problem:
    fitted = [fitting(section, rival.system) for section in sections]
    return Problem(rival.system, fitted, lagging=True, commands=rival.attempt.unknowns.delays)


@dataclass(frozen=True)
class Prediction:
    """A normal distribution of whitened data with the mean (M,) and the covariance 1 + J H^-1 J'.

    J (M, f) is what f unknowns do to the data, H (f, f) how precisely they are known.
    """

    mean: Array
    J: Array
    H: Array


def _prediction(likelihood: Likelihood, rival: _Rival, sections: Sequence[Section]) -> Prediction:
    """Predict the sections by a rival, relative to the data that they were made of."""
    a = rival.attempt
    e, J, H = foretold(likelihood, _problem(rival, sections), _punctual(a), a.curvature, a.inside, a.unknowns)
    return Prediction(-e, J, H)


def divergence(true: Prediction, other: Prediction) -> float:
    """Of the other prediction from the true one (Kullback and Leibler): evidence [nats] to expect.

    Inverse and determinant of a covariance are Woodbury's: the unknowns are far fewer than the data.
    """
    d, between = other.mean - true.mean, other.J.T @ true.J
    within = [p.J.T @ p.J for p in (true, other)]
    known = np.linalg.solve(true.H, between.T)
    K = np.linalg.inv(other.H + within[1])
    pulled = other.J.T @ d
    trace = np.trace(np.linalg.solve(true.H, within[0])) - np.trace(K @ (within[1] + between @ known))
    square = float(d @ d - pulled @ K @ pulled)
    logs = _log_determinant(other, within[1]) - _log_determinant(true, within[0])
    return 0.5 * (float(trace) + square + logs)


def _log_determinant(p: Prediction, within: Array) -> float:
    return float(np.linalg.slogdet(p.H + within)[1] - np.linalg.slogdet(p.H)[1])


def _punctual(attempt: Attempt) -> Array:
    """The attempt's x without delays and lags, which the plan has none of."""
    x = attempt.x.copy()
    x[attempt.unknowns.own.stop :] = 0.0
    return x


def _noise_by_mode(model: Model, system: System, recorded: Sequence[Section]) -> Mapping[int, Array]:
    """The inputs' noise, which a plan has none of, as it was recorded on average in each mode, or else in all."""
    noise = np.concatenate([section.noise for section in recorded])
    mode = np.concatenate([mode_of(model, system, section) for section in recorded])
    mean = noise.mean(axis=0)
    return defaultdict(lambda: mean, {int(k): noise[mode == k].mean(axis=0) for k in np.unique(mode)})

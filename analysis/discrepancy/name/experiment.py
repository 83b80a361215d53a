"""The experiment that tells rivals apart: planned on their fitted models, written as a cycle file.

For every experiment of the system and every rival in turn, the rival's model is run in a closed loop: that is
what would be measured if it were the one. Every rival predicts it with what the recordings so far have left uncertain;
the evidence to expect is the divergence of one prediction from another (Kullback and Leibler; after Chen and Asprey
2003). The best experiment is the one after which the fewest rivals are left to be expected.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import exp

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.likelihood import Likelihood, bins_of
from faultline.analysis.calibration.problem import Problem, carried
from faultline.analysis.calibration.sections import Section, cut, fitting
from faultline.analysis.discrepancy.data import STEP
from faultline.analysis.discrepancy.effects.compiled import model_with, system_with
from faultline.analysis.discrepancy.effects.experiments import Control, Experiment
from faultline.analysis.discrepancy.find.quantities import mode_of
from faultline.analysis.discrepancy.name.attempt import Attempt, Baseline, Study, foretold
from faultline.analysis.model import Equation, Known, Model, Unknown
from faultline.analysis.model.expression import parse_expression
from faultline.analysis.recordings.track import Track
from faultline.analysis.simulation import Drive, System, run, system_of
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]

MANY = 6
"""More rivals than these are not planned for: the experiment is repeated for those that are left."""

RESOLVES = 5.0
"""Evidence [nats] to expect for the right one of a pair, from which they are told apart."""


@dataclass(frozen=True)
class Plan:
    """An experiment with the evidence [nats] to expect for each pair: the first is what is there, the second is not.

    `beyond` are further rivals, too many to plan for.
    """

    experiment: Experiment
    expected: Mapping[tuple[str, str], float]
    beyond: tuple[str, ...] = ()

    @property
    def left(self) -> float:
        """About how many rivals will not be told from what is there: each counts less, the more evidence it brings."""
        return sum(exp(-nats / RESOLVES) for nats in self.expected.values()) / len({true for true, _ in self.expected})

    @property
    def told(self) -> Mapping[tuple[str, str], float]:
        """The pairs that it tells apart, whichever of the two is there, with the evidence [nats] of the harder case."""
        worst = {(a, b): min(nats, self.expected[b, a]) for (a, b), nats in self.expected.items() if a < b}
        return {pair: nats for pair, nats in worst.items() if nats > RESOLVES}

    @property
    def untold(self) -> tuple[tuple[str, str], ...]:
        """The pairs that it does not."""
        return tuple(pair for pair in self.expected if pair[0] < pair[1] and pair not in self.told)


def propose(
    study: Study,
    baseline: Baseline,
    rivals: Sequence[Attempt],
    experiments: Sequence[Experiment],
    note: Callable[[str], None] = lambda _: None,
) -> list[Plan]:
    """The experiments by how well they tell the rivals apart, the best first; none where the model is not for them.

    `note` hears which could not be planned: a rival's model does not run there, or leaves the range in which it holds.
    """
    if not experiments:
        return []
    how = experiments[0].control
    if not {how.actuator, how.command} <= study.model.known.keys() or how.follows not in study.model.unknown:
        return []
    fitted = [_Rival(study, how, attempt) for attempt in rivals[:MANY]]
    plans = []
    for experiment in experiments:
        try:
            expected = _expected(study, baseline, experiment, fitted)
            plans.append(Plan(experiment, expected, tuple(rival.effects[-1] for rival in rivals[MANY:])))
        except InputError as error:
            note(f"no plan for {experiment.name}: {error}")
    return sorted(plans, key=lambda plan: plan.left)


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
        told = next((e for e in expressions if all(s.name in numbers for s in e.free_symbols)), expressions[0])
        gauge = {s.name: level for s in told.free_symbols if s.name not in numbers}
        found.append(float(told.subs({**numbers, **gauge})))
    return np.array(found)


def _expected(
    study: Study, baseline: Baseline, experiment: Experiment, rivals: Sequence[_Rival]
) -> dict[tuple[str, str], float]:
    """The evidence to expect for each pair [nats]."""
    expected = {}
    for true in rivals:
        tracks = true.measured(experiment, study.training[0])
        sections = cut(study.model, true.system, tracks, experiment.name, STEP)
        sections = [
            dataclasses.replace(section, noise=_noise(study.model, true.system, section, study.training))
            for section in sections
        ]
        problem = _problem(true, sections)
        x = carried(_punctual(true.attempt), true.attempt.unknowns, problem.unknowns)
        likelihood = Likelihood(problem, x, baseline.levels, [bins_of(section) for section in sections])
        mean, covariance = _prediction(likelihood, true, sections)
        for other in rivals:
            if other is not true:
                e, wider = _prediction(likelihood, other, sections)
                expected[true.name, other.name] = divergence(e - mean, covariance, wider)
    return expected


def _problem(rival: _Rival, sections: Sequence[Section]) -> Problem:
    fitted = [fitting(section, rival.system) for section in sections]
    return Problem(rival.system, fitted, lagging=True, commands=rival.attempt.unknowns.delays)


def _prediction(likelihood: Likelihood, rival: _Rival, sections: Sequence[Section]) -> tuple[Array, Array]:
    """How far (M,) a rival's prediction is off, and its covariance (M, M), whitened."""
    a = rival.attempt
    e, J, H = foretold(likelihood, _problem(rival, sections), _punctual(a), a.curvature, a.inside, a.unknowns)
    return e, np.eye(len(e)) + J @ np.linalg.solve(H, J.T)


def divergence(difference: Array, true: Array, other: Array) -> float:
    """Of normal distributions with means `difference` (M,) apart and covariances (M, M): evidence [nats]."""
    ratio = np.linalg.solve(other, true)
    logs = np.linalg.slogdet(other)[1] - np.linalg.slogdet(true)[1]
    square = float(difference @ np.linalg.solve(other, difference))
    return 0.5 * float(np.trace(ratio) - len(difference) + square + logs)


def _punctual(attempt: Attempt) -> Array:
    """The attempt's x without delays and lags, which the plan has none of."""
    x = attempt.x.copy()
    x[attempt.unknowns.own.stop :] = 0.0
    return x


def _noise(model: Model, system: System, planned: Section, recorded: Sequence[Section]) -> Array:
    """The inputs' noise, which a plan has none of, as it was recorded on average in the same mode."""
    noise = np.concatenate([section.noise for section in recorded])
    mode = np.concatenate([mode_of(model, system, section) for section in recorded])
    level = {k: noise[mode == k].mean(axis=0) for k in np.unique(mode)}
    return np.array([level.get(k, noise.mean(axis=0)) for k in mode_of(model, system, planned)])

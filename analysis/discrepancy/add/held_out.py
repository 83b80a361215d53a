"""The gap before and after: both models run freely over recordings that no fit has seen.

Parameters, lags and delays are the training's. A sensor's zero error is each recording's own, and nobody has told it:
it is taken to be the most likely one (posterior mean) under the model that runs, which adds to no operating mode more
than to another. What is left is weighed as the contest weighed it, in bins of a second.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.likelihood import Bins, Likelihood, bins_of
from faultline.analysis.calibration.problem import Problem, carried, with_own
from faultline.analysis.calibration.sections import Section, fitting
from faultline.analysis.calibration.validate import STEADY, Agreement, validate
from faultline.analysis.discrepancy.add.whiteness import Whiteness, whiteness
from faultline.analysis.discrepancy.effects.compiled import system_with
from faultline.analysis.discrepancy.name.attempt import Attempt, Baseline, Study
from faultline.analysis.simulation import System, Trajectory
from faultline.service.core.signals.modes import EDGE

Array = npt.NDArray[np.float64]

REAL = 1.25
"""Times what a right model has, from which a free run's error is a gap: less differs from run to run."""


@dataclass(frozen=True)
class FreeRun:
    """A model's runs over the held-out `sections`, from whose samples the zero errors `zeros` (by log) are taken off.

    `errors` (N,) are measured less predicted, by section and output; `agreement` and `white` are by output and mode.
    """

    sections: tuple[Section, ...]
    trajectories: tuple[Trajectory, ...]
    errors: tuple[Mapping[str, Array], ...]
    agreement: Mapping[str, Mapping[str, Agreement]]
    white: Mapping[str, Mapping[str, Whiteness]]
    zeros: tuple[Mapping[str, float], ...]


@dataclass(frozen=True)
class Gap:
    """The free run's error of one output in one mode, `before` and `after`, and how white what is left is, if told."""

    output: str
    mode: str
    before: Agreement
    after: Agreement
    white_before: Whiteness | None
    white_after: Whiteness | None

    @property
    def expected(self) -> float:
        """What noise lets expect of a right model: the floor and what the inputs' noise makes of a free run."""
        return self.after.expected

    @property
    def real(self) -> bool:
        """Whether there was more to close than what differs from run to run."""
        return bool(self.before.rms > REAL * self.expected)

    @property
    def closure(self) -> float | None:
        """The part of the gap that is closed, one where the error is as expected or less; None where there was none."""
        if not self.real:
            return None
        return float(min(1.0, (self.before.rms - self.after.rms) / (self.before.rms - self.expected)))


@dataclass(frozen=True)
class Shown:
    """The held-out recordings' free runs with the model `before` effects were added and `after`."""

    before: FreeRun
    after: FreeRun

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """Of every output, in every mode that there is."""
        return tuple(
            Gap(
                output=output,
                mode=mode,
                before=was,
                after=self.after.agreement[output][mode],
                white_before=self.before.white[output].get(mode),
                white_after=self.after.white[output].get(mode),
            )
            for output, by_mode in self.before.agreement.items()
            for mode, was in by_mode.items()
        )

    @property
    def widest(self) -> Gap:
        """The steady gap that was the largest, in parts of what is expected."""
        steady = [gap for gap in self.gaps if gap.mode == STEADY] or [*self.gaps]
        return max(steady, key=lambda gap: np.nan_to_num(gap.before.rms / gap.expected))


def shown(study: Study, baseline: Baseline, before: Attempt, after: Attempt) -> Shown:
    """Both attempts' models over the study's held-out sections.

    Raises:
        InputError: a model cannot be run there.
    """
    problem = _problem(study, before)
    likelihood = Likelihood(
        problem, _as_usual(problem, before), baseline.levels, [bins_of(section) for section in problem.sections]
    )
    first = _free_run(problem, likelihood, before)
    if not after.effects:
        return Shown(first, first)
    return Shown(first, _free_run(_problem(study, after), likelihood, after))


def _problem(study: Study, attempt: Attempt) -> Problem:
    system = system_with(study.model, [study.library[name] for name in attempt.effects])
    sections = [fitting(section, system) for section in study.held]
    return Problem(system, sections, lagging=True, commands=attempt.unknowns.delays)


def _as_usual(problem: Problem, attempt: Attempt) -> Array:
    """The attempt's x for the held-out recordings, whose own conditions are as expected beforehand."""
    x = carried(attempt.x, attempt.unknowns, problem.unknowns)
    x[problem.unknowns.own] = 0.0
    return x


def _free_run(problem: Problem, likelihood: Likelihood, attempt: Attempt) -> FreeRun:
    unknowns, x = problem.unknowns, with_own(problem, _as_usual(problem, attempt), likelihood.weighed)
    nuisances = [unknowns.nuisance(x, log) for log in range(unknowns.logs)]
    zeros = tuple(nuisance.zero for nuisance in nuisances)
    log = np.cumsum([section.number == 0 for section in problem.sections]) - 1
    sections = [_zeroed(section, zeros[k]) for section, k in zip(problem.sections, log, strict=True)]
    values = unknowns.usual(x)
    found = validate(problem.system, sections, values, [nuisance._replace(zero={}) for nuisance in nuisances])
    return FreeRun(
        sections=tuple(sections),
        trajectories=found.trajectories,
        errors=tuple(_by_output(section, e) for section, e in zip(sections, problem.left(x), strict=True)),
        agreement=found.agreement,
        white=_white(problem.system, [w.bins for w in likelihood.weights], likelihood.left(problem, x)),
        zeros=zeros,
    )


def _zeroed(section: Section, zero: Mapping[str, float]) -> Section:
    samples = {name: replace(s, value=s.value - zero.get(name, 0.0)) for name, s in section.samples.items()}
    return replace(section, samples=samples)


def _by_output(section: Section, e: Array) -> dict[str, Array]:
    ends = np.cumsum([len(s.t) for s in section.samples.values()])[:-1]
    return dict(zip(section.samples, np.split(e, ends), strict=True))


def _white(system: System, bins: Sequence[Bins], e: Array) -> dict[str, dict[str, Whiteness]]:
    """Of what is left, whitened, (M,)."""
    output, mode, neighbour = (
        np.concatenate([getattr(part, name) for part in bins]) for name in ("output", "mode", "neighbour")
    )
    run = np.cumsum(~neighbour)
    titles = {name: mode == k for k, name in system.model.modes.listed} | {STEADY: mode != EDGE}
    return {
        name: {
            title: found
            for title, there in titles.items()
            if (found := whiteness(e[there & (output == o)], run[there & (output == o)])) is not None
        }
        for o, name in enumerate(system.outputs)
    }

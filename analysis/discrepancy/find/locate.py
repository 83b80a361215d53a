"""Where a calibrated model misses an effect: in which equation, and where in the operating space.

Every equation in turn gets an unknown input (`unknown_input`), and the evidence for it says how much better the data
are explained (`latent`). Equations whose inputs do the same are one class: the data say what happens there, not why.
Within the class the equation comes first whose missing part is told best by its own quantities (`operating_space`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.noise import Weigh
from faultline.analysis.calibration.problem import Problem
from faultline.analysis.discrepancy.find.classes import inseparable, splitting_sensors
from faultline.analysis.discrepancy.find.disturbed import disturbed_runs
from faultline.analysis.discrepancy.find.features import Operation
from faultline.analysis.discrepancy.find.latent import Known, Latent, Misfit, Response, null_law, tail
from faultline.analysis.discrepancy.find.operating_space import PLAUSIBLE, Finding, columns_of, finding_of
from faultline.analysis.discrepancy.find.refit import without
from faultline.analysis.discrepancy.find.unknown_input import cells_of

Array = npt.NDArray[np.float64]

SIGNIFICANT = 0.01
"""Probability of such evidence for any equation of a model that misses nothing."""

DRAWS = 400
"""Of the null law; its tail is extrapolated."""

SAME = 6.0
"""Evidence that differs by less, twice in nats, is the same."""

ALIKE, NEARLY = 0.75, 0.7
"""An equation that explains so much of what another's input does, with so much of its evidence, is of its class."""

LEAVES = 0.001
"""Of the first equation's evidence: so much its input may leave elsewhere, as what it does is taken for linear."""

LITTLE = 4.0
"""Less evidence is not worth a null law."""

FAR = 0.5
"""A fit that is further off than this, in standard deviations of the prior, is made again without the effect."""

ABSURD = 5.0
"""Parameters so far off, in standard deviations of their prior, are no place to begin from: something has bent them."""


@dataclass(frozen=True)
class Suspect:
    """An equation with what its unknown input explains.

    `evidence` is twice the gain of the log marginal likelihood, `probability` that of as much for any equation when
    nothing is missing, `prior` what was expected of the input (see `unknown_input`). The input: `value` and standard
    deviation `sd` (cells,) at `t` [s] of the recording with the number `log`, added to the equation's right hand side,
    as an amount of `variable` in `unit`; as a fraction it is value / `size`.
    """

    equation: str
    description: str
    evidence: float
    probability: float
    prior: str
    t: Array
    log: npt.NDArray[np.int64]
    value: Array
    sd: Array
    variable: str
    unit: str
    size: float

    @property
    def significant(self) -> bool:
        """Whether chance does not explain it."""
        return self.probability < SIGNIFICANT


@dataclass(frozen=True)
class Location:
    """What `locate` found.

    `suspects` are all equations by evidence; `members` is the class of the best, the most plausible first, empty if
    nothing is missing. `inseparable` are the equations that no recording would tell from the first member if anything
    may be missing, and `sensors` the variables of which each, if measured, would. `findings` say for every member where
    in the operating space, and `courses` (cells, parts) what it follows there, in the cells of its input. `further` is
    the equation, if any, that has significant evidence even when the first member's input is taken for unknown. `x` is
    the fit made again without the effect.
    """

    suspects: tuple[Suspect, ...]
    members: tuple[str, ...]
    inseparable: tuple[str, ...]
    sensors: tuple[str, ...]
    findings: tuple[Finding, ...]
    courses: Mapping[str, Array]
    further: tuple[Suspect, ...]
    x: Array

    @property
    def sentences(self) -> tuple[str, ...]:
        """For people: what and where, what it cannot be told from, what would tell, and what else there is."""
        if not self.members:
            return ("no equation misses anything that these recordings show",)
        named = {suspect.equation: suspect for suspect in self.suspects}
        first, *others = self.members
        found = [self.findings[0].sentence(named[first].description)]
        if others:
            found.append(f"with what is missing unknown, it may as well be in {', '.join(others)}")
        if self.inseparable:
            would = f"; a sensor of {self.sensors[0]} would" if self.sensors else ""
            found.append(f"no recording tells it from {', '.join(self.inseparable)} if anything may be missing{would}")
        found += [f"besides, something is missing in {s.description} ({s.equation})" for s in self.further]
        return tuple(found)


def locate(problem: Problem, x: Array, weights: Sequence[Weigh], known: Known | None = None) -> Location:
    """Where the problem's model misses something, with its fit `x` and the weights that hold there.

    If the effect has bent the fit out of all reason, weights that hold at the parameters as expected are better. With
    what is `known` of x from other recordings nothing is fitted again.

    Raises:
        InputError: the model cannot be run at `x`.
    """
    search = _Search(problem, x, weights, known=known)
    best = search.best
    if not search.suspects[best].significant:
        return Location(search.sorted(), (), (), (), (), {}, (), x)
    nearer = search.made_again() if known is None else search
    if (
        known is None and np.abs(x).max() > ABSURD
    ):  # the effect has bent the fit; from there the way back may be too long
        other = _Search(problem, _as_expected(problem, x), weights, search.square).made_again()
        nearer = max(nearer, other, key=lambda found: found.suspects[found.best].evidence)
    search, best = nearer, nearer.best
    members = search.members(best)
    findings = [finding_of(search.operation, search.misfit, member) for member in members]
    findings.sort(key=lambda finding: -finding.evidence)
    members = tuple(finding.equation for finding in findings)
    first = members[0]
    alike = inseparable(problem.system.model, first)
    sensors = splitting_sensors(problem.system.model, first, alike) if alike else ()
    return Location(
        suspects=search.sorted(),
        members=members,
        inseparable=alike,
        sensors=sensors,
        findings=tuple(findings),
        courses={finding.equation: search.courses(finding) for finding in findings},
        further=search.further(findings[0], members),
        x=search.x,
    )


def _as_expected(problem: Problem, x: Array) -> Array:
    """The parameters as they are expected, all else as it is."""
    count = len(problem.unknowns.parameters)
    return np.concatenate([np.clip(np.zeros(count), *problem.bounds[:, :count]), x[count:]])


class _Search:
    """All equations' unknown inputs at `x`. `square` is the misfit's at the fit, to which gains refer."""

    def __init__(
        self,
        problem: Problem,
        x: Array,
        weights: Sequence[Weigh],
        square: float | None = None,
        known: Known | None = None,
    ) -> None:
        self.x, self._problem, self._weights, self._model = x, problem, weights, problem.system.model
        self.misfit = Misfit(problem, x, weights, known)
        self.square = self.misfit.square if square is None else square
        self._gained = self.square - self.misfit.square
        runs = disturbed_runs(problem, x)
        self._cells = cells_of(runs)
        self._roots, self.operation = self._cells.roots, Operation(runs)
        self._terms = {name: self.operation.terms(name)[0] for name in self._model.equations}
        self.responses: dict[str, Response] = {}
        self.latents: dict[str, Latent] = {}
        self.suspects: dict[str, Suspect] = {}
        plain: dict[str, Response] = {}
        for name, (other, factor) in runs.same_as.items():
            if other not in plain:
                plain[other] = self.misfit.response(runs.outputs(other, self._cells.marks))
            self.responses[name] = response = plain[other].times(factor * self._terms[name].size)
            prior, self.latents[name] = self._latent(response)
            self.suspects[name] = self._suspect(name, response, prior, self.latents[name], self._gained)

    def _latent(self, response: Response) -> tuple[str, Latent]:
        found = {name: Latent(response.gram, response.pull, root) for name, root in self._roots.items()}
        prior = max(found, key=lambda name: found[name].evidence)
        return prior, found[prior]

    def _suspect(self, name: str, response: Response, prior: str, latent: Latent, gained: float) -> Suspect:
        evidence, term, a = max(0.0, latent.evidence + gained), self._terms[name], latent.mean
        chance = 1.0
        if evidence > LITTLE:
            chance = tail(null_law(response.gram, list(self._roots.values()), DRAWS), evidence)
        scale = term.size / abs(term.factor)
        return Suspect(
            equation=name,
            description=self._model.equations[name].description,
            evidence=evidence,
            probability=min(1.0, len(self._model.equations) * chance),
            prior=prior,
            t=self._cells.t,
            log=self._cells.log,
            value=scale * a,
            sd=scale * np.sqrt(np.diag(latent.covariance)),
            variable=term.variable,
            unit=term.unit,
            size=scale,
        )

    def made_again(self) -> "_Search":
        """At the fit made again without what the best equation misses; this one if that is near."""
        x = without(self._problem, self.x, self._weights, self.responses[self.best], self.latents[self.best])
        return _Search(self._problem, x, self._weights, self.square) if np.abs(x - self.x).max() > FAR else self

    @property
    def best(self) -> str:
        """The equation with the largest evidence."""
        return max(self.suspects, key=lambda name: self.suspects[name].evidence)

    def sorted(self) -> tuple[Suspect, ...]:
        """By evidence."""
        return tuple(sorted(self.suspects.values(), key=lambda suspect: -suspect.evidence))

    def members(self, best: str) -> tuple[str, ...]:
        """The class of `best`: what has the same evidence, or explains what its input does about as well."""
        signature = self.misfit.effect(self.responses[best], self.latents[best].mean)
        most = self.suspects[best].evidence
        found = [best]
        for name, suspect in self.suspects.items():
            if name == best or not suspect.significant:
                continue
            near = suspect.evidence > most - SAME
            if near or (suspect.evidence > NEARLY * most and self._share(name, signature) > ALIKE):
                found.append(name)
        return tuple(found)

    def _share(self, name: str, signature: Array) -> float:
        """The part of what another input does that this one can do."""
        response = self.responses[name]
        pull = self.misfit.pull(response.parts, signature)
        a = Latent(response.gram, pull, self._roots[self.suspects[name].prior]).mean
        return float((2.0 * a @ pull - a @ response.gram @ a) / (signature @ signature))

    def courses(self, finding: Finding) -> Array:
        """What the finding's parts follow (cells, parts), in the cells of the unknown input."""
        return self._cells.means(np.column_stack([part.feature.direction for part in finding.parts]))

    def further(self, first: Finding, members: Sequence[str]) -> tuple[Suspect, ...]:
        """The best equation outside of the class that has significant evidence beside what the first one misses.

        That may be anything: what has been found of it in the operating space, and a free input besides.
        """
        C = columns_of(self.operation, self.misfit, first.equation, [part.feature for part in first.parts])
        known = self.responses[first.equation].beside(self.misfit, C, PLAUSIBLE)
        _, latent = self._latent(known)
        found: list[Suspect] = []
        for name, response in self.responses.items():
            if name not in members:
                rest = response.beside(self.misfit, C, PLAUSIBLE).given(known, latent)
                found.append(self._suspect(name, rest, *self._latent(rest), gained=0.0))
        least = LEAVES * self.suspects[first.equation].evidence
        best = [suspect for suspect in found if suspect.significant and suspect.evidence > least]
        return tuple(sorted(best, key=lambda suspect: -suspect.evidence)[:1])

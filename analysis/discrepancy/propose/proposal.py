"""The proposal of a formula where something is missing and no entry of the library describes it.

Candidates of all equations that may miss it are screened to first order; the best are fitted as entries of a library
are, by the same contest: free runs, evidence of the training and of the held-out recordings, two terms at most. What
comes first is proposed, with what the data cannot tell from it. It is a formula and no physics: to be reviewed.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from math import inf, log
from pathlib import Path

from faultline.analysis.discrepancy.discover import REMAINDER, REMAINDER_SHARE, Discovery
from faultline.analysis.discrepancy.effects.effect import Effect
from faultline.analysis.discrepancy.effects.library import effect_of
from faultline.analysis.discrepancy.effects.rewrite import applicable, rewritten
from faultline.analysis.discrepancy.find.locate import Location
from faultline.analysis.discrepancy.name.attempt import Attempt, Begin, Judge, Study
from faultline.analysis.discrepancy.name.contest import Outcome, Say, contest
from faultline.analysis.discrepancy.name.profile import Ends
from faultline.analysis.discrepancy.name.work import Crew
from faultline.analysis.discrepancy.propose.candidates import Candidate
from faultline.analysis.discrepancy.propose.screen import Screened, screened
from faultline.analysis.model import Model, ModelError
from faultline.service.core.errors import InputError

AT_MOST = 2
"""Terms at once: more describe anything."""

MOST_EQUATIONS = 24
"""Equations that are screened, those with the largest evidence of an unknown input."""

NEARLY, NEAR_MOST = 0.9, 6
"""Of the best term's evidence: those that bring as much are near it, and so many of them are gone on with."""

SAME_EACH, SAME_MOST = 2, 20
"""Of candidates that do the same as one of the best to first order, so many of an equation are fitted too: the one that
would explain the most, and the plainest."""


@dataclass(frozen=True)
class Proposal:
    """Terms that are proposed: the `outcome` of the contest among `candidates` by name, in a study of their own.

    `left` is where the model with the terms misses something still; None where that cannot be asked, as `halted` says.
    `tried` is how many terms were composed; `intervals` are those of parameters that enter non-linearly.
    """

    study: Study
    outcome: Outcome
    candidates: Mapping[str, Candidate]
    left: Location | None
    halted: str
    tried: int
    intervals: Mapping[str, Ends]

    @property
    def remainder(self) -> float:
        """The evidence [nats] of an unknown input that is left with the terms in; infinite if that cannot be told."""
        return inf if self.left is None else _evidence(self.left)

    @property
    def terms(self) -> tuple[Candidate, ...]:
        """Those of the model that is proposed, in the order in which they came in."""
        return tuple(self.candidates[name] for name in self.outcome.chosen.effects)

    @property
    def rivals(self) -> tuple[Candidate, ...]:
        """Those that the data cannot tell from one that is proposed."""
        names = [name for place in self.outcome.places for name in place.rivals]
        return tuple(self.candidates[name] for name in names if name not in self.outcome.chosen.effects)

    @property
    def whole(self) -> bool:
        """Whether the terms explain what was missing, but for what an effect's own form leaves."""
        return self.remainder <= max(REMAINDER, REMAINDER_SHARE * self.outcome.gain)


def propose_formula(found: Discovery, executor: Executor, folder: Path | None, say: Say) -> Proposal | None:
    """Return the proposal for a discovery; None where nothing is missing or has a name, or where no term explains it.

    Raises:
        InputError: the model cannot be run.
    """
    if found.verdict.kind != "unnamed" or not found.before.members:
        return None
    nominal, study = found.outcome.nominal, found.study
    say("composing formulas", 0, 1)
    first = found.before.suspects[0].equation
    near = Judge(study, found.baseline).followed(nominal, found.before.x, first)
    equations = [suspect.equation for suspect in found.before.suspects[:MOST_EQUATIONS]]
    field, tried = screened(
        near.misfit, near.operation, equations, lambda candidate: _effect(study.model, candidate) is not None
    )
    law = found.outcome.threshold + log(max(tried, 1))  # as many had the chance

    def compete(those: Sequence[Screened], most: int) -> tuple[Study, Outcome]:
        made, places = dict[str, Effect](), dict[str, float]()
        for each in those:
            effect = _effect(study.model, each.candidate)
            if effect is not None:
                made[effect.name] = effect
                places |= dict.fromkeys(effect.strengths, each.strength)
        expected = {name: effect for name, effect in study.library.items() if effect.expected}
        its = replace(study, library=expected | made)
        crew = Crew(executor, its, found.baseline, folder)
        begin = Begin(nominal.unknowns, near.x, places=places)
        return its, contest(crew, [*made], nominal, law, lambda: begin, say, most=most)

    _, single = compete(field, 1)
    if not single.places:
        return None
    again = _with_same(_near(single, {each.candidate.name: each for each in field}))
    its, outcome = compete(again, AT_MOST)
    if not outcome.places:
        return None
    candidates = {each.candidate.name: each.candidate for each in again}
    outcome = _plainest(outcome, candidates)
    judge = Judge(its, found.baseline)
    left, halted = _left(judge, outcome.chosen)
    return Proposal(its, outcome, candidates, left, halted, tried, judge.intervals(outcome.chosen))


def _left(judge: Judge, chosen: Attempt) -> tuple[Location | None, str]:
    """Where most is left in the training or held-out recordings; or why the model cannot be run where that is asked."""
    try:
        return max((judge.locate(chosen), judge.locate(chosen, held=True)), key=_evidence), ""
    except InputError as error:
        return None, str(error)


def _near(outcome: Outcome, field: Mapping[str, Screened]) -> list[Screened]:
    """Those that bring nearly as much as the best, and those that the model has: the best first."""
    nominal = outcome.nominal.evidence
    gains = {single.effects[0]: single.evidence - nominal for single in outcome.singles}
    best = max(gains.values())
    names = [name for name, gain in gains.items() if gain > NEARLY * best]
    chosen = [name for place in outcome.places for name in place.rivals if name not in names]
    return [field[name] for name in (*names[:NEAR_MOST], *chosen)]


def _with_same(field: Sequence[Screened]) -> list[Screened]:
    """The field, and of those that do the same as one of it the best and the plainest of every equation."""
    found = [*field]
    for each in field:
        for equation in dict.fromkeys(other.candidate.equation for other in each.same):
            best, *more = (other for other in each.same if other.candidate.equation == equation)
            plain = sorted(more, key=lambda other: other.candidate.cost)
            found += [best, *plain[: SAME_EACH - 1]]
    return found[:SAME_MOST]


def _plainest(outcome: Outcome, candidates: Mapping[str, Candidate]) -> Outcome:
    """Of one term that the data cannot tell from others the one that has the most evidence less its cost."""
    if len(outcome.places) != 1:
        return outcome
    place = outcome.places[0]
    attempts = sorted(place.attempts, key=lambda a: candidates[a.effects[-1]].cost - a.evidence)
    return replace(outcome, chosen=attempts[0], places=(replace(place, attempts=tuple(attempts)),))


def _effect(model: Model, candidate: Candidate) -> Effect | None:
    """The entry of a candidate; None for a term that makes no sound model, as a rate that a sensor would show."""
    effect = effect_of(candidate.table, "proposal")
    try:
        if applicable(model, effect) is None:
            rewritten(model, effect)
            return effect
    except ModelError:  # composed by rule, not written: it is no candidate
        pass
    return None


def _evidence(location: Location) -> float:
    return 0.5 * location.suspects[0].evidence if location.members else 0.0

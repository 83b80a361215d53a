"""The whole search: is anything missing, where, what is it, and how sure is that."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from faultline.analysis.discrepancy.data import Data
from faultline.analysis.discrepancy.effects.effect import Effect
from faultline.analysis.discrepancy.effects.library import is_own
from faultline.analysis.discrepancy.effects.rewrite import applicable, rewritten
from faultline.analysis.discrepancy.find.locate import Location
from faultline.analysis.discrepancy.find.onset import Onset, onset
from faultline.analysis.discrepancy.name.attempt import Attempt, Baseline, Begin, Judge, Study, baseline_of
from faultline.analysis.discrepancy.name.contest import Outcome, Say, alone, asked, contest
from faultline.analysis.discrepancy.name.profile import Ends
from faultline.analysis.discrepancy.name.sensitivity import Direction, chance
from faultline.analysis.discrepancy.name.work import Crew

Kind = Literal["nothing missing", "named", "one of", "unnamed", "recordings differ"]

REMAINDER = 30.0
"""Evidence [nats] of an unknown input that is left in the model with the best effects in it, ..."""

REMAINDER_SHARE = 0.1
"""... and as a part of what they brought: more, and their names would be wrong."""

ONE_SIDED = 0.1
"""Of the evidence: where the training recordings have less, and not enough by themselves, the held-out ones were made
under other conditions. What a model lacks shows in both, unless only one of them has the operation in which it acts."""


@dataclass(frozen=True)
class Verdict:
    """What was found: `kind`, for every effect its candidates (one if it is named), in the order of their evidence.

    `remainder` [nats] is the evidence that something is missing still, with the chosen effects in the model.
    """

    kind: Kind
    sets: tuple[tuple[str, ...], ...]
    gain: float
    remainder: float


@dataclass(frozen=True)
class Discovery:
    """All that a search came to.

    `before` is where the model as it was misses something, `after` where that with the chosen effects does, `held`
    where that does in the held-out recordings, `unforetold` where those depart from what the training tells of them.
    `unfit` are entries that have no place in this model, with the reason; `halted` those whose model could not be run
    from some beginning, and that came to nothing from the others; `own` those of a user's file. `intervals` are of the
    chosen effects' parameters that enter non-linearly (see `profile`).
    """

    study: Study
    baseline: Baseline
    outcome: Outcome
    before: Location
    after: Location
    held: Location
    unforetold: Location
    verdict: Verdict
    directions: tuple[Direction, ...]
    unfit: Mapping[str, str]
    halted: Mapping[str, str]
    own: tuple[str, ...] = ()
    intervals: Mapping[str, Ends] = field(default_factory=dict)

    @property
    def rivals(self) -> tuple[Attempt, ...]:
        """The attempts of the first effect that has several names; none where the verdict is another one."""
        if self.verdict.kind != "one of":
            return ()
        return next(place.attempts for place in self.outcome.places if len(place.attempts) > 1)

    @property
    def left(self) -> Location:
        """Where the chosen effects leave the most unexplained: in the training recordings, or in those held out."""
        return max((self.after, self.held), key=_evidence)

    def onset(self, training: Sequence[str], held: Sequence[str]) -> Onset | None:
        """Whether something set in while it was recorded, as faults do; the names are those of the recordings."""
        model = self.study.model
        places = ((self.before, training), (self.after, training), (self.unforetold, held), (self.held, held))
        return next((found for place, names in places if (found := onset(model, place, names)) is not None), None)


def discover(data: Data, library: Mapping[str, Effect], executor: Executor, folder: Path | None, say: Say) -> Discovery:
    """The search in the recordings of `data` for effects of the library; `folder` keeps what is done.

    Raises:
        InputError: the model cannot be run, an entry makes no sound model of it, or a result cannot be kept.
    """
    reasons = {name: applicable(data.model, effect) for name, effect in library.items()}
    unfit = {name: reason for name, reason in reasons.items() if reason is not None}
    fit = {name: effect for name, effect in library.items() if name not in unfit}
    for effect in fit.values():
        if is_own(effect):
            rewritten(data.model, effect)  # what is wrong in a user's entry is said before a minute is spent
    study = Study(data.key, data.studied, fit, data.training_sections, data.held_sections)
    say("the model as it is", 0, 1)
    baseline = baseline_of(study)
    judge = Judge(study, baseline)
    nominal = judge.attempt(())
    crew = Crew(executor, study, baseline, folder)
    before = judge.locate(nominal)
    say("the model as it is", 1, 1)

    def unbent() -> Begin | None:
        return Begin(nominal.unknowns, before.x) if before.members else None

    own = tuple(name for name, effect in library.items() if is_own(effect))
    asked_of = [name for name, effect in fit.items() if not effect.expected]
    missing = _evidence(before)
    outcome = contest(crew, asked_of, nominal, 0.0, unbent, say, own, missing=missing)
    directions = tuple(crew.directions(asked_of, _places(outcome, own)))
    law = chance(directions, *judge.left(outcome.chosen))
    if any(place.gain < law for place in outcome.places):
        outcome = contest(crew, asked_of, nominal, law, unbent, say, own, missing=missing)
    singles = alone(crew, [name for name in own if name in fit], outcome, lambda n, of: say("your own entries", n, of))
    outcome = replace(outcome, singles=singles, threshold=asked(outcome.chosen, law))
    after = judge.locate(outcome.chosen) if outcome.chosen.effects else before
    held, unforetold = judge.locate(outcome.chosen, held=True), judge.unforetold(outcome.chosen)
    judged = {attempt.effects for attempt in outcome.singles}
    halted = {effects[0]: why for effects, why in crew.failures.items() if len(effects) == 1 and effects not in judged}
    verdict = verdict_of(outcome, after, held)
    intervals = judge.intervals(outcome.chosen)
    return Discovery(
        study, baseline, outcome, before, after, held, unforetold, verdict, directions, unfit, halted, own, intervals
    )


def _places(outcome: Outcome, own: Sequence[str]) -> dict[str, Begin]:
    """Where effects were found that a global search was for, and the user's: where they begin they may do nothing."""
    found = {attempt.effects[0]: Begin(attempt.unknowns, attempt.x) for attempt in outcome.singles}
    searched = {
        name: tried.nearest for name, tried in outcome.tried.items() if tried.sizes and tried.nearest is not None
    }
    places = {name: Begin(glance.unknowns, glance.x) for name, glance in searched.items()}
    return places | {name: begin for name, begin in found.items() if name in places or name in own}


def verdict_of(outcome: Outcome, after: Location, held: Location) -> Verdict:
    """What to say of an outcome, with what is left unexplained in the training and the held-out recordings."""
    of_training, of_held = _evidence(after), _evidence(held)
    remainder, sets = max(of_training, of_held), tuple(place.rivals for place in outcome.places)
    kind: Kind
    if not sets:
        kind = "unnamed" if remainder > REMAINDER else "nothing missing"
        one_sided = of_training < ONE_SIDED * of_held
    else:
        brought = outcome.chosen.training - outcome.nominal.training
        one_sided = brought < min(ONE_SIDED * outcome.gain, outcome.threshold)
        kind = "named" if all(len(names) == 1 for names in sets) else "one of"
        if remainder > max(REMAINDER, REMAINDER_SHARE * outcome.gain):
            kind = "unnamed"
    if one_sided and kind != "nothing missing":
        kind = "recordings differ"
    return Verdict(kind, sets, outcome.gain, remainder)


def _evidence(location: Location) -> float:
    """Of the unknown input that is missed most [nats]."""
    return 0.5 * location.suspects[0].evidence if location.members else 0.0

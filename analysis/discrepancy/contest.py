"""Which effects the data ask for: all of the library in turn, the best kept, and again on top of it.

Every entry is fitted and judged. Those that the data cannot tell from the best are its rivals. With the best in the
model the rest is asked again (forward); once another has come in, the first may be replaced or dropped (backward).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from analysis.discrepancy.attempt import Attempt
from analysis.discrepancy.work import Crew, Order

AT_MOST = 3
"""Effects at once: what more are needed, the library lacks."""

UNLIKELY = 5.0
"""Evidence [nats] by which a rival must be worse to be out: odds of 150 to 1."""

QUANTILE = 2.33
"""And so many standard deviations of the difference, from block to block: 99 % (Vuong 1989)."""

SHARE = 0.05
"""Of the first effect's evidence: less is what its form leaves, not another effect."""

WORTH = 3.0
"""Evidence [nats] from which an entry is searched a second time, from the prior."""

Say = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Place:
    """One effect of the model that was chosen: the `rivals` that may be it as well (itself first), and what it brings.

    `gain` [nats] is the evidence lost without it.
    """

    rivals: tuple[str, ...]
    gain: float


@dataclass(frozen=True)
class Outcome:
    """The `nominal` attempt, all `singles` by evidence, the one that is `chosen`, and what its effects are.

    `threshold` [nats] is what chance does not reach.
    """

    nominal: Attempt
    singles: tuple[Attempt, ...]
    chosen: Attempt
    places: tuple[Place, ...]
    threshold: float

    @property
    def gain(self) -> float:
        """The evidence [nats] for what was chosen, against the model as it was."""
        return self.chosen.evidence - self.nominal.evidence


def contest(crew: Crew, effects: Sequence[str], nominal: Attempt, threshold: float, say: Say) -> Outcome:
    """The contest of `effects` for a place in the model."""
    singles = _round(crew, (), effects, nominal, say)
    chosen, places = nominal, list[Place]()
    if singles and singles[0].evidence - nominal.evidence > threshold * scale(singles[0]):
        chosen, field = singles[0], singles
        places = [Place(rivals(field, nominal), chosen.evidence - nominal.evidence)]
        while len(chosen.effects) < AT_MOST:
            others = [name for name in effects if name not in chain.from_iterable(place.rivals for place in places)]
            field = _round(crew, chosen.effects, others, chosen, say)
            needed = max(threshold * scale(chosen), SHARE * places[0].gain)
            if not field or field[0].evidence - chosen.evidence < needed:
                break
            places.append(Place((field[0].effects[-1],), field[0].evidence - chosen.evidence))
            chosen, places = _reconsidered(crew, field[0], chosen, places, field, nominal, needed, say)
    return Outcome(nominal, tuple(singles), chosen, tuple(places), threshold)


def rivals(field: Sequence[Attempt], without: Attempt) -> tuple[str, ...]:
    """The last effects of the attempts, sorted by evidence, that the data cannot tell from the first one's."""
    best = field[0]
    found = [best.effects[-1]]
    for other in field[1:]:
        gap = best.evidence - other.evidence
        spread = float(np.std(best.blocks - other.blocks)) * np.sqrt(len(best.blocks))
        helps = other.evidence - without.evidence > 0.0
        if helps and gap < max(UNLIKELY * scale(best), QUANTILE * spread):
            found.append(other.effects[-1])
    return tuple(found)


def scale(best: Attempt) -> float:
    """By how much evidence is too sure of itself: what is left even of the best model is more than the noise."""
    return max(best.dispersion, 1.0)


def _round(crew: Crew, base: tuple[str, ...], names: Sequence[str], near: Attempt, say: Say) -> list[Attempt]:
    """Attempts with each of `names` on top of `base`, by evidence, the best first."""
    title = f"on top of {', '.join(base)}" if base else "effects one by one"
    start = near if base else None
    found = crew.attempts([Order((*base, name), start, ("near",)) for name in names], lambda n, of: say(title, n, of))
    best = {attempt.effects: attempt for attempt in found}
    if any(attempt.evidence - near.evidence > WORTH for attempt in found):
        again = [Order((*base, name), start, ("prior",)) for name in names]
        for attempt in crew.attempts(again, lambda n, of: say(f"{title}, from elsewhere", n, of)):
            other = best.get(attempt.effects)
            if other is None or min(attempt.starts.values()) < min(other.starts.values()):
                best[attempt.effects] = attempt
    return sorted(best.values(), key=lambda attempt: -attempt.evidence)


def _reconsidered(
    crew: Crew,
    chosen: Attempt,
    before: Attempt,
    places: Sequence[Place],
    field: Sequence[Attempt],
    nominal: Attempt,
    needed: float,
    say: Say,
) -> tuple[Attempt, list[Place]]:
    """With the newest effect in, the rivals of each place again, and whether every effect is still needed."""
    found: list[Place] = []
    effects = list(chosen.effects)
    for k, place in enumerate(places):
        rest = effects[:k] + effects[k + 1 :]
        newest = k + 1 == len(places)
        if newest:
            ranked, without = list(field), before
        else:
            orders = [Order((*rest, name), chosen) for name in place.rivals]
            orders.append(Order(tuple(rest), chosen))
            tried = crew.attempts(orders, lambda n, of: say("backward", n, of))
            without = next(attempt for attempt in tried if len(attempt.effects) == len(rest))
            ranked = sorted((a for a in tried if a is not without), key=lambda a: -a.evidence)
        gain = ranked[0].evidence - without.evidence
        if gain < needed:
            return without, [p for j, p in enumerate(places) if j != k]
        effects[k] = ranked[0].effects[-1]
        if ranked[0].evidence > chosen.evidence:
            chosen = ranked[0]
        found.append(Place(rivals(ranked, without), gain))
    return chosen, found

"""Which effects the data ask for: all of the library in turn, the best kept, and again on top of it.

Every entry is fitted and judged. Those that the data cannot tell from the best are its rivals. With the best in the
model the rest is asked again (forward); once another has come in, the first may be replaced or dropped (backward).
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from faultline.analysis.discrepancy.name.attempt import Attempt, Begin, Glance
from faultline.analysis.discrepancy.name.tried import (
    UNSETTLED,
    WORTH,
    Tried,
    promise,
    scanned,
    stuck,
    tried_of,
    unpromising,
)
from faultline.analysis.discrepancy.name.work import Crew, Order

AT_MOST = 3
"""Effects at once: what more are needed, the library lacks."""

LEAST = 10.0
"""Evidence [nats] below which nothing is said, whatever chance may bring: with less, dozens of entries can be told
apart no more than the noise allows, and the right one may be out of the contest."""

PART = 0.1
"""Of the evidence for an unknown input: where the best effect brings less, no few of them are what is missing, and no
further one is looked for."""

UNLIKELY = 5.0
"""Evidence [nats] by which a rival must be worse to be out: odds of 150 to 1."""

QUANTILE = 2.0
"""And so many standard deviations of the difference, from block to block: 98 % (Vuong 1989)."""

SHARE = 0.01
"""Of the first effect's evidence: less is what its form leaves, not another effect."""

STEPS, FURTHER, FAR = 2, 1, 4
"""Of a glance, of one for a further effect, and of one from the prior: by then most show that it is not they."""

FIELD, MOST = 8, 16
"""So many are fitted to the end, and besides those that come near the best, in `NEAR` of its gain, but not more than
`MOST`: far from the optimum all promise a lot."""

NEAR, CLOSE = 0.4, 10.0
"""Within this part of the best one's gain, or within so much [nats] of it: a small gain is no order, as entries pay for
their freedom yet."""

HOPE = 2.0
"""Times what the next step of a glance promises may be won on the rest of its way."""

LAPS = 6
"""How often a search that is not at its end goes on, at most."""

Say = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Place:
    """One effect of the model that was chosen: `attempts` with it, and with those that may be it as well, best first.

    `gain` [nats] is the evidence lost without it.
    """

    attempts: tuple[Attempt, ...]
    gain: float

    @property
    def rivals(self) -> tuple[str, ...]:
        """The effects' names."""
        return tuple(attempt.effects[-1] for attempt in self.attempts)


@dataclass(frozen=True)
class Outcome:
    """The `nominal` attempt, all `singles` by evidence, the one that is `chosen`, and what its effects are.

    `threshold` [nats] is what was asked for. `tried` says of each effect how it was searched alone.
    """

    nominal: Attempt
    singles: tuple[Attempt, ...]
    chosen: Attempt
    places: tuple[Place, ...]
    threshold: float
    tried: Mapping[str, Tried] = field(default_factory=dict)

    @property
    def gain(self) -> float:
        """The evidence [nats] for what was chosen, against the model as it was."""
        return self.chosen.evidence - self.nominal.evidence


def contest(
    crew: Crew,
    effects: Sequence[str],
    nominal: Attempt,
    law: float,
    unbent: Callable[[], Begin | None] | None,
    say: Say,
    own: Collection[str] = (),
    most: int = AT_MOST,
    missing: float = 0.0,
) -> Outcome:
    """The contest of `effects` for `most` places in the model, for each of which chance brings `law` [nats] at most.

    `missing` [nats] is what an unknown input would bring. `unbent` gives a place for searches to begin from where no
    parameter does a missing effect's work; it takes a while. Without it they begin at the nominal attempt only. What no
    local search settles is searched globally: an effect of the user's `own` always, others alone in the model and where
    `unbent` has a place, so that something is missing.
    """
    singles, tried = _round(crew, nominal, effects, WORTH, unbent, say, own)
    chosen, places = nominal, list[Place]()
    if singles and singles[0].evidence - nominal.evidence > asked(singles[0], law):
        chosen = singles[0]
        places = [Place(rivals(singles, nominal), chosen.evidence - nominal.evidence)]
        for _ in range(2 * AT_MOST):  # each round adds one and may drop another: it must end
            if len(chosen.effects) >= most or places[0].gain < PART * missing:
                break
            needed = max(asked(chosen, law), SHARE * places[0].gain)
            rest = [name for name in effects if name not in chosen.effects]
            others, _ = _round(crew, chosen, rest, needed, None, say, own)
            if not others or others[0].evidence - chosen.evidence < needed:
                break
            places.append(Place(rivals(others, chosen), others[0].evidence - chosen.evidence))
            chosen, places = _reconsidered(crew, others[0], places, needed, say)
    return Outcome(nominal, tuple(singles), chosen, tuple(places), asked(chosen, law), tried)


def alone(crew: Crew, names: Sequence[str], outcome: Outcome, say: Callable[[int, int], None]) -> tuple[Attempt, ...]:
    """All singles by evidence, with those of `names` that were not fitted to the end as they promise little."""
    nominal, judged = outcome.nominal, {attempt.effects[0] for attempt in outcome.singles}
    begins = [Begin(nominal.unknowns, nominal.x), Begin(nominal.unknowns, np.zeros_like(nominal.x), typical=True)]
    rest = [name for name in names if name not in judged]
    nearest = {name: tried.nearest for name, tried in outcome.tried.items() if tried.nearest is not None}
    orders = [Order((name,), begin) for name in rest for begin in begins]
    orders += [Order((n,), Begin(nearest[n].unknowns, nearest[n].x)) for n in rest if n in nearest]
    attempts = crew.attempts(orders, say)
    best: dict[str, Attempt] = {}
    for attempt in sorted(attempts, key=lambda attempt: attempt.cost):
        best.setdefault(attempt.effects[0], attempt)
    return tuple(sorted((*outcome.singles, *best.values()), key=lambda attempt: -attempt.evidence))


def asked(best: Attempt, law: float) -> float:
    """Evidence [nats] from which an effect is named: `law` is what chance brings with the noise that is left."""
    return max(LEAST * scale(best), law)


def rivals(field: Sequence[Attempt], without: Attempt) -> tuple[Attempt, ...]:
    """Of attempts sorted by evidence, those whose last effects the data cannot tell from the first one's."""
    best = field[0]
    found = [best]
    for other in field[1:]:
        gap, spread = difference(best, other)
        helps = other.evidence - without.evidence > 0.0
        if helps and gap < max(UNLIKELY * scale(best), QUANTILE * spread):
            found.append(other)
    return tuple(found)


def difference(one: Attempt, other: Attempt) -> tuple[float, float]:
    """Difference of the evidences of two attempts, and its standard deviation estimated from the blocks [nats]."""
    blocks = one.blocks - other.blocks
    return one.evidence - other.evidence, float(np.std(blocks) * np.sqrt(len(blocks)))


def scale(best: Attempt) -> float:
    """By how much evidence is too sure of itself: what is left even of the best model is more than the noise."""
    return max(best.dispersion, 1.0)


def _round(
    crew: Crew,
    base: Attempt,
    names: Sequence[str],
    worth: float,
    unbent: Callable[[], Begin | None] | None,
    say: Say,
    own: Collection[str],
) -> tuple[list[Attempt], dict[str, Tried]]:
    """Attempts with one of `names` on top of `base`, by evidence, the best first: of those that may be the best.

    None where a glance promises none of them a gain of `worth` [nats]. Also how each of them was searched.
    """
    title = f"on top of {', '.join(base.effects)}" if base.effects else "effects one by one"
    begin = Begin(base.unknowns, base.x)
    orders = [Order((*base.effects, name), begin, FURTHER if base.effects else STEPS) for name in names]
    found = crew.glances(orders, partial(say, title))
    starts = [begin]
    other = None if unbent is None else unbent()
    if other is not None or (unbent is not None and any(promise(glance, base) >= worth for glance in found)):
        elsewhere = [(Begin(base.unknowns, np.zeros_like(base.x), typical=True), FAR)]
        elsewhere += [] if other is None else [(other, STEPS)]
        orders = [Order((*base.effects, name), start, steps) for start, steps in elsewhere for name in names]
        found += crew.glances(orders, partial(say, f"{title}, from elsewhere"))
        starts += [start for start, _ in elsewhere]
    wide = names if other is not None else [name for name in names if name in own]
    scans = scanned(crew, base, unpromising(wide, found, base), partial(say, f"{title}, globally"))
    found += [glance for scan in scans for glance in scan.glances]
    attempts = dict[str, Attempt]()
    if any(promise(glance, base) >= worth for glance in found):
        attempts = _ended(crew, _field(found, base), {}, title, say)
        first = {scan.effects[-1] for scan in scans}
        again = [name for name in wide if name in attempts and name not in first and stuck(attempts[name], base)]
        more = scanned(crew, base, again, partial(say, f"{title}, globally"))
        attempts = _ended(crew, [[*scan.glances] for scan in more], attempts, title, say)
        scans += more
    tried = tried_of(dict.fromkeys(names, len(starts)), found, scans, base)
    return sorted(attempts.values(), key=lambda attempt: -attempt.evidence), tried


def _ended(
    crew: Crew, field: Sequence[Sequence[Glance]], known: Mapping[str, Attempt], title: str, say: Say
) -> dict[str, Attempt]:
    """The best attempts from the glances of a `field`, by effect, and those `known` before."""
    attempts = dict(known)
    for rest, wave in (("to the end", [glances[:1] for glances in field]), ("again", [g[1:] for g in field])):
        orders = [
            Order(glance.effects, Begin(glance.unknowns, glance.x))
            for glances in wave
            for glance in glances
            if not _beaten(glance, attempts.get(glance.effects[-1]))
        ]
        for attempt in crew.attempts(orders, partial(say, f"{title}, {rest}")):
            before = attempts.get(attempt.effects[-1])
            if before is None or attempt.cost < before.cost:
                attempts[attempt.effects[-1]] = attempt
    return _settled(crew, attempts, partial(say, f"{title}, to the very end"))


def _settled(crew: Crew, attempts: Mapping[str, Attempt], say: Callable[[int, int], None]) -> dict[str, Attempt]:
    """The attempts, the best and those that may catch up with it at their optimum.

    A large effect has bent everything, so that the way to the optimum may be longer than a search goes.
    """
    found, ended = dict(attempts), set[str]()
    for _ in range(LAPS):
        going = {name: a for name, a in found.items() if name not in ended and a.promised > UNSETTLED}
        best = min(found, key=lambda name: found[name].cost, default="")
        if best in going:
            going = {best: going[best]}  # once it is there, most of the others are out of the race
        orders = [Order(a.effects, Begin(a.unknowns, a.x)) for a in going.values() if not _beaten(a, found[best])]
        if not orders:
            break
        came = {a.effects[-1]: a for a in crew.attempts(orders, say)}
        better = {name: a for name, a in came.items() if a.cost < found[name].cost - UNSETTLED}
        found |= better
        ended |= {*going} - {*better}
    return found


def _beaten(one: Glance | Attempt, by: Attempt | None) -> bool:
    """Whether what one promises is not near what another found already: the rest of the way is not worth it."""
    return by is not None and one.cost - HOPE * one.promised > by.cost


def _field(found: Sequence[Glance], base: Attempt) -> list[list[Glance]]:
    """The glances to follow to the end: of each effect that may be the best all, the most promising first."""
    best = min(glance.cost for glance in found)
    near = best + max((1.0 - NEAR) * (base.cost - best), CLOSE)
    by_effect: dict[str, list[Glance]] = {}
    for glance in sorted(found, key=lambda glance: glance.cost - glance.promised):
        by_effect.setdefault(glance.effects[-1], []).append(glance)
    field = list[list[Glance]]()
    for k, glances in enumerate([*by_effect.values()][:MOST]):
        first = glances[0]
        if (k < FIELD or first.cost - first.promised < near) and first.cost - first.promised < base.cost:
            field.append(glances)
    return field


def _reconsidered(
    crew: Crew, chosen: Attempt, places: Sequence[Place], needed: float, say: Say, holds: bool = True
) -> tuple[Attempt, list[Place]]:
    """The rivals of all places again, with all other effects in, and whether each is still needed.

    Of the newest place that `holds`, as long as the others stay what they were and it brings what it did.
    """
    found: list[Place] = []
    for k, place in enumerate(places):
        if k == len(places) - 1 and holds and _brings(crew, chosen, place, say):
            found.append(place)
            break
        rest = [name for name in chosen.effects if name != place.rivals[0]]
        begin = Begin(chosen.unknowns, chosen.x)
        orders = [Order((*rest, name), begin) for name in place.rivals if name not in rest]
        attempts = crew.attempts([*orders, Order(tuple(rest), begin)], lambda n, of: say("backward", n, of))
        without = next((attempt for attempt in attempts if len(attempt.effects) == len(rest)), None)
        rivals_of = {a.effects[-1]: a for a in attempts if a is not without}
        settled = _settled(crew, rivals_of, lambda n, of: say("backward, to the very end", n, of))
        tried = sorted(settled.values(), key=lambda attempt: -attempt.evidence)
        if without is None or not tried:  # one of the two cannot be run from here: the place stays as it was
            found.append(place)
            continue
        gain = tried[0].evidence - without.evidence
        if gain < needed:
            return _reconsidered(crew, without, [*found, *places[k + 1 :]], needed, say, holds=False)
        holds = holds and tried[0].effects[-1] == place.rivals[0]
        chosen = tried[0]
        found.append(Place(rivals(tried, without), gain))
    return chosen, found


def _brings(crew: Crew, chosen: Attempt, place: Place, say: Say) -> bool:
    """Whether the newest effect has the gain of its place still: it may have been no more than the way to an optimum.

    What was chosen without it stood at a worse one then, which this sees as it begins at the better one.
    """
    rest = Order(tuple(name for name in chosen.effects if name != place.rivals[0]), Begin(chosen.unknowns, chosen.x))
    found = crew.attempts([rest], lambda n, of: say("backward", n, of))
    return all(chosen.evidence - without.evidence > place.gain - UNSETTLED for without in found)

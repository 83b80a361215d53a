"""How each effect was searched alone, and which of them the local search left open: those are searched globally."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from faultline.analysis.discrepancy.name.attempt import Attempt, Begin, Glance, Scan
from faultline.analysis.discrepancy.name.work import Crew, Order

STEPS = 4
"""From each of the best sizes of a global search."""

WORTH = 3.0
"""Gain [nats] in a glance from which anything is looked at again."""

UNSETTLED = 1.0
"""Evidence [nats] in sight from which a search is not at its end."""


@dataclass(frozen=True)
class Tried:
    """How an effect was searched: from so many `starts`, and globally over so many `sizes`, if there are any.

    With `failed` of these the model could not be run. `promised` [nats] is the most that a glance had in sight, which
    was `nearest`; both are of no effect where the model could be run from nowhere.
    """

    starts: int
    promised: float = 0.0
    nearest: Glance | None = None
    sizes: int = 0
    failed: int = 0


def promise(glance: Glance, base: Attempt) -> float:
    """The gain [nats] over `base` that a glance has in sight."""
    return base.cost - glance.cost + glance.promised


def unpromising(names: Iterable[str], found: Sequence[Glance], base: Attempt) -> list[str]:
    """The effects of which no glance promises a gain, or of which there is none as the model could not be run."""
    good = {glance.effects[-1] for glance in found if promise(glance, base) >= WORTH}
    return [name for name in names if name not in good]


def stuck(attempt: Attempt, base: Attempt) -> bool:
    """True if a parameter of the last effect ended at a bound (not at no effect), or the search is not at its end."""
    own = [k for k, name in enumerate(attempt.unknowns.parameters) if name not in base.unknowns.parameters]
    return attempt.promised > UNSETTLED or any(not attempt.inside[k] and attempt.x[k] != 0.0 for k in own)


def scanned(crew: Crew, base: Attempt, names: Collection[str], say: Callable[[int, int], None]) -> list[Scan]:
    """Search each of `names` globally on top of `base`."""
    begin = Begin(base.unknowns, base.x)
    orders = [Order((*base.effects, name), begin, STEPS, globally=True) for name in names]
    return crew.scans(orders, say) if orders else []


def tried_of(
    starts: Mapping[str, int], found: Sequence[Glance], scans: Sequence[Scan], base: Attempt
) -> dict[str, Tried]:
    """How each effect was searched from its number of `starts`, by all glances `found` and by the `scans`."""
    tried = {}
    by_name = {scan.effects[-1]: scan for scan in scans}
    for name, count in starts.items():
        own = [glance for glance in found if glance.effects[-1] == name]
        nearest = max(own, key=lambda glance: promise(glance, base), default=None)
        scan = by_name.get(name)
        tried[name] = Tried(
            starts=count,
            promised=max(0.0 if nearest is None else promise(nearest, base), 0.0),
            nearest=nearest,
            sizes=scan.sizes if scan else 0,
            failed=scan.failed if scan else 0,
        )
    return tried

"""Which generators to keep: the required isolation at the fewest false alarms, then at the lowest cost.

A generator *reaches* a case if its test is structurally sensitive to the fault and it alarms in at least half of the
case's blocks, and more often than without a fault: the exact intervals lie apart. It isolates the case from another
fault if besides the structure decouples that one: silence of a test that merely has not alarmed exonerates nobody.
Networks detect and do not isolate: they are no conflicts (decision 010). A requirement (a case is detected; it is
isolated from a fault) is the set of generators that meet it, and a selection must have one of each set. Among these the
search takes the one with the fewest fault-free blocks in which any of its generators alarms, then that of the least
cost, then the first.

Generators that are numerically the same signal count once: an alarm of one of them is that of all, so a second one
costs no further false alarm, and two are no more evidence than one.
"""

from collections.abc import Sequence

import msgspec
import numpy as np
import numpy.typing as npt

from faultline.service.core.signals.values import Mask

REACHED = 0.5
EXACT = 20
"""Generators up to which all sets are looked at: a million."""


class Requirement(msgspec.Struct, frozen=True):
    """A case that must be detected (`other` None) or isolated from a fault, and the generators that do."""

    case: str
    other: str | None
    met_by: list[str]


class Selection(msgspec.Struct, frozen=True, kw_only=True):
    """The generators to keep, of those there are, with what they cost.

    `false_blocks` of `free_blocks` fault-free blocks have an alarm of one of them; `all_false_blocks` of any generator.
    `cost` is one for each generator and for each of its states; `alternatives` are other sets that do as well. `unmet`
    are requirements that no generator meets in these recordings: the choice is made without them.
    """

    keep: list[str]
    drop: list[str]
    alternatives: list[list[str]]
    false_blocks: int
    all_false_blocks: int
    free_blocks: int
    cost: int
    all_cost: int
    requirements: list[Requirement]
    unmet: list[str]


class Reach(msgspec.Struct, frozen=True):
    """A case with its faults and, for each generator (T,), whether it reaches it."""

    case: str
    faults: tuple[str, ...]
    by: list[bool]


def select(
    names: Sequence[str],
    sensitive: Sequence[Sequence[str]],
    states: Sequence[int],
    reached: Sequence[Reach],
    false_alarms: Mask,
    equal: Sequence[int],
    known: Sequence[str],
    isolating: Sequence[bool],
    required: Sequence[tuple[str, str | None]] = (),
) -> Selection:
    """The best set of generators.

    `sensitive` are each generator's faults, `states` its number of states, `false_alarms` (N, T) whether it alarmed in
    each fault-free block, `equal` for each generator the first one that is the same signal, `known` the bundle's
    faults, `isolating` whether an alarm of each is a conflict over its faults and not only a suspicion. `required` are
    faults with another one that they must be isolated from, or with None where they must be detected, in every case
    that some generator reaches; without it, all that the generators do together is required.
    """
    assert len(names) <= EXACT, "more sets than can be looked at"
    clauses, unmet = _wanted(requirements(names, sensitive, reached, known, isolating), reached, required)
    together = once(false_alarms, equal)
    sets = np.arange(1 << len(names))
    meets = np.ones(len(sets), dtype=np.bool_)
    for clause in clauses:
        meets &= (sets & _mask([names.index(name) for name in clause.met_by])) != 0
    false = _false(together, sets)
    cost = _cost(states, sets)
    order = false.astype(np.int64) * (sum(states) + len(names) + 1) + cost
    order[~meets] = np.iinfo(np.int64).max
    best = np.flatnonzero(order == order.min())
    chosen, *others = ([name for k, name in enumerate(names) if s >> k & 1] for s in best.tolist())
    return Selection(
        keep=chosen,
        drop=[name for name in names if name not in chosen],
        alternatives=others[:10],
        false_blocks=int(false[best[0]]),
        all_false_blocks=int(false[-1]),
        free_blocks=len(false_alarms),
        cost=int(cost[best[0]]),
        all_cost=int(cost[-1]),
        requirements=clauses,
        unmet=unmet,
    )


def requirements(
    names: Sequence[str],
    sensitive: Sequence[Sequence[str]],
    reached: Sequence[Reach],
    known: Sequence[str],
    isolating: Sequence[bool],
) -> list[Requirement]:
    """What all generators together do: every case that one reaches, and every fault that one isolates it from."""
    found = []
    for reach in reached:
        by = [name for name, reaches in zip(names, reach.by, strict=True) if reaches]
        if by:
            found.append(Requirement(reach.case, None, by))
        for other in known:
            rows = [names.index(name) for name in by]
            decoupled = [names[row] for row in rows if isolating[row] and other not in sensitive[row]]
            if other not in reach.faults and decoupled:
                found.append(Requirement(reach.case, other, decoupled))
    return found


def _wanted(
    found: list[Requirement], reached: Sequence[Reach], required: Sequence[tuple[str, str | None]]
) -> tuple[list[Requirement], list[str]]:
    """Those of `found` that are required, and what is required and not among them, in words."""
    if not required:
        return found, []
    faults = {reach.case: reach.faults for reach in reached}
    of = [((faults[one.case], one.other), one) for one in found]
    unmet = [
        f"{fault} isolated from {other}" if other else f"{fault} detected"
        for fault, other in required
        if ((fault,), other) not in [what for what, _ in of]
    ]
    return [one for what, one in of for fault, other in required if what == ((fault,), other)], unmet


def once(alarms: Mask, equal: Sequence[int]) -> Mask:
    """Alarms (N, T) in which generators of one signal alarm together."""
    merged = alarms.copy()
    for first in set(equal):
        group = [column for column, leader in enumerate(equal) if leader == first]
        merged[:, group] = alarms[:, group].any(axis=1, keepdims=True)
    return merged


def _mask(rows: Sequence[int]) -> int:
    return sum(1 << row for row in rows)


def _false(alarms: Mask, sets: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """How many blocks each of the sets alarms in."""
    patterns, counts = np.unique(alarms, axis=0, return_counts=True)
    total = np.zeros(len(sets), dtype=np.int64)
    for pattern, count in zip(patterns, counts, strict=True):
        total += count * ((sets & _mask(np.flatnonzero(pattern).tolist())) != 0)
    return total


def _cost(states: Sequence[int], sets: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    total = np.zeros(len(sets), dtype=np.int64)
    for row, count in enumerate(states):
        total += (count + 1) * (sets >> row & 1)
    return total

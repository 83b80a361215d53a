"""Practical isolability: which faults stand together at rank 1, at which size; found on one half of the vehicles.

Theory says which faults no test can tell apart; what sizes, noise and a drive's length add to that is measured here. A
practical mate of a fault is another that stood beside it in at least `OFTEN` of the recordings of one half in which the
fault itself was in the diagnosis, and in `LEAST` of them. It is used on the other half alone, so that no recording
excuses itself.
"""

from collections import Counter
from collections.abc import Mapping, Sequence

from diagnosis_judged import Judged

OFTEN = 0.2
LEAST = 2
"""Recordings: what stood beside a fault once is chance."""

Cell = tuple[str, str]
"""A fault and its size in words."""


def half(vehicle: int) -> int:
    """Which half a vehicle belongs to."""
    return vehicle % 2


def beside(told: Sequence[Judged]) -> dict[Cell, tuple[int, Counter[str]]]:
    """By fault and size: in how many recordings it was in the diagnosis, and how often each other one beside it."""
    found: dict[Cell, tuple[int, Counter[str]]] = {}
    for one in told:
        if one.kind == "single" and one.holds():
            [fault] = one.faults
            count, others = found.get((fault, one.label), (0, Counter()))
            others.update(name for name in one.first() if name != fault)
            found[fault, one.label] = count + 1, others
    return found


def mates(told: Sequence[Judged]) -> dict[Cell, frozenset[str]]:
    """The practical mates by fault and size."""
    return {
        cell: frozenset(name for name, times in others.items() if times >= max(LEAST, OFTEN * count))
        for cell, (count, others) in beside(told).items()
    }


def excused(told: Sequence[Judged]) -> Mapping[int, Mapping[Cell, frozenset[str]]]:
    """For each half the mates that the other half found."""
    return {side: mates([one for one in told if half(one.vehicle) != side]) for side in (0, 1)}


def narrow(one: Judged, of_others: Mapping[int, Mapping[Cell, frozenset[str]]]) -> bool:
    """Whether the true fault is in the diagnosis, alone or only with practical mates of its own."""
    [fault] = one.faults
    allowed = of_others[half(one.vehicle)].get((fault, one.label), frozenset())
    return one.holds() and set(one.first()) <= {fault, *allowed}


def in_words(of_others: Mapping[int, Mapping[Cell, frozenset[str]]], label: str, apart: Sequence[str] = ()) -> str:
    """The mates of a size, of both halves together, without faults `apart`: "fA_t with fA_p, fq_pump; ..."."""
    both: dict[str, set[str]] = {}
    for found in of_others.values():
        for (fault, size), names in found.items():
            if size == label and names and fault not in apart:
                both.setdefault(fault, set()).update(names)
    return "; ".join(f"{fault} with {', '.join(sorted(names))}" for fault, names in sorted(both.items())) or "none"

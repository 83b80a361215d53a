"""From alarmed tests to explanations: conflicts and their minimal hitting sets (Reiter 1987; de Kleer, Williams 1987).

An alarmed test is a conflict: at least one of the faults it is sensitive to is there. A diagnosis hits every conflict.
Silence exonerates nobody.
"""

from collections.abc import Sequence
from itertools import combinations

UNKNOWN: tuple[str, ...] = ()
"""The explanation when no set of at most `MAXIMUM_FAULTS` known faults hits every conflict: no name at all."""

MAXIMUM_FAULTS = 2


def diagnoses(conflicts: Sequence[frozenset[str]]) -> list[tuple[str, ...]]:
    """The minimal hitting sets of fewest faults, names sorted: single faults, else pairs, else unknown.

    >>> diagnoses([frozenset({"fA", "fB"}), frozenset({"fB", "fC"})])
    [('fB',)]
    >>> diagnoses([frozenset({"fA"}), frozenset({"fB", "fC"})])
    [('fA', 'fB'), ('fA', 'fC')]
    >>> diagnoses([])
    []
    """
    if not conflicts:
        return []
    faults = sorted(frozenset().union(*conflicts))
    for size in range(1, MAXIMUM_FAULTS + 1):
        hitting = [chosen for chosen in combinations(faults, size) if all(c.intersection(chosen) for c in conflicts)]
        if hitting:
            return hitting
    return [UNKNOWN]

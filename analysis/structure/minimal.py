"""Minimal over-determined sets of rows, by removing one equivalence class after the other.

Two rows of an over-determined set M are equivalent if removing one takes the other out of M+ too. A class acts as one
row and is lumped into one; removing classes in order, and never one that an earlier branch has removed, gives every
minimal set exactly once (Krysander, Aslund and Nyberg 2008).

The minimal test equation supports (Krysander, Aslund and Frisk 2010) are the same search when only rows with a fault
may be removed: the rest stays and its redundancy is not counted. With every row removable, they are the MSO sets.
"""

from collections.abc import Iterator, Sequence

from analysis.structure.matching import Matching, bits, mask_of

Group = tuple[int, int]
"""A lumped class: its rows, and the unknowns that it shares with other classes."""


def minimal_sets(rows: Sequence[int], removable: int) -> Iterator[int]:
    """Sets of rows, in the order of the search, which prefers to keep later rows.

    A set is over-determined, and removing any of its `removable` rows leaves none of these over-determined.
    """
    fixed = [row for i, row in enumerate(rows) if not removable >> i & 1]
    surplus = _redundancy(rows, Matching(rows).over_determined())
    surplus -= _redundancy(fixed, Matching(fixed).over_determined())
    groups = [(1 << i, rows[i]) for i in Matching(rows).over_determined()]
    return _search(groups, removable, removable, surplus)


def _redundancy(rows: Sequence[int], chosen: Sequence[int]) -> int:
    """Rows minus unknowns of the chosen rows, an over-determined part."""
    unknowns = 0
    for row in chosen:
        unknowns |= rows[row]
    return len(chosen) - unknowns.bit_count()


def _search(groups: list[Group], removable: int, allowed: int, surplus: int) -> Iterator[int]:
    if surplus < 1:
        return
    if surplus == 1:
        yield mask_of([row for mask, _ in groups for row in bits(mask)])
        return
    lumped = _lump(groups)
    candidates = [group for group in lumped if group[0] & removable and not group[0] & removable & ~allowed]
    allowed = 0
    for mask, _ in candidates:
        allowed |= mask & removable
    for group in candidates:
        allowed &= ~group[0]
        yield from _search([other for other in lumped if other is not group], removable, allowed, surplus - 1)


def _lump(groups: list[Group]) -> list[Group]:
    """The equivalence classes of an over-determined set, each as one group, in the order of their first rows."""
    unknowns = [group[1] for group in groups]
    matching = Matching(unknowns)
    everything = left = (1 << len(groups)) - 1
    lumped: list[Group] = []
    while left:
        first = (left & -left).bit_length() - 1
        remaining = matching.over_determined_without(first)
        inside = everything & ~mask_of(remaining)
        left &= ~inside
        shared = rows = within = 0
        for i in remaining:
            shared |= unknowns[i]
        for i in bits(inside):
            rows |= groups[i][0]
            within |= unknowns[i]
        lumped.append((rows, within & shared))
    return lumped

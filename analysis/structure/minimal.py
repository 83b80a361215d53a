"""Minimal over-determined sets of rows, by removing one equivalence class after the other.

Two rows of an over-determined set M are equivalent if removing one takes the other out of M+ too. Removing classes in
order, and never one that an earlier branch has removed, gives every minimal set exactly once (Krysander, Aslund and
Nyberg 2008). The minimal test equation supports (Krysander, Aslund and Frisk 2010) are the same search when only rows
with a fault may be removed: the rest stays and its redundancy is not counted. With every row removable, they are the
MSO sets.

How the classes are found is our own. Rows get vectors in the null space of a generic matrix (`generic.py`); there,
equivalent rows are parallel, and what is left when a class is removed is seen by projecting along it. So a whole level
of the search is a few array operations.

The result is exact although the numbers are random, because it is checked. If they happen to cancel somewhere, some
linearly closed set of removed rows is larger than the structure has it; then what remains has too little redundancy,
which is a count of rows and unknowns. Every set that the search misses lies in such a larger one
(docs/decisions/005-structural-engine.md has the proof). When a set fails the count, other numbers are drawn.
"""

import functools
import itertools
import operator
from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from faultline.analysis.structure.generic import Field, UnluckyNumbersError, difference, inverses, null_vectors, product
from faultline.analysis.structure.matching import Matching, bits

Flags = NDArray[np.bool_]

_AT_ONCE = 1 << 15
"""Numbers that are worked on at once: what fits the cache."""


def minimal_sets(rows: Sequence[int], removable: Collection[int], most: int | None = None) -> Flags:
    """Sets of rows, (sets, rows), in the order of the search, which prefers to keep later removable rows.

    A set is over-determined, and removing any of its `removable` rows leaves none of these over-determined.

    Args:
        rows: bit x of a row is set where unknown x occurs in it.
        removable: the numbers of these rows.
        most: the search ends with so many sets; there may be more.
    """
    matching = Matching(rows)
    over = matching.over_determined()
    fixed = [row for i, row in enumerate(rows) if i not in removable]
    uncounted = len(Matching(fixed).free)
    removals = len(matching.free) - uncounted - 1
    if removals < 0:
        return np.zeros((0, len(rows)), dtype=np.bool_)
    sets = np.zeros((len(rows), 1), dtype=np.bool_)
    sets[over] = True
    if removals > 0:
        may_go = np.array([i in removable for i in over])
        found = _exact([rows[i] for i in over], may_go, removals, uncounted + 1, most)
        sets = np.zeros((len(rows), found.shape[1]), dtype=np.bool_)
        sets[over] = found
    return np.ascontiguousarray(sets.T[:most])


def _exact(rows: Sequence[int], removable: Flags, removals: int, surplus: int, most: int | None) -> Flags:
    """The sets of this surplus, (rows, sets), after so many removals of a class from an over-determined part."""
    for seed in itertools.count():
        try:
            sets = _search(null_vectors(rows, seed), removable, removals, most)
        except UnluckyNumbersError:
            continue
        if np.all(sets.sum(axis=0) - _unknowns(rows, sets) == surplus):
            return sets
    raise AssertionError("there is always another seed")


def _unknowns(rows: Sequence[int], sets: Flags) -> NDArray[np.int_]:
    """How many unknowns are in every set, (sets,)."""
    every = list(bits(functools.reduce(operator.or_, rows)))
    if not every:
        return np.zeros(sets.shape[1], dtype=np.int_)
    holders = [[i for i, row in enumerate(rows) if row >> x & 1] for x in every]
    starts = [0, *itertools.accumulate(map(len, holders[:-1]))]
    occurring = np.logical_or.reduceat(sets[[*itertools.chain(*holders)]], starts, axis=0)
    found: NDArray[np.int_] = occurring.sum(axis=0)
    return found


class _Nodes(NamedTuple):
    """A level of the search, or a part of it: nodes are sets of groups of rows.

    Group g of node n has the vector (1, points[0, n, g], points[1, n, g], ...), up to a factor, modulo the span of what
    was removed before. `alive` (nodes, groups) are the groups that are left, `allowed` (nodes, groups) those that no
    earlier branch has removed.
    """

    points: Field
    alive: Flags
    allowed: Flags


def _search(vectors: Field, removable: Flags, removals: int, most: int | None) -> Flags:
    """The first `most` sets found or some more, (rows, sets), for the rows' vectors, (coordinates, rows)."""
    whole = np.ones((1, vectors.shape[1]), dtype=np.bool_)
    order = np.argsort(~removable, kind="stable")  # classes come in the order of their first removable rows
    points = _affine(vectors[:, None, order], whole)
    # Equivalent rows stay so whatever is removed: from here on, the first of them acts for all.
    first = _first(points, whole)[0]
    groups, group = np.unique(first, return_inverse=True)
    may_go = np.zeros(len(groups), dtype=np.bool_)
    may_go[group[: np.count_nonzero(removable)]] = True
    whole = whole[:, groups]
    found, count = [whole[:0]], 0
    for sets in _removed(_Nodes(points[:, :, groups], whole, whole), may_go, removals):
        found.append(sets)
        count += len(sets)
        if most is not None and count >= most:
            break
    return np.concatenate(found).T[group[np.argsort(order)]]


def _removed(nodes: _Nodes, removable: Flags, removals: int) -> Iterator[Flags]:
    """What is left of the nodes after the removals, in order."""
    first = _first(nodes.points, nodes.alive)  # a class is known by its first group
    chosen = np.zeros(nodes.alive.shape, dtype=np.bool_)
    for groups, may_go in ((nodes.alive & removable, True), (nodes.alive & removable & ~nodes.allowed, False)):
        node, group = np.nonzero(groups)
        chosen[node, first[node, group]] = may_go
    later = np.cumsum(chosen[:, ::-1], axis=1)[:, ::-1]
    node, group = np.nonzero(chosen & (later >= removals))
    alive = nodes.alive[node] & (first[node] != group[:, None])
    if removals == 1:
        yield alive
        return
    allowed = (np.take_along_axis(chosen, first, axis=1) & nodes.alive)[node] & (first[node] > group[:, None])
    size = max(1, _AT_ONCE // (removals * len(removable)))
    for at in range(0, len(node), size):
        part = slice(at, at + size)
        points = _projected(nodes.points, node[part], group[part], alive[part])
        yield from _removed(_Nodes(points, alive[part], allowed[part]), removable, removals - 1)


def _affine(vectors: Field, alive: Flags) -> Field:
    """Vectors (coordinates, nodes, groups) as points: divided by their first coordinates, which are left out."""
    leading = vectors[0][alive]
    if not np.all(leading):
        raise UnluckyNumbersError
    scale = np.zeros(alive.shape, dtype=np.uint64)
    scale[alive] = inverses(leading)
    return product(vectors[1:], scale)


def _projected(points: Field, node: NDArray[np.intp], group: NDArray[np.intp], alive: Flags) -> Field:
    """The points of each node seen from that of one group, (one coordinate less, pairs of these, groups)."""
    return _affine(difference(points[:, node], points[:, node, group][:, :, None]), alive)


def _first(points: Field, alive: Flags) -> NDArray[np.intp]:
    """The first group at the same point, (nodes, groups), by number; a group that is not alive is with itself only."""
    nowhere = np.arange(alive.shape[1], dtype=np.uint64) + np.uint64(1 << 32)
    # Whatever differs differs in the first coordinate already, but by accident.
    first = _first_of_equal(np.where(alive, points[0], nowhere))
    for coordinate in points[1:]:
        there = np.where(alive, coordinate, nowhere)
        if not np.array_equal(there, np.take_along_axis(there, first, axis=1)):
            _, labels = np.unique(there, return_inverse=True)
            first = _first_of_equal(first * there.size + labels.reshape(there.shape))
    return first


def _first_of_equal(keys: NDArray[np.generic]) -> NDArray[np.intp]:
    """For every entry the place of the first equal one in its row, (rows, entries)."""
    order = np.argsort(keys, axis=1, kind="stable")
    sorted_keys = np.take_along_axis(keys, order, axis=1)
    places = np.zeros(keys.shape, dtype=np.intp)
    places[:, 1:] = np.where(sorted_keys[:, 1:] != sorted_keys[:, :-1], np.arange(1, keys.shape[1]), 0)
    first = np.empty_like(order)
    np.put_along_axis(first, order, np.take_along_axis(order, np.maximum.accumulate(places, axis=1), axis=1), axis=1)
    return first

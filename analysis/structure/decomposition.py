"""The Dulmage-Mendelsohn decomposition: what is under-, just- and over-determined, and the fine structure of each.

Rows and columns can be ordered so that the structure is block triangular (Dulmage and Mendelsohn 1958):

    M-   fewer equations than unknowns: no unknown of it can be computed
    M0   as many: solved for component after component, the strongly connected ones (Hall components) together
    M+   more equations than unknowns: here are the tests

Two equations of M+ are equivalent if removing either takes the other out of M+ too (Krysander, Aslund and Nyberg 2008):
a test contains all equations of a class or none, so faults in one class are never isolable from each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import networkx as nx

from faultline.analysis.structure.matching import Matching, bits, mask_of, union
from faultline.analysis.structure.structure import Structure


@dataclass(frozen=True)
class Part:
    """Equations, the unknowns that belong to them, and the faults that enter them, each in the model's order."""

    equations: tuple[str, ...]
    unknowns: tuple[str, ...]
    faults: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Decomposition:
    """The parts of a structure.

    `under` is M-, `over` is M+. `just` are the Hall components of M0 in an order in which they can be solved, when the
    unknowns of M+ are known. `classes` are the equivalence classes of M+ in the order of their first equations, each
    with its private unknowns, those that no equation of another class contains; `shared` are the other unknowns of M+
    (X0 in the literature). `rank` is the structural rank, `redundancy` the surplus of equations in M+.
    """

    under: Part
    just: tuple[Part, ...]
    over: Part
    classes: tuple[Part, ...]
    shared: tuple[str, ...]
    rank: int
    redundancy: int


def dulmage_mendelsohn(structure: Structure) -> Decomposition:
    """The Dulmage-Mendelsohn decomposition of a structure.

    An unused unknown is in M- without an equation; an equation without unknowns is redundant by itself, a class of M+.
    """
    rows = structure.unknown_rows
    matching = Matching(rows)
    over = matching.over_determined()
    under = _under_determined(rows, matching, len(structure.unknowns))
    under_rows = [matching.owner[x] for x in bits(under) if x in matching.owner]
    over_unknowns = union(rows[row] for row in over)
    middle = sorted(set(range(len(rows))) - {*over, *under_rows})
    classes = structure.classes
    return Decomposition(
        under=_part(structure, under_rows, under),
        just=tuple(_part(structure, *component) for component in _hall_components(rows, middle, matching)),
        over=_part(structure, over, over_unknowns),
        classes=tuple(_part(structure, *found) for found in classes),
        shared=_unknowns(structure, over_unknowns & ~union(private for _, private in classes)),
        rank=matching.rank,
        redundancy=len(matching.free),
    )


def _under_determined(rows: Sequence[int], matching: Matching, width: int) -> int:
    """The unknowns of M-: what alternating paths from unmatched unknowns reach."""
    pairs = matching.pairs()
    queue = [x for x in range(width) if x not in matching.owner]
    seen = mask_of(queue)
    holders: dict[int, list[int]] = {}
    for row, mask in enumerate(rows):
        for x in bits(mask):
            holders.setdefault(x, []).append(row)
    for x in queue:  # grows
        for row in holders.get(x, ()):
            if not seen >> pairs[row] & 1:
                seen |= 1 << pairs[row]
                queue.append(pairs[row])
    return seen


def _hall_components(rows: Sequence[int], middle: Sequence[int], matching: Matching) -> list[tuple[list[int], int]]:
    """The strongly connected components of M0 as (rows, unknowns); of those that are ready, the first row's is next."""
    pairs = matching.pairs()
    inside = mask_of([pairs[row] for row in middle])
    graph = nx.DiGraph()
    graph.add_nodes_from(middle)
    graph.add_edges_from((matching.owner[x], row) for row in middle for x in bits(rows[row] & inside))
    condensed = nx.condensation(graph)
    members = {node: sorted(condensed.nodes[node]["members"]) for node in condensed}
    order = nx.lexicographical_topological_sort(condensed, key=lambda node: members[node])
    return [(members[node], mask_of([pairs[row] for row in members[node]])) for node in order]


def _part(structure: Structure, rows: Sequence[int], unknowns: int) -> Part:
    equations = structure.names(mask_of(rows))
    return Part(equations, _unknowns(structure, unknowns), structure.faults_in(equations))


def _unknowns(structure: Structure, mask: int) -> tuple[str, ...]:
    return tuple(structure.unknowns[x] for x in bits(mask))

"""Causality: in which direction the differential constraints of a test are used when one equation is its residual.

Without the residual equation a minimal over-determined set is just-determined; its strongly connected components are
solved one after the other. A differential constraint is used *integral* where its state follows from its derivative,
*derivative* where it is the other way round. A component of several equations is integral if they can be solved for
everything but the states; otherwise it needs a differentiated variable within a loop (Frisk et al. 2012). As residual,
a differential constraint compares its state with the integral of its derivative.

Whether all are integral is a question of matchings, so all residuals of a set are answered by one of them; the same for
derivative, where the components matter besides.
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import networkx as nx

from faultline.analysis.structure.matching import Matching, bits, mask_of, transposed, union
from faultline.analysis.structure.structure import Constraint, Structure

Causality = Literal["algebraic", "integral", "derivative", "mixed"]


def residual_causality(structure: Structure, equations: Sequence[str]) -> Mapping[str, Causality]:
    """The causality of an MSO set with each of its equations as the residual, by equation."""
    rows = structure.rows(equations)
    algebraic, constraints = _divided(structure, rows)
    if not constraints:
        return dict.fromkeys((structure.equations[row] for row in rows), "algebraic")
    found: dict[int, Causality] = dict.fromkeys(rows, "mixed")
    found |= dict.fromkeys(_integral(structure, algebraic, constraints), "integral")
    found |= dict.fromkeys(_derivative(structure, algebraic, constraints), "derivative")
    return {structure.equations[row]: found[row] for row in rows}


class IntegralCausality:
    """Which equations of one MSO set after the other can be its residual without any differentiation.

    Where none can, some unknowns are in too few algebraic equations of the set (Hall 1935). They are kept: the next
    set often has no more of those equations either, which is seen without a matching.
    """

    def __init__(self, structure: Structure) -> None:
        self._structure = structure
        self._algebraic = mask_of([row for row in range(len(structure.equations)) if row not in structure.constraints])
        self._holders = transposed(structure.unknown_rows, self._algebraic, len(structure.unknowns))
        self._scarce: list[tuple[int, int]] = []  # unknowns, and all algebraic rows with one of them

    def residuals(self, rows: Sequence[int]) -> list[int]:
        """The algebraic rows of an MSO set that can be its residual."""
        algebraic, constraints = _divided(self._structure, rows)
        there, states = mask_of(algebraic), mask_of([c.state for c in constraints])
        unknowns = union(self._structure.unknown_rows[row] for row in rows) & ~states
        for place, (few, holders) in enumerate(self._scarce):
            if not few & ~unknowns and (holders & there).bit_count() < few.bit_count():
                self._scarce.insert(0, self._scarce.pop(place))  # what hinders this set may well hinder the next
                return []
        matching = Matching([self._structure.unknown_rows[row] & ~states for row in algebraic])
        if matching.rank == unknowns.bit_count():
            return [algebraic[i] for i in matching.over_determined()]
        few = 1 << next(x for x in bits(unknowns) if x not in matching.owner)
        mates = {algebraic[i]: x for i, x in matching.pairs().items()}
        queue = [*bits(few)]
        for x in queue:  # grows
            new = mask_of([mates[row] for row in bits(self._holders[x] & there)]) & ~few
            few |= new
            queue.extend(bits(new))
        self._scarce.insert(0, (few, union(self._holders[x] for x in queue)))
        return []


def solving_order(structure: Structure, equations: Sequence[str], residual: str) -> list[list[tuple[str, str]]]:
    """How to compute a test with integral causality: (equation, variable) in components that are solved together.

    The differential constraints and the residual equation are left out, states count as given. A component uses known
    signals, states and variables of earlier components. Among those that are ready, the one with the first row is next.
    """
    rows = [row for row in structure.rows(equations) if structure.equations[row] != residual]
    rows = [row for row in rows if structure.equations[row] not in structure.differentials]
    states = mask_of(
        [structure.constraints[row].state for row in structure.rows(equations) if row in structure.constraints]
    )
    masks = [structure.unknown_rows[row] & ~states for row in rows]
    matching = Matching(masks)
    components = _components(masks, matching)
    pairs = matching.pairs()
    return [
        [(structure.equations[rows[i]], structure.unknowns[pairs[i]]) for i in component] for component in components
    ]


def _divided(structure: Structure, rows: Sequence[int]) -> tuple[list[int], list[Constraint]]:
    """The algebraic rows and the differential constraints."""
    of = structure.constraints
    return [row for row in rows if row not in of], [of[row] for row in rows if row in of]


def _integral(structure: Structure, algebraic: Sequence[int], constraints: Sequence[Constraint]) -> list[int]:
    """The rows of an MSO set that can be its residual when every state is integrated.

    The other algebraic equations must determine every unknown but the states. If they can at all, the residual is one
    of their over-determined part with the states given, or the constraint of a state that this part would determine.
    """
    states = mask_of([c.state for c in constraints])
    matching = Matching([structure.unknown_rows[row] & ~states for row in algebraic])
    if len(matching.free) != 1:
        return []
    part = [algebraic[i] for i in matching.over_determined()]
    return part + [c.row for c in constraints if any(structure.unknown_rows[row] >> c.state & 1 for row in part)]


def _derivative(structure: Structure, algebraic: Sequence[int], constraints: Sequence[Constraint]) -> list[int]:
    """The rows of an MSO set that can be its residual when every derivative follows from its state.

    With the derivatives given, the other algebraic equations must determine every unknown; the residual is one of their
    over-determined part then. And no derivative may be needed for its own state: no constraint is on a cycle of what
    needs what. One on a cycle can be solved for its state instead, as it can with every residual that a matching in
    which it is leaves out. If none is on a cycle, the residuals are the equations that no constraint needs: leaving out
    another one turns the matching on the way to it round, so that a constraint gives its state.
    """
    derivatives = mask_of([c.derivative for c in constraints])
    matching = Matching([structure.unknown_rows[row] & ~derivatives for row in algebraic])
    if len(matching.free) != 1:
        return []
    left = [algebraic[i] for i in matching.over_determined()]
    while left:
        needs = nx.DiGraph()
        solved = {c.derivative: c.row for c in constraints}
        solved |= {x: algebraic[i] for x, i in matching.owners_without(algebraic.index(left[0])).items()}
        for row in (*algebraic, *(c.row for c in constraints)):
            needs.add_edges_from((row, solved[x]) for x in bits(structure.unknown_rows[row]) if solved[x] != row)
        cycles = (component for component in nx.strongly_connected_components(needs) if len(component) > 1)
        looped = next((c for component in cycles for c in constraints if c.row in component), None)
        if looped is None:
            needs.add_edges_from(("all", c.row) for c in constraints)
            return sorted(set(left) - nx.descendants(needs, "all"))
        left = sorted(set(left) - set(_solved_for_state(structure, algebraic, constraints, looped)))
    return []


def _solved_for_state(
    structure: Structure, algebraic: Sequence[int], constraints: Sequence[Constraint], constraint: Constraint
) -> list[int]:
    """The rows of an MSO set that a matching of all unknowns can leave out that gives this constraint its state."""
    rows = [*algebraic, *(c.row for c in constraints if c != constraint)]
    matching = Matching([structure.unknown_rows[row] & ~(1 << constraint.state) for row in rows])
    return [rows[i] for i in matching.over_determined()]


def _components(masks: Sequence[int], matching: Matching) -> list[list[int]]:
    """Strongly connected components of just-determined rows, in an order in which they can be solved."""
    graph = nx.DiGraph()
    graph.add_nodes_from(range(len(masks)))
    graph.add_edges_from((matching.owner[x], i) for i, mask in enumerate(masks) for x in bits(mask))
    condensed = nx.condensation(graph)
    members = {node: sorted(condensed.nodes[node]["members"]) for node in condensed}
    return [members[node] for node in nx.lexicographical_topological_sort(condensed, key=lambda node: members[node])]

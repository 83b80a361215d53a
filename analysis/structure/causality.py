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
from typing import Literal, NamedTuple

import networkx as nx

from faultline.analysis.structure.matching import Matching, bits, mask_of
from faultline.analysis.structure.structure import Structure

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


def integral_residuals(structure: Structure, equations: Sequence[str]) -> tuple[str, ...]:
    """The algebraic equations of an MSO set that can be its residual without any differentiation."""
    algebraic, constraints = _divided(structure, structure.rows(equations))
    found = set(_integral(structure, algebraic, constraints))
    return tuple(structure.equations[row] for row in algebraic if row in found)


def solving_order(structure: Structure, equations: Sequence[str], residual: str) -> list[list[tuple[str, str]]]:
    """How to compute a test with integral causality: (equation, variable) in components that are solved together.

    The differential constraints and the residual equation are left out, states count as given. A component uses known
    signals, states and variables of earlier components. Among those that are ready, the one with the first row is next.
    """
    rows = [row for row in structure.rows(equations) if structure.equations[row] != residual]
    rows = [row for row in rows if structure.equations[row] not in structure.differentials]
    states = mask_of([structure.unknowns.index(name) for name in structure.states_in(equations)])
    masks = [structure.unknown_rows[row] & ~states for row in rows]
    matching = Matching(masks)
    components = _components(masks, matching)
    pairs = matching.pairs()
    return [
        [(structure.equations[rows[i]], structure.unknowns[pairs[i]]) for i in component] for component in components
    ]


class Constraint(NamedTuple):
    """A differential constraint: its row, and the unknowns that are its state and its derivative, all by number."""

    row: int
    state: int
    derivative: int


def _divided(structure: Structure, rows: Sequence[int]) -> tuple[list[int], list[Constraint]]:
    """The algebraic rows and the differential constraints."""
    algebraic, constraints = [], []
    for row in rows:
        d = structure.differentials.get(structure.equations[row])
        if d is None:
            algebraic.append(row)
        else:
            state, derivative = structure.unknowns.index(d.state), structure.unknowns.index(d.derivative)
            constraints.append(Constraint(row, state, derivative))
    return algebraic, constraints


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
    over-determined part then. And no derivative may be needed for its own state.
    """
    derivatives = mask_of([c.derivative for c in constraints])
    matching = Matching([structure.unknown_rows[row] & ~derivatives for row in algebraic])
    if len(matching.free) != 1:
        return []
    users: dict[int, list[int]] = {}  # unknown -> places in `algebraic`
    for i, row in enumerate(algebraic):
        for x in bits(structure.unknown_rows[row]):
            users.setdefault(x, []).append(i)
    return [
        algebraic[i]
        for i in matching.over_determined()
        if _in_turn(users, {row: x for x, row in matching.owners_without(i).items()}, constraints)
    ]


def _in_turn(users: Mapping[int, list[int]], solved: Mapping[int, int], constraints: Sequence[Constraint]) -> bool:
    """Whether all states can be had one after the other, none from a derivative that is not there yet.

    `users` are the equations that an unknown is in, `solved` is what each equation is solved for.
    """
    left = list(constraints)
    while left:
        queue = [c.derivative for c in left]
        waiting = mask_of(queue)
        for x in queue:  # grows: what depends on a derivative that is not there yet
            for i in users.get(x, ()):
                following = solved.get(i)
                if following is not None and not waiting >> following & 1:
                    waiting |= 1 << following
                    queue.append(following)
        still = [c for c in left if waiting >> c.state & 1]
        if len(still) == len(left):
            return False
        left = still
    return True


def _components(masks: Sequence[int], matching: Matching) -> list[list[int]]:
    """Strongly connected components of just-determined rows, in an order in which they can be solved."""
    graph = nx.DiGraph()
    graph.add_nodes_from(range(len(masks)))
    graph.add_edges_from((matching.owner[x], i) for i, mask in enumerate(masks) for x in bits(mask))
    condensed = nx.condensation(graph)
    members = {node: sorted(condensed.nodes[node]["members"]) for node in condensed}
    return [members[node] for node in nx.lexicographical_topological_sort(condensed, key=lambda node: members[node])]

"""Causality: in which direction the differential constraints of a test are used when one equation is its residual.

Without the residual equation a minimal over-determined set is just-determined; its strongly connected components are
solved one after the other. A differential constraint is used *integral* where its state follows from its derivative,
*derivative* where it is the other way round. A component of several equations is integral if they can be solved for
everything but the states; otherwise it needs a differentiated variable within a loop (Frisk et al. 2012).
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import networkx as nx

from analysis.structure.matching import Matching, bits
from analysis.structure.structure import Structure

Causality = Literal["algebraic", "integral", "derivative", "mixed"]


def residual_causality(structure: Structure, equations: Sequence[str]) -> Mapping[str, Causality]:
    """The causality of an MSO set with each of its equations as the residual, by equation."""
    rows = structure.rows(equations)
    return {structure.equations[row]: _causality(structure, [r for r in rows if r != row], row) for row in rows}


def integral_residuals(structure: Structure, equations: Sequence[str]) -> tuple[str, ...]:
    """The algebraic equations of an MSO set that can be its residual without any differentiation.

    The other algebraic equations must then determine every unknown but the states: if they can at all, what may be left
    out is the over-determined part of the algebraic equations with the states given.
    """
    rows = structure.rows(equations)
    states = _states(structure, rows)
    algebraic = [row for row in rows if structure.equations[row] not in structure.differentials]
    matching = Matching([structure.unknown_rows[row] & ~states for row in algebraic])
    if len(matching.free) != 1:
        return ()
    return tuple(structure.equations[algebraic[i]] for i in matching.over_determined())


def solving_order(structure: Structure, equations: Sequence[str], residual: str) -> list[list[tuple[str, str]]]:
    """How to compute a test with integral causality: (equation, variable) in components that are solved together.

    The differential constraints and the residual equation are left out, states count as given. A component uses known
    signals, states and variables of earlier components. Among those that are ready, the one with the first row is next.
    """
    rows = [row for row in structure.rows(equations) if structure.equations[row] != residual]
    rows = [row for row in rows if structure.equations[row] not in structure.differentials]
    states = _states(structure, structure.rows(equations))
    masks = [structure.unknown_rows[row] & ~states for row in rows]
    matching = Matching(masks)
    components = _components(masks, matching)
    pairs = matching.pairs()
    return [
        [(structure.equations[rows[i]], structure.unknowns[pairs[i]]) for i in component] for component in components
    ]


def _causality(structure: Structure, rows: Sequence[int], residual: int) -> Causality:
    masks = [structure.unknown_rows[row] for row in rows]
    matching = Matching(masks)
    pairs = matching.pairs()
    found = {"integral"} if structure.equations[residual] in structure.differentials else set()
    for component in _components(masks, matching):
        for i in component:
            differential = structure.differentials.get(structure.equations[rows[i]])
            if differential is None:
                continue
            if len(component) == 1:
                found.add("integral" if structure.unknowns[pairs[i]] == differential.state else "derivative")
            else:
                inside = sum(1 << pairs[k] for k in component)
                found.add("integral" if _integral(structure, [rows[k] for k in component], inside) else "mixed")
    match sorted(found):
        case []:
            return "algebraic"
        case ["integral"]:
            return "integral"
        case ["derivative"]:
            return "derivative"
    return "mixed"


def _integral(structure: Structure, rows: Sequence[int], unknowns: int) -> bool:
    """Whether the algebraic rows determine all of `unknowns` but the states of these rows."""
    algebraic = [row for row in rows if structure.equations[row] not in structure.differentials]
    unknowns &= ~_states(structure, rows)
    return Matching([structure.unknown_rows[row] & unknowns for row in algebraic]).rank == len(algebraic)


def _states(structure: Structure, rows: Sequence[int]) -> int:
    names = {
        structure.differentials[n].state
        for n in map(structure.equations.__getitem__, rows)
        if n in structure.differentials
    }
    return sum(1 << x for x, name in enumerate(structure.unknowns) if name in names)


def _components(masks: Sequence[int], matching: Matching) -> list[list[int]]:
    """Strongly connected components of just-determined rows, in an order in which they can be solved."""
    graph = nx.DiGraph()
    graph.add_nodes_from(range(len(masks)))
    graph.add_edges_from((matching.owner[x], i) for i, mask in enumerate(masks) for x in bits(mask))
    condensed = nx.condensation(graph)
    members = {node: sorted(condensed.nodes[node]["members"]) for node in condensed}
    return [members[node] for node in nx.lexicographical_topological_sort(condensed, key=lambda node: members[node])]

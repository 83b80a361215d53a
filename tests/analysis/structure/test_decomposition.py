"""The Dulmage-Mendelsohn decomposition: the thesis's model, and random structures against the definitions."""

import itertools
from collections.abc import Sequence

import networkx as nx
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import structural_rank

from faultline.analysis.model import load_model
from faultline.analysis.structure import Structure, mso_sets, structure_of
from faultline.analysis.structure.decomposition import Decomposition, dulmage_mendelsohn
from faultline.analysis.structure.matrix import structural_model

STEADY = settings(derandomize=True, deadline=None, max_examples=150)


@st.composite
def structures(draw: st.DrawFn) -> Structure:
    """Up to seven equations in up to five unknowns; empty equations and unused unknowns occur."""
    unknowns = [f"x{k}" for k in range(draw(st.integers(0, 5)))]
    subsets = st.lists(st.sampled_from(unknowns), unique=True, max_size=3) if unknowns else st.just([])
    rows = draw(st.lists(subsets, min_size=1, max_size=7))
    return structural_model({f"e{k}": row for k, row in enumerate(rows)}, unknowns=unknowns)


def rank(structure: Structure, equations: Sequence[str], unknowns: Sequence[str]) -> int:
    """The structural rank of the equations in the unknowns, by scipy."""
    if not equations or not unknowns:
        return 0
    matrix = [[x in structure.unknowns_in([e]) for x in unknowns] for e in equations]
    return int(structural_rank(csr_matrix(np.array(matrix, dtype=np.int8))))


def over_determined(structure: Structure, equations: Sequence[str]) -> set[str]:
    """Equations that some maximum matching leaves out: without one of them the rank stays."""
    whole = rank(structure, equations, structure.unknowns)
    return {e for e in equations if rank(structure, [o for o in equations if o != e], structure.unknowns) == whole}


def just_equations(parts: Decomposition) -> list[str]:
    return [name for component in parts.just for name in component.equations]


@STEADY
@given(structures())
def test_the_parts_are_what_maximum_matchings_leave_out(structure: Structure) -> None:
    parts = dulmage_mendelsohn(structure)
    equations, unknowns = structure.equations, structure.unknowns
    whole = rank(structure, equations, unknowns)
    missed = {x for x in unknowns if rank(structure, equations, [o for o in unknowns if o != x]) == whole}
    assert parts.rank == whole
    assert parts.redundancy == len(equations) - whole == len(parts.over.equations) - len(parts.over.unknowns)
    assert set(parts.over.equations) == over_determined(structure, equations)
    assert set(parts.over.unknowns) == set(structure.unknowns_in(parts.over.equations))
    assert set(parts.under.unknowns) == missed
    assert set(parts.under.equations) == {e for e in equations if missed & set(structure.unknowns_in([e]))}


@STEADY
@given(structures())
def test_every_equation_and_unknown_is_in_exactly_one_part(structure: Structure) -> None:
    parts = dulmage_mendelsohn(structure)
    pieces = [parts.under, *parts.just, parts.over]
    assert sorted(name for part in pieces for name in part.equations) == sorted(structure.equations)
    assert sorted(name for part in pieces for name in part.unknowns) == sorted(structure.unknowns)


@STEADY
@given(structures())
def test_the_components_can_be_solved_one_after_the_other_and_not_in_smaller_steps(structure: Structure) -> None:
    parts = dulmage_mendelsohn(structure)
    solved = set(parts.over.unknowns)
    for component in parts.just:
        size = rank(structure, component.equations, component.unknowns)
        assert len(component.equations) == len(component.unknowns) == size
        assert set(structure.unknowns_in(component.equations)) <= solved | set(component.unknowns)
        for fewer in range(1, size):
            for chosen in itertools.combinations(component.equations, fewer):
                assert len(set(structure.unknowns_in(chosen)) - solved) > fewer
        solved |= set(component.unknowns)


@STEADY
@given(structures())
def test_equations_are_in_one_class_if_removing_either_removes_both(structure: Structure) -> None:
    parts = dulmage_mendelsohn(structure)
    over = parts.over.equations
    without = {e: over_determined(structure, [o for o in over if o != e]) for e in over}
    expected = {frozenset(o for o in over if o == e or o not in without[e]) for e in over}
    assert {frozenset(found.equations) for found in parts.classes} == expected
    assert sum(len(found.equations) for found in parts.classes) == len(over)
    for found in parts.classes:
        others = set(structure.unknowns_in(e for e in over if e not in found.equations))
        assert set(found.unknowns) == set(structure.unknowns_in(found.equations)) - others
        assert len(found.equations) == len(found.unknowns) + 1
    private = {name for found in parts.classes for name in found.unknowns}
    assert set(parts.shared) == set(parts.over.unknowns) - private


@STEADY
@given(structures())
def test_an_mso_set_contains_whole_classes(structure: Structure) -> None:
    classes = [set(found.equations) for found in dulmage_mendelsohn(structure).classes]
    for equations in mso_sets(structure):
        assert all(found <= set(equations) or not found & set(equations) for found in classes)


@STEADY
@given(structures())
def test_networkx_finds_the_same_rank(structure: Structure) -> None:
    graph = nx.Graph()
    graph.add_nodes_from(structure.equations)
    graph.add_edges_from((e, x) for e in structure.equations for x in structure.unknowns_in([e]))
    matching = nx.bipartite.hopcroft_karp_matching(graph, top_nodes=structure.equations)
    assert dulmage_mendelsohn(structure).rank == len(matching) // 2


def test_the_fine_structure_of_the_four_state_model() -> None:
    parts = dulmage_mendelsohn(structure_of(load_model("uds")))
    assert (parts.under.equations, parts.under.unknowns, parts.just) == ((), (), ())
    assert (len(parts.over.equations), parts.rank, parts.redundancy) == (18, 15, 3)
    assert [(found.equations, set(found.unknowns)) for found in parts.classes] == [
        (("e01", "e02"), {"eta_volp"}),
        (("e03", "e04", "e11", "e15"), {"q_ori", "q_dos", "dp_du"}),
        (("e05", "e08", "e12"), {"q_filt_t", "dp_tp"}),
        (("e06",), set()),
        (("e07",), set()),
        (("e09", "e13"), {"dp_bp"}),
        (("e10", "e14"), {"dp_ap"}),
        (("e16",), set()),
        (("e17",), set()),
        (("e18",), set()),
    ]
    assert set(parts.shared) == {"q_pump", "q_filt_p", "q_filt_du", "p_tp", "p_bp", "p_ap", "p_du"}
    assert [found.faults for found in parts.classes if len(found.faults) > 1] == [("fA_ori", "fA_dos")]


def test_all_three_parts_at_once() -> None:
    parts = dulmage_mendelsohn(
        structural_model(
            {"sensor1": ["a"], "sensor2": ["a", "f"], "loop1": ["a", "b", "c"], "loop2": ["b", "c"], "open": ["d", "c"]}
            | {"after": ["d2", "b"], "few": ["g", "h", "d"], "check": []},
            faults=["f"],
            unknowns=["a", "b", "c", "d", "d2", "g", "h", "unused"],
        )
    )
    assert parts.over.equations == ("sensor1", "sensor2", "check")
    assert parts.over.faults == ("f",)
    assert [(found.equations, found.unknowns) for found in parts.classes] == [
        (("sensor1", "sensor2"), ("a",)),
        (("check",), ()),
    ]
    assert parts.shared == ()
    assert [(component.equations, component.unknowns) for component in parts.just] == [
        (("loop1", "loop2"), ("b", "c")),
        (("open",), ("d",)),
        (("after",), ("d2",)),
    ]
    assert (parts.under.equations, parts.under.unknowns) == (("few",), ("g", "h", "unused"))


def test_an_empty_over_determined_part_has_no_classes() -> None:
    """Regression against the peer tool, which crashed on an empty M+ with an unused unknown."""
    parts = dulmage_mendelsohn(structural_model({"e": ["x"]}, unknowns=["x", "y"]))
    assert (parts.classes, parts.over.equations, parts.redundancy) == ((), (), 0)
    assert (parts.under.equations, parts.under.unknowns) == ((), ("y",))
    assert [component.equations for component in parts.just] == [("e",)]

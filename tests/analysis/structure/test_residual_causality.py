"""Causality against the matching identity, and tests that cannot be run with the reason."""

from collections import Counter

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from made_models import air_path, induction_motor, tank_chain
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import structural_rank
from test_diagnosability import structures

from faultline.analysis.model import Differential, load_model, parse_model
from faultline.analysis.structure import Structure, Test, find_tests, integral_tests, mso_sets, structure_of
from faultline.analysis.structure.causality import IntegralCausality, residual_causality, solving_order
from faultline.analysis.structure.matching import mask_of


def random_structure(seed: int) -> Structure:
    """One to three states, some algebraic unknowns, random algebraic equations."""
    rng = np.random.default_rng(seed)
    states = [f"x{i}" for i in range(rng.integers(1, 4))]
    unknowns = [*states, *(f"d{s}" for s in states), *(f"a{i}" for i in range(rng.integers(0, 4)))]
    most = min(len(unknowns), 3)
    algebraic = [[*map(str, rng.choice(unknowns, rng.integers(1, most + 1), replace=False))] for _ in unknowns]
    contents = [*algebraic, *([s, f"d{s}"] for s in states)]
    names = [f"e{k}" for k in range(len(contents))]
    return Structure(
        equations=tuple(names),
        unknowns=tuple(unknowns),
        known=(),
        faults=(),
        unknown_rows=tuple(sum(1 << unknowns.index(name) for name in row) for row in contents),
        known_rows=(0,) * len(names),
        fault_rows={},
        differentials={
            n: Differential(name=n, state=s, derivative=f"d{s}")
            for n, s in zip(names[-len(states) :], states, strict=True)
        },
    )


def perfect(structure: Structure, equations: list[str], unknowns: list[str]) -> bool:
    """Whether the equations can be matched to the unknowns one to one, by scipy."""
    if len(equations) != len(unknowns):
        return False
    matrix = [[int(x in structure.unknowns_in([e])) for x in unknowns] for e in equations]
    return not equations or int(structural_rank(csr_matrix(np.array(matrix)))) == len(equations)


def test_a_residual_is_integral_exactly_if_the_rest_determines_all_but_the_states() -> None:
    seen = {True: 0, False: 0}
    for seed in range(150):
        structure = random_structure(seed)
        integral = IntegralCausality(structure)
        for mso in mso_sets(structure):
            states = structure.states_in(mso)
            algebraic = [e for e in mso if e not in structure.differentials]
            chosen = structure.names(mask_of(integral.residuals(structure.rows(mso))))
            for equation, causality in residual_causality(structure, mso).items():
                if equation in structure.differentials:
                    continue
                rest = [e for e in algebraic if e != equation]
                forward = perfect(structure, rest, [x for x in structure.unknowns_in(mso) if x not in states])
                assert (causality in ("integral", "algebraic")) == forward == (equation in chosen)
                assert (causality == "algebraic") == (not states)
                seen[forward] += 1
    assert min(seen.values()) > 100


def by_definition(structure: Structure, equations: tuple[str, ...], residual: str) -> str:
    """The causality of a residual, from the strongly connected components that the other equations are solved in."""
    rest = [e for e in equations if e != residual]
    graph = nx.Graph((e, ("unknown", x)) for e in rest for x in structure.unknowns_in([e]))
    pairs = nx.bipartite.maximum_matching(graph, rest)
    needs = nx.DiGraph((e, pairs["unknown", x]) for e in rest for x in structure.unknowns_in([e]))
    used = {"integral"} if residual in structure.differentials else set()
    for component in nx.strongly_connected_components(needs):
        inside = [structure.differentials[e] for e in component if e in structure.differentials]
        if len(component) == 1:
            used |= {"integral" if pairs[d.name] == ("unknown", d.state) else "derivative" for d in inside}
        elif inside:
            algebraic = [e for e in component if e not in structure.differentials]
            solved = [pairs[e][1] for e in component]
            states = {d.state for d in inside}
            forward = perfect(structure, algebraic, [x for x in solved if x not in states])
            used.add("integral" if forward else "mixed")
    return "algebraic" if not used else used.pop() if len(used) == 1 else "mixed"


@settings(derandomize=True, deadline=None, max_examples=200)
@given(structure=structures())
def test_causality_is_that_of_the_definition(structure: Structure) -> None:
    for mso in mso_sets(structure):
        assert residual_causality(structure, mso) == {e: by_definition(structure, mso, e) for e in mso}


def test_causality_of_denser_structures_is_that_of_the_definition() -> None:
    seen = Counter[str]()
    for seed in range(80):
        structure = random_structure(seed)
        for mso in mso_sets(structure):
            found = residual_causality(structure, mso)
            assert found == {e: by_definition(structure, mso, e) for e in mso}
            seen.update(found.values())
    assert min(seen[kind] for kind in ("algebraic", "integral", "derivative", "mixed")) > 100


@pytest.mark.parametrize("structure", [tank_chain(3), induction_motor(), air_path(4, ["speed", "p2"])])
def test_causality_of_systems_is_that_of_the_definition(structure: Structure) -> None:
    found = mso_sets(structure)
    for mso in found[:: max(1, len(found) // 5)]:
        assert residual_causality(structure, mso) == {e: by_definition(structure, mso, e) for e in mso}


HEAD = """
schema = 1
name = "made"
[known.y]
unit = "1"
min = 0.0
max = 1.0
noise = 0.1
[known.u]
unit = "1"
min = 0.0
max = 1.0
noise = 0.1
"""


def made(unknowns: str, equations: list[str], state: str | None = None) -> str:
    """A model file of equations e1 ..., the first with a fault on y or u."""
    text = HEAD
    for name in unknowns.split():
        text += f'[unknown.{name}]\nunit = "1"\n' + ("initial = ['y']\n" if name == state else "")
    for k, expr in enumerate(equations, start=1):
        text += f'[[equation]]\nname = "e{k}"\nexpr = "{expr}"\n'
    first = "y" if "y" in equations[0] else "u"
    fault = f'[equation.fault]\nname = "f"\ncomponent = "c"\nenters = "{first} -> {first} + f"\nsizes = [1.0]\n'
    text = text.replace(f'expr = "{equations[0]}"\n', f'expr = "{equations[0]}"\n{fault}', 1)
    if state is not None:
        text += f'[[differential]]\nname = "e{len(equations) + 1}"\nstate = "{state}"\nderivative = "d{state}"\n'
    return text


def test_an_algebraic_loop_is_refused_by_name() -> None:
    model = parse_model(made("x dx a b", ["y - x", "a + 2*b + x - u", "2*a + b - x", "dx - a"], state="x"), "made")
    (test,) = find_tests(model)
    assert integral_tests(model) == ()
    assert test.obstacle == "with residual e1, e2, e3 are an algebraic loop of a, b"


def test_a_loop_is_solved_as_one_component() -> None:
    model = parse_model(made("x dx a b", ["y - x", "a + 2*b + x - u", "2*a + b - x", "dx - a"], state="x"), "made")
    structure = structure_of(model)
    order = solving_order(structure, structure.equations, "e1")
    assert [sorted(e for e, _ in component) for component in order] == [["e2", "e3"], ["e4"]]


def test_a_test_without_states_is_static() -> None:
    model = parse_model(made("a", ["y - a", "a - 2*u"]), "made")
    (test,) = integral_tests(model)
    assert isinstance(test, Test)
    assert (test.states, test.residual, test.predicts, test.sequence) == ((), "e1", "y", (("e2", "a"),))


def test_a_residual_that_predicts_no_sensor_says_so() -> None:
    model = parse_model(made("a", ["y*u - a", "a - 2*y*u"]), "made")
    (test,) = find_tests(model)
    assert test.obstacle == "no sensor is predicted by e1, e2, which alone have integral causality"


def test_a_support_of_several_minimal_sets_runs_the_first_that_can() -> None:
    """Two fault-free sensors of the same variable: one support with redundancy two."""
    model = parse_model(made("a", ["u - a", "y - a", "y - 2*a"]), "made")
    (test,) = integral_tests(model)
    assert test.equations in (("e1", "e2"), ("e1", "e3"))
    assert test.faults == ("f",)


def test_among_the_ready_equations_the_first_row_comes_next() -> None:
    structure = structure_of(load_model("uds"))
    mso = ("e03", "e04", "e07", "e11", "e15", "e16", "e18")
    order = [pair for component in solving_order(structure, mso, "e16") for pair in component]
    assert [equation for equation, _ in order] == ["e03", "e04", "e18", "e07", "e11"]

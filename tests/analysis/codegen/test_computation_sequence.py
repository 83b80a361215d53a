"""In which order a residual is computed, and in which causality; against the causality that the structure demands."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultline.analysis.codegen import Component, computation_sequence
from faultline.analysis.model import Differential, load_model
from faultline.analysis.structure import Structure, mso_sets, mtes_sets, structure_of
from faultline.analysis.structure.causality import residual_causality
from faultline.service.core.errors import InputError


@st.composite
def structures(draw: st.DrawFn) -> Structure:
    """Random structures of up to three states: a differential constraint contains its state and derivative alone."""
    states, others = draw(st.integers(0, 3)), draw(st.integers(1, 4))
    unknowns = [f"x{k}" for k in range(states)] + [f"dx{k}" for k in range(states)] + [f"v{k}" for k in range(others)]
    algebraic = len(unknowns) - states + draw(st.integers(1, 2))
    masks = [draw(st.integers(1, 2 ** len(unknowns) - 1)) for _ in range(algebraic)]
    masks += [1 << k | 1 << (states + k) for k in range(states)]
    names = tuple(f"e{k}" for k in range(algebraic)) + tuple(f"c{k}" for k in range(states))
    return Structure(
        equations=names,
        unknowns=tuple(unknowns),
        known=("z",),
        faults=(),
        unknown_rows=tuple(masks),
        known_rows=tuple(1 for _ in masks),
        fault_rows={},
        differentials={f"c{k}": Differential(name=f"c{k}", state=f"x{k}", derivative=f"dx{k}") for k in range(states)},
    )


def check_order(structure: Structure, components: tuple[Component, ...], given_names: set[str]) -> set[str]:
    """Every component contains nothing but its own variables, the given ones and those of earlier components."""
    at_hand = set(given_names)
    for component in components:
        states = {structure.differentials[e].state for e in component.equations if e in structure.differentials}
        if component.inside:
            check_order(structure, component.inside, at_hand | states)
        at_hand |= set(component.variables)
        assert set(structure.unknowns_in(component.equations)) <= at_hand, component
    return at_hand


@settings(deadline=None)
@given(structures(), st.integers(0, 1000), st.integers(0, 1000))
def test_every_component_uses_only_what_was_solved_before_it(structure: Structure, which: int, residual: int) -> None:
    sets = mso_sets(structure)
    if not sets:
        return
    equations = sets[which % len(sets)]
    left_out = equations[residual % len(equations)]
    sequence = computation_sequence(structure, equations, left_out)
    solved = check_order(structure, sequence.components, set())
    assert solved == set(structure.unknowns_in(equations))
    used = sorted(e for component in sequence.components for e in component.equations)
    assert used == sorted(set(equations) - {left_out})
    assert sequence.causality == residual_causality(structure, equations)[left_out]


@pytest.mark.parametrize("name", ["uds", "uds/production", "rc", "three-tank"])
def test_the_causality_of_every_choice_is_the_structures(name: str) -> None:
    structure = structure_of(load_model(name))
    for equations in mtes_sets(structure):
        found = {e: computation_sequence(structure, equations, e).causality for e in equations}
        assert found == residual_causality(structure, equations)


def test_the_integral_sequence_of_test_2_advances_its_one_state_and_solves_the_rest_given_it() -> None:
    model = load_model("uds")
    equations = ("e03", "e04", "e07", "e11", "e15", "e16", "e18")
    [component] = computation_sequence(model, equations, "e16").components
    assert component.kind == "integral"
    assert component.pairs[0] == ("e15", "p_du")
    inside = [pair for inner in component.inside for pair in inner.pairs]
    assert inside == [("e03", "q_ori"), ("e04", "q_dos"), ("e18", "p_ap"), ("e07", "q_filt_du"), ("e11", "dp_du")]


def test_the_derivative_sequence_of_test_2_differentiates_the_measured_pressure() -> None:
    model = load_model("uds")
    equations = ("e03", "e04", "e07", "e11", "e15", "e16", "e18")
    sequence = computation_sequence(model, equations, "e18")
    kinds = {component.pairs: component.kind for component in sequence.components}
    assert kinds[(("e15", "dp_du"),)] == "derivative"
    assert sequence.components[-1].pairs == (("e07", "p_ap"),)


def test_what_is_no_mso_set_is_refused_by_name() -> None:
    model = load_model("uds")
    with pytest.raises(InputError, match="e16 are no minimal over-determined set"):
        computation_sequence(model, ["e15", "e16"], "e16")
    with pytest.raises(InputError, match="residual e01 is not among"):
        computation_sequence(model, ["e15", "e16"], "e01")
    with pytest.raises(InputError, match="e99 is no equation"):
        computation_sequence(model, ["e99"], "e99")

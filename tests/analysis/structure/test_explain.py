"""Explanations: every claim in them against its definition, and the words for the thesis's model."""

import itertools

import pytest
from hypothesis import given, settings
from test_diagnosability import INTERPRETATIONS, capable, made, structures

from faultline.analysis.model import ModelError, load_model
from faultline.analysis.structure import Structure, mso_sets, structure_of
from faultline.analysis.structure.diagnosability import Interpretation, detectability, isolability_of
from faultline.analysis.structure.explain import why
from faultline.analysis.structure.sensors import add_sensors, drop_sensors

UDS4 = structure_of(load_model("uds"))
STEADY = settings(derandomize=True, deadline=None, max_examples=60)


def isolable(structure: Structure, fault: str, other: str, causality: Interpretation) -> bool:
    return other not in isolability_of(structure, causality)[fault]


@pytest.mark.parametrize("causality", INTERPRETATIONS)
@STEADY
@given(structure=structures())
def test_every_claim_holds(causality: Interpretation, structure: Structure) -> None:
    tests = [{*mso} for mso in mso_sets(structure) if capable(structure, mso, causality)]
    for fault, other in itertools.permutations(structure.faults, 2):
        found = why(structure, fault, other, causality)
        equation, others = (structure.equations[structure.fault_rows[name]] for name in (fault, other))
        assert found.isolable == isolable(structure, fault, other, causality)
        assert fault in found.text
        assert other in found.text
        if found.isolable:
            assert {*found.test} in tests
            assert equation in found.test
            assert others not in found.test
            assert found.shared == found.sensors == found.causalities == ()
        else:
            assert found.test == ()
            seeing = [test for test in tests if equation in test]
            assert {*found.shared} == (set.intersection(*seeing) if seeing else set())
            derivatives = {d.derivative for d in structure.differentials.values()}
            assert found.sensors == tuple(
                u
                for u in structure.unknowns
                if u not in derivatives and isolable(add_sensors(structure, [u]), fault, other, causality)
            )
            assert found.causalities == tuple(c for c in INTERPRETATIONS if isolable(structure, fault, other, c))


@pytest.mark.parametrize("causality", INTERPRETATIONS)
def test_the_test_that_shows_it_sees_as_few_faults_as_any_within_them(causality: Interpretation) -> None:
    supports = [{*UDS4.faults_in(mso)} for mso in mso_sets(UDS4) if capable(UDS4, mso, causality)]
    shown = 0
    for fault, other in itertools.permutations(UDS4.faults, 2):
        found = why(UDS4, fault, other, causality)
        if found.isolable:
            sees = {*UDS4.faults_in(found.test)}
            assert not any(fault in support and support < sees for support in supports)
            shown += 1
    assert shown > 50


def test_equivalent_equations_are_named_with_the_sensors_that_split_them() -> None:
    found = why(UDS4, "fA_ori", "fA_dos", "mixed")
    assert found.shared == ("e03", "e04", "e11", "e15")
    assert found.sensors == ("q_ori", "q_dos")
    assert found.text == (
        "fA_ori is not isolable from fA_dos with mixed causality: every test contains e03, e04, e11 and e15 or none of "
        "these, and fA_ori enters e03, fA_dos e04. A sensor of q_ori or q_dos would separate them."
    )


def test_where_only_integration_hides_a_fault_another_causality_is_named() -> None:
    found = why(UDS4, "fA_t", "fA_p", "integral")
    assert found.causalities == ("mixed", "derivative")
    assert found.text == (
        "fA_t is not isolable from fA_p with integral causality: every test that contains e05, where fA_t enters, also "
        "contains e06, where fA_p enters (and e01, e02, e08, e09, e12 and e13). It is not so the other way round: fA_p "
        "is isolable from fA_t. A sensor of q_filt_t or q_filt_p would separate them. Mixed or "
        "derivative causality would."
    )


def test_an_isolable_pair_shows_its_test() -> None:
    found = why(UDS4, "fA_p", "fA_t", "integral")
    assert found.isolable
    assert found.text.startswith("fA_p is isolable from fA_t with integral causality: the test of e01, e02, e06, ")
    assert found.text.endswith("but not fA_t. It is not so the other way round: fA_t is not isolable from fA_p.")


def test_faults_in_one_equation_cannot_be_separated() -> None:
    structure = made([0b1, 0b1], ["a"], [], [0, 0])
    assert detectability(structure, "mixed") == ("f0", "f1")
    assert why(structure, "f0", "f1", "mixed").text == (
        "f0 is not isolable from f1 with mixed causality: both enter e0, so every test sees both or neither. "
        "Neither a sensor nor another causality can separate them; two equations instead of that one might."
    )


def test_a_fault_that_nothing_sees_has_its_reason() -> None:
    bare = drop_sensors(UDS4, ["y_p_tp", "y_p_ap", "y_p_du"])
    assert why(bare, "fA_t", "fA_p", "mixed").text == (
        "fA_t is not isolable from fA_p with mixed causality: no test sees fA_t, because e05 is outside of the "
        "over-determined part. No single sensor would help."
    )


def test_a_fault_that_only_differentiation_sees_has_its_reason() -> None:
    """x0 and x1 are measured and have the same unknown rate a: only their derivatives can be compared."""
    unknowns, constraints = ["x0", "x1", "dx0", "dx1", "a"], [("x0", "dx0"), ("x1", "dx1")]
    structure = made([0b00001, 0b00010, 0b10100, 0b11000], unknowns, constraints, [0, 2])
    assert why(structure, "f0", "f1", "integral").text == (
        "f0 is not isolable from f1 with integral causality: no test of this causality sees f0, because none contains "
        "e0. A sensor of x0 would separate them. No other causality would."
    )


def test_a_long_list_is_cut() -> None:
    bare = drop_sensors(UDS4, ["y_p_tp", "y_p_ap"])
    assert "e12 and 4 more or none of these" in why(bare, "fA_t", "fA_p", "mixed").text


def test_names_that_are_no_faults_are_refused() -> None:
    with pytest.raises(ModelError, match=r"^f: no fault of the model; those are .*fA_ori"):
        why(UDS4, "fA_ori", "f", "mixed")
    with pytest.raises(ModelError, match=r"^fA_ori: no fault is isolable from itself; name two$"):
        why(UDS4, "fA_ori", "fA_ori", "mixed")

"""The thesis's model against facts found with another tool, sets in the thesis's numbering."""

import dataclasses
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from faultline.analysis.model import Model, load_model
from faultline.analysis.structure import (
    Test,
    arguments,
    detectable,
    find_tests,
    integral_tests,
    isolability,
    mso_sets,
    mtes_sets,
    over_determined,
    redundancy,
    signature_matrix,
    structure_of,
)
from faultline.analysis.structure.causality import residual_causality

ORACLE: dict[str, Any] = json.loads((Path(__file__).parent / "uds_oracle.json").read_text())
UDS4 = load_model("uds")
STRUCTURE = structure_of(UDS4)
RUNNABLE = [2, 6, 8, 9, 10, 12, 13, 19, 20, 21]


def as_sets(relation: dict[str, Iterable[str]]) -> dict[str, set[str]]:
    return {fault: set(others) for fault, others in relation.items()}


def with_sensors(signals: set[str]) -> Model:
    """The model without the pressure sensors that are not among `signals`."""
    sensors = {"e16": "y_p_du", "e17": "y_p_tp", "e18": "y_p_ap"}
    kept = {name: e for name, e in UDS4.equations.items() if sensors.get(name, "y_p_du") in signals}
    return dataclasses.replace(UDS4, equations=kept)


def test_every_equation_contains_the_unknowns_of_the_oracle() -> None:
    assert list(STRUCTURE.equations) == ORACLE["equations"]
    assert set(STRUCTURE.unknowns) == set(ORACLE["unknowns"])
    assert set(STRUCTURE.faults) == set(ORACLE["faults"])
    found = {name: set(STRUCTURE.unknowns_in([name])) for name in STRUCTURE.equations}
    assert found == as_sets(ORACLE["structure"])


def test_everything_is_over_determined_with_redundancy_three() -> None:
    assert list(over_determined(STRUCTURE)) == ORACLE["over_determined"]
    assert redundancy(STRUCTURE, over_determined(STRUCTURE)) == 3


def test_the_26_mso_sets_come_in_the_known_order() -> None:
    assert [list(s) for s in mso_sets(STRUCTURE)] == ORACLE["mso"]
    assert len(ORACLE["mso"]) == 26


def test_the_21_tests_have_the_thesis_numbers() -> None:
    assert [list(s) for s in mtes_sets(STRUCTURE)] == [t["equations"] for t in ORACLE["mtes"]]
    assert [t.number for t in find_tests(UDS4)] == list(range(1, 22))
    assert [t.number for t in integral_tests(UDS4)] == RUNNABLE
    assert [t.name for t in integral_tests(UDS4)][:2] == ["t02", "t06"]


@pytest.mark.parametrize("expected", ORACLE["mtes"], ids=lambda t: f"t{t['number']:02d}")
def test_a_test_has_its_faults_signals_and_causality(expected: dict[str, Any]) -> None:
    test = find_tests(UDS4)[expected["number"] - 1]
    assert set(test.faults) == set(expected["faults"])
    assert set(test.known) == set(expected["known"])
    causality = residual_causality(STRUCTURE, test.equations)
    assert causality == expected["causality"]
    assert [e for e, c in causality.items() if c == "integral"] == expected["integral_residuals"]
    assert isinstance(test, Test) == bool(expected["integral_residuals"])
    assert test.obstacle == (None if isinstance(test, Test) else "no residual equation has integral causality")


@pytest.mark.parametrize(("equations", "expected"), [*zip(ORACLE["mso"], ORACLE["mso_causality"], strict=True)])
def test_every_residual_choice_of_every_mso_set_has_its_causality(
    equations: list[str], expected: dict[str, str]
) -> None:
    assert residual_causality(STRUCTURE, equations) == expected


@pytest.mark.parametrize("expected", [t for t in ORACLE["mtes"] if "g" in t], ids=lambda t: f"t{t['number']:02d}")
def test_a_runnable_test_has_its_residual_states_and_arguments(expected: dict[str, Any]) -> None:
    test = find_tests(UDS4)[expected["number"] - 1]
    assert isinstance(test, Test)
    assert test.residual == expected["residual"]
    assert test.predicts == ORACLE["predicts"][str(test.number)]
    assert set(test.states) == set(expected["states"])
    found = arguments(UDS4, test)
    assert {s: set(a.states) for s, a in found.rates.items()} == {s: set(a["states"]) for s, a in expected["g"].items()}
    assert {s: set(a.known) for s, a in found.rates.items()} == {s: set(a["known"]) for s, a in expected["g"].items()}
    assert list(found.output.states) == expected["h"]
    assert found.output.known == ()


@pytest.mark.parametrize("test", integral_tests(UDS4), ids=lambda t: t.name)
def test_the_sequence_needs_only_what_is_there(test: Test) -> None:
    there = {*test.known, *test.states}
    for equation, variable in test.sequence:
        assert variable not in there
        needed = {s.name for s in UDS4.expression(equation, with_fault=False).free_symbols}
        assert variable in needed
        assert needed - {variable} - set(UDS4.parameters) <= there
        there.add(variable)
    left = {d.name for d in UDS4.differentials} | {test.residual}
    assert {e for e, _ in test.sequence} == set(test.equations) - left
    assert {d.derivative for d in UDS4.differentials if d.state in test.states} <= there


def test_test_2_is_the_one_of_figure_5_7() -> None:
    test = integral_tests(UDS4)[0]
    assert test.equations == ("e03", "e04", "e07", "e11", "e15", "e16", "e18")
    assert dict(test.sequence) == {
        "e18": "p_ap",
        "e07": "q_filt_du",
        "e04": "q_dos",
        "e03": "q_ori",
        "e11": "dp_du",
    }


@pytest.mark.parametrize(("causality", "tests"), [("mixed", find_tests(UDS4)), ("integral", integral_tests(UDS4))])
def test_isolability_is_that_of_figure_5_5(causality: str, tests: tuple[Test, ...]) -> None:
    assert as_sets(dict(isolability(tests, STRUCTURE.faults))) == as_sets(ORACLE["isolability"][causality])
    assert detectable(tests, STRUCTURE.faults) == STRUCTURE.faults


def test_the_signature_matrix_follows_the_order_of_its_arguments() -> None:
    tests = integral_tests(UDS4)[:2]
    found = signature_matrix(tests, ["fA_ori", "fA_p", "fA_du"])
    assert found.tolist() == [[True, False, True], [False, True, True]]
    assert signature_matrix([], ["fA_ori"]).shape == (0, 1)


def test_five_tests_reach_the_isolability_of_all_ten() -> None:
    tests = {t.number: t for t in integral_tests(UDS4)}
    chosen = [tests[k] for k in (2, 8, 9, 13, 20)]
    assert isolability(chosen, STRUCTURE.faults) == isolability(integral_tests(UDS4), STRUCTURE.faults)
    for left_out in chosen:
        fewer = [t for t in chosen if t is not left_out]
        assert isolability(fewer, STRUCTURE.faults) != isolability(chosen, STRUCTURE.faults)


@pytest.mark.parametrize("sensors", ORACLE["sensor_sets"])
def test_fewer_sensors_give_what_the_oracle_says(sensors: str) -> None:
    expected = ORACLE["sensor_sets"][sensors]
    model = with_sensors(set(sensors.split(",")))
    structure = structure_of(model)
    assert [list(s) for s in mso_sets(structure)] == expected["mso"]
    assert [list(s) for s in mtes_sets(structure)] == expected["mtes"]
    assert [t.number for t in integral_tests(model)] == expected["integral"]
    mixed, integral = (isolability(t, structure.faults) for t in (find_tests(model), integral_tests(model)))
    assert as_sets(dict(mixed)) == as_sets(expected["isolability"]["mixed"])
    assert as_sets(dict(integral)) == as_sets(expected["isolability"]["integral"])


def test_without_added_sensors_no_fault_is_isolable() -> None:
    """Thesis figure 5.2: all detectable, none isolable."""
    model = with_sensors({"y_p_du"})
    tests = find_tests(model)
    faults = list(model.faults)
    assert len(tests) == 1
    assert list(detectable(tests, faults)) == faults
    assert all(set(others) == set(faults) - {fault} for fault, others in isolability(tests, faults).items())


def test_rearranging_the_file_renumbers_nothing() -> None:
    shuffled = dataclasses.replace(
        UDS4,
        equations=dict(reversed(list(UDS4.equations.items()))),
        unknown=dict(reversed(list(UDS4.unknown.items()))),
        differentials=UDS4.differentials[::-1],
    )
    assert [t.equations for t in find_tests(shuffled)] == [t.equations for t in find_tests(UDS4)]
    assert [t.number for t in integral_tests(shuffled)] == RUNNABLE


def test_the_one_statement_of_the_thesis_that_the_model_contradicts() -> None:
    """Chapter 7.5 has test 20 decouple fA_du; test 8 is the one that fits what the text says of it."""
    tests = {t.number: t for t in integral_tests(UDS4)}
    of_p_tp = [t for t in tests.values() if t.predicts == "y_p_tp"]
    assert {t.number for t in of_p_tp} == {8, 10, 20}
    assert "fA_du" in tests[20].faults
    assert not any({"fA_t", "fA_p", "fA_ori"} <= set(t.faults) and "fA_du" not in t.faults for t in of_p_tp)
    assert {"fA_t", "fA_p"} <= set(tests[8].faults)
    assert not {"fA_du", "fA_ori"} & set(tests[8].faults)

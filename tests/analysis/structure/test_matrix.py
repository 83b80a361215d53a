"""Structural models in matrix form and as named lists, and what is refused."""

import json
from collections.abc import Callable, Sequence
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from faultline.analysis.model import Differential, ModelError, load_model
from faultline.analysis.structure import Structure, mso_sets, mtes_sets, structure_of
from faultline.analysis.structure.matrix import read_structure, structural_model

THREE_TANK = {
    "X": [
        # p1, p2, p3, q0, q1, q2, q3, dp1, dp2, dp3
        [1, 1, 0, 0, 1, 0, 0, 0, 0, 0],
        [0, 1, 1, 0, 0, 1, 0, 0, 0, 0],
        [0, 0, 1, 0, 0, 0, 1, 0, 0, 0],
        [0, 0, 0, 1, 1, 0, 0, 1, 0, 0],
        [0, 0, 0, 0, 1, 1, 0, 0, 1, 0],
        [0, 0, 0, 0, 0, 1, 1, 0, 0, 1],
        [1, 0, 0, 0, 0, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 1, 0, 0, 0, 0],
        [0, 0, 0, 1, 0, 0, 0, 0, 0, 0],
        [2, 0, 0, 0, 0, 0, 0, 3, 0, 0],
        [0, 2, 0, 0, 0, 0, 0, 0, 3, 0],
        [0, 0, 2, 0, 0, 0, 0, 0, 0, 3],
    ],
    "F": [[int(i == k) for k in range(6)] for i in range(12)],
    "Z": [[int(i == k + 6) for k in range(3)] for i in range(12)],
}


def read(**data: Any) -> Structure:
    return read_structure(json.dumps(data), "m.json")


def as_matrices(structure: Structure) -> dict[str, Any]:
    """The matrix form of a structure."""

    def matrix(columns: Sequence[str], inside: Callable[[Sequence[str]], Sequence[str]]) -> list[list[int]]:
        return [[int(name in inside([e])) for name in columns] for e in structure.equations]

    x = matrix(structure.unknowns, structure.unknowns_in)
    for name, d in structure.differentials.items():
        row = x[structure.equations.index(name)]
        row[structure.unknowns.index(d.state)], row[structure.unknowns.index(d.derivative)] = 2, 3
    return {
        "X": x,
        "F": matrix(structure.faults, structure.faults_in),
        "Z": matrix(structure.known, structure.known_in),
        "names": {
            "equations": structure.equations,
            "unknowns": structure.unknowns,
            "faults": structure.faults,
            "knowns": structure.known,
        },
    }


def test_the_three_tank_example_has_6_mso_sets_and_4_tests_in_matrix_form() -> None:
    """Frisk, Krysander and Jung: A toolbox for analysis and design of model based diagnosis systems (IFAC 2017)."""
    structure = read(**THREE_TANK)
    assert len(mso_sets(structure)) == 6
    assert len(mtes_sets(structure)) == 4


def test_names_count_from_one_unless_they_are_given() -> None:
    structure = read(**THREE_TANK)
    assert (structure.equations[0], structure.equations[-1]) == ("e1", "e12")
    assert (structure.unknowns[-1], structure.faults[-1], structure.known) == ("x10", "f6", ("z1", "z2", "z3"))
    assert structure.differentials["e10"] == Differential(name="e10", state="x1", derivative="x8")
    assert structure.fault_rows["f6"] == 5
    assert structure.known_in(["e8"]) == ("z2",)
    assert read(X=[[1, 0]], names={"unknowns": ["p", "q"]}).unknowns == ("p", "q")


@pytest.mark.parametrize("name", ["uds"])
def test_a_model_reads_back_equal_from_its_matrices(name: str) -> None:
    structure = structure_of(load_model(name))
    assert read(**as_matrices(structure)) == structure


def test_rows_keep_their_order_whatever_their_names() -> None:
    structure = read(X=[[1], [1]], names={"equations": ["e10", "e2"]})
    assert structure.equations == ("e10", "e2")


def test_faults_and_signals_may_be_absent_or_without_columns() -> None:
    without = read(X=[[1], [1]])
    assert (without.faults, without.known) == ((), ())
    assert read(X=[[1], [1]], F=[[], []], Z=[]) == without


def test_equations_may_be_without_unknowns() -> None:
    structure = read(X=[[], []], F=[[0], [1]], Z=[[1], [1]])
    assert sorted(mso_sets(structure)) == [("e1",), ("e2",)]
    assert mtes_sets(structure) == [("e1", "e2")]  # e1 has no fault of its own and so stays


BAD_FORMS: list[tuple[str, str]] = [
    ("{", "m.json: not JSON: Expecting property name enclosed in double quotes"),
    ("[" * 100_000, "m.json: not JSON"),
    ("[[1]]", "m.json: must be an object like"),
    ('{"X": [[1]], "X": [[1]]}', "m.json: key 'X' comes twice"),
    ("{}", "m.json: X: there is no equation"),
    ('{"X": [[1]], "Y": [[1]]}', "m.json: Y: unknown key; allowed here are X, F, Z, names"),
    ('{"X": 1}', "m.json: X: must be a list of rows, not 1"),
    ('{"X": [1]}', r"m.json: X\[0\]: must be a row like"),
    ('{"X": [[1, 0], [1]]}', r"m.json: X\[1\]: has 1 entries, the rows before have 2"),
    ('{"X": [[1, 4]]}', r"m.json: X\[0\]\[1\]: must be a whole number from 0 to 3, not 4"),
    ('{"X": [[-1]]}', r"m.json: X\[0\]\[0\]: must be a whole number from 0 to 3, not -1"),
    ('{"X": [[true]]}', "must be a whole number from 0 to 3, not True"),
    ('{"X": [[1.0]]}', "must be a whole number from 0 to 3, not 1.0"),
    ('{"X": [[NaN]]}', "must be a whole number from 0 to 3, not nan"),
    ('{"X": [["1"]]}', "must be a whole number from 0 to 3, not '1'"),
    ('{"X": [[1]], "F": [[2]]}', r"m.json: F\[0\]\[0\]: must be a whole number from 0 to 1, not 2"),
    ('{"X": [[1], [1]], "F": [[1]]}', "m.json: F: has 1 rows, X has 2"),
    ('{"X": [[1]], "Z": [[1], [1]]}', "m.json: Z: has 2 rows, X has 1"),
    ('{"X": [[2, 0]]}', r"m.json: X\[0\]: e1 is a differential constraint: it needs one 2"),
    ('{"X": [[2, 3, 1]]}', "it needs one 2 .*, one 3 .*, else zeros"),
    ('{"X": [[2, 2, 3]]}', "it needs one 2"),
    ('{"X": [[2, 3, 0], [2, 0, 3]]}', "m.json: x1 is in two differential constraints"),
    ('{"X": [[2, 3, 0], [0, 2, 3]]}', "m.json: x2 is in two differential constraints"),
    ('{"X": [[2, 3]], "F": [[1]]}', "m.json: e1: a differential constraint holds x1 and x2 and nothing else; move f1"),
    ('{"X": [[2, 3]], "Z": [[1]]}', "and nothing else; move z1 to the equation of x2"),
    ('{"X": [[1], [1]], "F": [[1], [1]]}', "m.json: fault f1 is in e1, e2; let it define an unknown of its own"),
    ('{"X": [[1]], "F": [[0]]}', "m.json: fault f1 is in no equation"),
    ('{"X": [[1]], "names": 1}', "m.json: names: must be a table"),
    ('{"X": [[1]], "names": {"unknowns": [1]}}', r"m.json: names.unknowns\[0\]: must be a string"),
    ('{"X": [[1]], "names": {"signals": []}}', "m.json: names.signals: unknown key; allowed here are equations"),
    ('{"X": [[1]], "names": {"unknowns": ["a", "b"]}}', "m.json: names.unknowns: has 2 names for 1 unknowns"),
    ('{"X": [[1]], "names": {"faults": ["a"]}}', "m.json: names.faults: has 1 names for 0 faults"),
    ('{"X": [[1], [1]], "names": {"equations": ["a", "a"]}}', "m.json: names: a is the name of two things"),
    ('{"X": [[1, 1]], "names": {"unknowns": ["a", "a"]}}', "m.json: names: a is the name of two things"),
    ('{"X": [[1]], "F": [[1]], "names": {"unknowns": ["f1"]}}', "m.json: names: f1 is the name of two things"),
    ('{"X": [[1]], "names": {"unknowns": ["a b"]}}', "m.json: 'a b' is no name"),
    ('{"X": [[1]], "names": {"unknowns": [""]}}', "m.json: '' is no name"),
]


@pytest.mark.parametrize(("text", "message"), BAD_FORMS)
def test_a_bad_form_is_refused_in_one_line_with_its_place(text: str, message: str) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        read_structure(text, "m.json")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("m.json: ")


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-1, 4) | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["X", "F", "Z", "names"]), inner),
    max_leaves=12,
)


@settings(derandomize=True, deadline=None, max_examples=300)
@given(VALUES)
def test_whatever_json_comes_is_read_or_refused(data: Any) -> None:
    try:
        found = read_structure(json.dumps(data), "m.json")
    except ModelError as error:
        message = str(error)
    else:
        message = f"m.json: {len(found.equations)} equations"
        assert len(found.equations) == len(data["X"])
    assert message.startswith("m.json: ")


def test_named_lists_are_the_third_way_to_give_a_model() -> None:
    structure = structural_model(
        {"e1": ["dx", "x", "u", "f1"], "e2": ["y", "x", "f2"]},
        [Differential(name="e3", state="x", derivative="dx")],
        faults=["f1", "f2"],
        known=["u", "y"],
    )
    assert (structure.equations, structure.unknowns) == (("e1", "e2", "e3"), ("dx", "x"))
    assert (structure.fault_rows, structure.known_in(["e2"])) == ({"f1": 0, "f2": 1}, ("y",))
    assert mso_sets(structure) == [("e1", "e2", "e3")]


def test_a_constraint_named_among_the_equations_stands_there() -> None:
    d = Differential(name="e1", state="x", derivative="dx")
    structure = structural_model({"e1": ["x", "dx"], "e2": ["dx"]}, [d])
    assert structure.equations == ("e1", "e2")
    assert structure.differentials == {"e1": d}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"equations": {}}, "there is no equation"),
        ({"equations": {"e": ["x", "y"]}, "unknowns": ["x"]}, "e: unknown name 'y'; add it"),
        ({"equations": {"e": ["x"]}, "known": ["x"], "faults": ["x"]}, "x is the name of two things"),
        (
            {"equations": {"e": ["x"]}, "known": ["x"], "differentials": [("d", "x", "dx")]},
            "d: x is no unknown",
        ),
        (
            {"equations": {"e": ["x"]}, "differentials": [("d", "x", "dx"), ("d", "y", "dy")]},
            "d: there are two differential constraints of this name",
        ),
        ({"equations": {"d": ["x"]}, "differentials": [("d", "x", "dx")], "unknowns": ["x", "dx"]}, "nothing else$"),
    ],
)
def test_named_lists_that_contradict_each_other_are_refused(arguments: dict[str, Any], message: str) -> None:
    given_constraints = arguments.pop("differentials", [])
    differentials = [Differential(name=n, state=x, derivative=dx) for n, x, dx in given_constraints]
    with pytest.raises(ModelError, match=message):
        structural_model(differentials=differentials, where="here", **arguments)

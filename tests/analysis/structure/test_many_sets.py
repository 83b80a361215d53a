"""Models with more tests than anybody waits for: a limit that is said, everything else exact."""

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from made_models import tank_chain
from test_diagnosability import structures
from test_minimal_sets import structures as row_lists

from faultline.analysis.structure import Structure, find_tests, mso_sets
from faultline.analysis.structure.causality import IntegralCausality
from faultline.analysis.structure.command import main
from faultline.analysis.structure.document import document
from faultline.analysis.structure.matching import Matching
from faultline.analysis.structure.minimal import minimal_sets
from faultline.analysis.structure.supports import find_all

STEADY = settings(derandomize=True, deadline=None, max_examples=150)


def written(structure: Structure, folder: Path) -> str:
    """The structure as a file in matrix form."""
    X = [[row >> x & 1 for x in range(len(structure.unknowns))] for row in structure.unknown_rows]
    for c in structure.constraints.values():
        X[c.row][c.state], X[c.row][c.derivative] = 2, 3
    F = [[int(structure.fault_rows[f] == row) for f in structure.faults] for row in range(len(structure.equations))]
    Z = [[row >> z & 1 for z in range(len(structure.known))] for row in structure.known_rows]
    names = {"equations": structure.equations, "unknowns": structure.unknowns, "knowns": structure.known}
    path = folder / "model.json"
    path.write_text(json.dumps({"X": X, "F": F, "Z": Z, "names": {**names, "faults": structure.faults}}))
    return str(path)


def test_a_dense_model_ends_with_one_line_that_says_what_was_cut(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A chain of 60 tanks has redundancy 60 and some 3**60 tests."""
    structure = tank_chain(60)
    path = written(structure, tmp_path)
    assert main([path, "--most", "50", "--json", str(tmp_path / "out.json")]) == 0
    out, err = capsys.readouterr()
    assert "more than 50 MSO sets, more than 50 tests (MTES)" in out
    assert "Smallest sets of tests" not in out
    [line] = err.splitlines()
    assert line.startswith("faultline structure: only the first 50 tests and MSO sets were searched for; ")
    assert "--most" in line
    found = json.loads((tmp_path / "out.json").read_text())
    assert (len(found["tests"]), len(found["mso"])) == (50, 50)
    assert (found["more_tests"], found["more_mso"], found["selected_tests"]) == (True, True, None)
    together = {fault: others for fault, others in found["isolability"]["mixed"].items() if others}
    assert together == {"fV60": ["fT60"], "fT60": ["fV60"]}  # of the last outflow, which nothing else contains


def test_below_the_limit_nothing_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tank_chain(3), tmp_path)
    assert main([path, "--most", "18"]) == 0
    out, err = capsys.readouterr()
    assert "\n18 MSO sets, 18 tests (MTES)" in out
    assert err == ""
    assert main([path, "--most", "17"]) == 0
    assert "more than 17 MSO sets" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="2"):
        main([path, "--most", "0"])


@STEADY
@given(rows=row_lists(most_rows=9))
def test_what_is_searched_for_is_the_beginning_of_all(rows: list[int]) -> None:
    whole = minimal_sets(rows, range(len(rows)))
    for most in range(1, len(whole) + 2):
        assert minimal_sets(rows, range(len(rows)), most).tolist() == whole[:most].tolist()


def test_the_first_tests_are_numbered_as_all_are() -> None:
    structure = tank_chain(5)
    assert find_tests(structure, 40) == find_tests(structure)[:40]
    assert find_all(structure, 179).more_tests is False
    assert find_all(structure, 178).more_tests is True


@STEADY
@given(structure=structures())
def test_what_hinders_one_set_says_nothing_wrong_of_the_next(structure: Structure) -> None:
    """One object asked for all sets, with what it has kept, against a fresh one for each."""
    integral = IntegralCausality(structure)
    for mso in mso_sets(structure):
        rows = structure.rows(mso)
        assert integral.residuals(rows) == IntegralCausality(structure).residuals(rows)


@STEADY
@given(rows=row_lists())
def test_a_sensor_adds_what_it_over_determines(rows: list[int]) -> None:
    matching = Matching(rows)
    for x in matching.owner:
        with_sensor = {*Matching([*rows, 1 << x]).over_determined()} - {len(rows)}
        if with_sensor == {*matching.over_determined()}:  # its sensor is not redundant, or all it adds is there
            continue
        assert with_sensor == {*matching.over_determined(), *matching.over_determined_by(x)}


def test_residual_choices_are_listed_for_the_first_tests_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("faultline.analysis.structure.document.MANY_RESIDUALS", 3)
    tests = document(tank_chain(3))["tests"]
    assert isinstance(tests, list)
    assert [test["residuals"] is not None for test in tests] == [True] * 3 + [False] * 15

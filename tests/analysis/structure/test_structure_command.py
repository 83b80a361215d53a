"""What `faultline structure` prints and returns."""

import json
from pathlib import Path

import pytest

from analysis.model import ModelError
from analysis.structure.command import main

NO_REDUNDANCY = """
schema = 1
name = "bare"
[known.u]
unit = "1"
min = 0.0
max = 1.0
noise = 0.1
[unknown.a]
unit = "1"
[[equation]]
name = "e1"
expr = "a - u"
"""


def test_it_prints_counts_tests_signatures_and_isolability(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["uds4"]) == 0
    out = capsys.readouterr().out
    assert "18 equations (14 algebraic, 4 differential), 15 unknowns, 5 known signals, 9 faults" in out
    assert "26 MSO sets, 21 tests (MTES), 10 of them can be run" in out
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert "t02 e16 y_p_du p_du integral 2, derivative 5 e03-e04,e07,e11,e15-e16,e18" in lines
    assert "t15 - - p_tp,p_bp,p_ap,p_du mixed 16 e01-e05,e07-e15,e17-e18" in lines
    assert "t02 . X X . . X X . X" in lines
    assert "fA_t isolable from every other fault" in lines
    assert "fA_t not isolable from fq_pump, fA_p" in lines
    assert "computed in the order" not in out


def test_tests_adds_how_they_are_computed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["uds4", "--tests"]) == 0
    out = capsys.readouterr().out
    assert "t02: r = y_p_du - h(p_du) by e16\n  dp_du = g(p_du; y_p_ap, dc_dose)\n" in out
    assert "  computed in the order q_ori (e03), q_dos (e04), p_ap (e18), q_filt_du (e07), dp_du (e11)\n" in out
    assert "t01, t03, t04, t05, t07, t11, t14, t15, t16, t17, t18: cannot be run: no residual equation has" in out


def test_json_says_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["uds4", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["redundancy"] == 3
    assert len(found["mso"]) == 26
    assert [t["equations"] for t in found["tests"]] == found["mtes"]
    assert found["tests"][1]["residual"] == "e16"
    assert found["tests"][1]["arguments"]["g"]["p_du"] == {"states": ["p_du"], "known": ["y_p_ap", "dc_dose"]}
    assert found["tests"][0]["obstacle"] == "no residual equation has integral causality"
    assert found["isolability"]["mixed"]["fA_ori"] == ["fA_dos"]
    assert found["isolability"]["runnable"]["fA_ori"] == ["fA_dos", "fA_du"]


def test_a_model_without_redundancy_says_so_and_the_answer_is_no(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bare.toml"
    path.write_text(NO_REDUNDANCY)
    assert main([str(path)]) == 1
    assert "no redundancy: every equation is needed" in capsys.readouterr().out


def test_redundancy_without_a_fault_is_told_apart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "healthy.toml"
    path.write_text(NO_REDUNDANCY + '[[equation]]\nname = "e2"\nexpr = "a - 2*u"\n')
    assert main([str(path)]) == 1
    assert "no test is sensitive to a fault" in capsys.readouterr().out


def test_an_unknown_model_is_an_input_error() -> None:
    with pytest.raises(ModelError, match=r"^nowhere: cannot be read; give a model file, or a shipped model: .*uds4"):
        main(["nowhere"])

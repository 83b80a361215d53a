"""What `faultline structure` prints and returns."""

import json
from pathlib import Path

import pytest

from faultline.analysis.graph.bank import build_bank
from faultline.analysis.model import ModelError, load_model
from faultline.analysis.structure import structure_of
from faultline.analysis.structure.command import main
from faultline.analysis.structure.lint import sound_model
from faultline.service.core.errors import InputError

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
    assert main(["uds"]) == 0
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
    assert main(["uds", "--tests"]) == 0
    out = capsys.readouterr().out
    assert "t02: r = y_p_du - h(p_du) by e16\n  dp_du = g(p_du; y_p_ap, dc_dose)\n" in out
    assert "  computed in the order q_ori (e03), q_dos (e04), p_ap (e18), q_filt_du (e07), dp_du (e11)\n" in out
    assert "t01, t03, t04, t05, t07, t11, t14, t15, t16, t17, t18: cannot be run: no residual equation has" in out


def test_the_report_names_what_no_test_separates_the_smallest_selections_and_the_sensors(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["uds", "--positions", "q_ori", "q_dos=3", "p_bp"]) == 0
    out = capsys.readouterr().out
    lines = [" ".join(line.split()) for line in out.splitlines()]
    assert "e03-e04,e11,e15 q_ori, q_dos, dp_du fA_ori, fA_dos" in lines
    assert "Isolability, mixed and derivative causality" in lines
    assert "Smallest sets of tests that can be run that tell apart what all of them do: 4" in lines
    assert "t02, t08, t10, t12, t21" in lines
    assert "q_ori, q_dos, p_bp (cost 5)" in lines


def test_json_says_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["uds", "--json", "-"]) == 0
    printed = capsys.readouterr().out
    assert main(["uds", "--json", str(tmp_path / "new" / "uds.json")]) == 0
    assert (tmp_path / "new" / "uds.json").read_text() == printed
    assert "26 MSO sets" in capsys.readouterr().out
    found = json.loads(printed)
    assert found["redundancy"] == 3
    assert len(found["mso"]) == 26
    assert [t["equations"] for t in found["tests"]] == found["mtes"]
    assert found["tests"][1]["residual"] == "e16"
    assert found["tests"][1]["arguments"]["g"]["p_du"] == {"states": ["p_du"], "known": ["y_p_ap", "dc_dose"]}
    assert {"equation": "e16", "causality": "integral", "states": ["p_du"], "predicts": "y_p_du"} in (
        found["tests"][1]["residuals"]
    )
    assert found["tests"][0]["obstacle"] == "no residual equation has integral causality"
    assert found["isolability"]["mixed"] == found["isolability"]["derivative"]
    assert found["isolability"]["mixed"]["fA_ori"] == ["fA_dos"]
    assert found["isolability"]["integral"]["fA_ori"] == ["fA_dos", "fA_du"]
    assert found["detectability"]["integral"] == found["faults"]
    assert [c["equations"] for c in found["dm"]["classes"]][:2] == [["e01", "e02"], ["e03", "e04", "e11", "e15"]]
    rest = {"q_pump", "q_filt_p", "q_filt_du", "p_tp", "p_bp", "p_ap", "p_du"}
    assert set(found["dm"]["rest_unknowns"]) == rest
    assert ["t02", "t06", "t08", "t20", "t21"] in found["selected_tests"]
    assert sorted(map(sorted, found["sensor_sets"]["mixed"])) == [["q_dos"], ["q_ori"]]
    assert found["lint"] == []


def test_a_structural_model_in_matrix_form_is_analysed_like_its_formulas(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["uds", "--json", "-"]) == 0
    whole = json.loads(capsys.readouterr().out)
    s = structure_of(load_model("uds"))
    X = [[row >> x & 1 for x in range(len(s.unknowns))] for row in s.unknown_rows]
    for row, name in enumerate(s.equations):
        if name in s.differentials:
            X[row][s.unknowns.index(s.differentials[name].state)] = 2
            X[row][s.unknowns.index(s.differentials[name].derivative)] = 3
    F = [[int(s.fault_rows[fault] == row) for fault in s.faults] for row in range(len(s.equations))]
    Z = [[row >> z & 1 for z in range(len(s.known))] for row in s.known_rows]
    names = {"equations": s.equations, "unknowns": s.unknowns, "faults": s.faults, "knowns": s.known}
    path = tmp_path / "matrix.json"
    path.write_text(json.dumps({"X": X, "F": F, "Z": Z, "names": names}))
    assert main([str(path), "--json", "-"]) == 0
    assert {**json.loads(capsys.readouterr().out), "model": "uds"} == whole


def test_sensors_are_taken_away_and_added(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Thesis fig. 5.2: without the two added sensors every fault is detectable and none isolable."""
    assert main(["uds", "--without", "y_p_tp", "y_p_ap", "--json", "-"]) == 0
    bare = json.loads(capsys.readouterr().out)
    assert (bare["redundancy"], len(bare["mso"])) == (1, 1)
    assert all(set(others) == {*bare["faults"]} - {fault} for fault, others in bare["isolability"]["mixed"].items())
    assert main(["uds", "--without", "y_p_tp", "y_p_ap", "--sensors", "p_tp", "p_ap", "--json", "-"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert len(again["mso"]) == 26
    assert again["isolability"]["mixed"]["fA_ori"] == ["fA_dos"]


@pytest.mark.parametrize(
    ("causality", "code", "words"),
    [
        ("integral", 1, "fA_t is not isolable from fA_p with integral causality: every test that contains e05"),
        ("derivative", 0, "fA_t is isolable from fA_p"),
    ],
)
def test_why(causality: str, code: int, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["uds", "--why", "fA_t", "fA_p", "--causality", causality]) == code
    assert words in capsys.readouterr().out


def test_the_figures_are_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rc", "--figures", str(tmp_path / "f")]) == 0
    names = {path.name for path in (tmp_path / "f").iterdir()}
    kinds = ("structure", "decomposition", "isolability", "signatures", "graph-t01")
    assert names == {f"{kind}.{ending}" for kind in kinds for ending in ("svg", "png")}
    assert "wrote 10 pictures" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["uds", "--sensors", "p_xx"], "p_xx: no unknown, so no sensor can measure it"),
        (["uds", "--without", "dc_dose"], "dc_dose: no known signal with a sensor equation"),
        (["uds", "--positions", "p_tp=much"], "--positions p_tp=much: 'much' is no cost"),
        (["uds", "--positions", "p_tp="], "--positions p_tp=: '' is no cost"),
        (["uds", "--positions", "p_tp=1", "p_tp=5"], "--positions p_tp=5: p_tp comes twice"),
        (["uds", "--why", "fA_t", "fX"], "fX: no fault of the model"),
        (["nowhere.json"], r"nowhere\.json: cannot be read: No such file or directory"),
    ],
)
def test_what_is_not_there_is_named(arguments: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        main(arguments)


def test_a_model_without_redundancy_says_so_and_the_answer_is_no(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bare.toml"
    path.write_text(NO_REDUNDANCY)
    assert main([str(path)]) == 1
    assert "no redundancy, so no test and no detectable fault; a sensor of a would give some" in capsys.readouterr().out


def test_several_sensors_are_named_where_no_single_one_gives_redundancy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "two.json"
    path.write_text('{"X": [[1, 1, 1]], "F": [[1]]}')
    assert main([str(path), "--positions", "x1=2", "x2", "x3"]) == 1
    out = capsys.readouterr().out
    assert "no redundancy, so no test and no detectable fault; sensors of x1, x2 and x3 together would give some" in out
    assert "  x1, x2, x3  (cost 4)\n" in out


def test_a_dropped_sensor_leaves_the_formulas(capsys: pytest.CaptureFixture[str]) -> None:
    """Equations with several solutions are refused with other sensors as well."""
    assert main(["uds/production", "--without", "y_p_tp"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("uds_production: Urea dosing system with one pressure state")
    assert "0 of them can be run" in out
    assert "warning: test: none can be run; t01: with residual" in out
    assert main(["three-tank", "--without", "y1", "--sensors", "h1", "--tests"]) == 0
    assert "r = y_h1 - h(h1) by y_h1" in capsys.readouterr().out


def test_units_that_contradict_each_other_are_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "metres.toml"
    path.write_text(NO_REDUNDANCY.replace('[unknown.a]\nunit = "1"', '[unknown.a]\nunit = "m"'))
    assert main([str(path)]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"faultline structure: error: {path}: equation.e1: ")
    assert err.count("\n") == 1
    with pytest.raises(ModelError, match=rf"^{path}: equation\.e1: "):
        sound_model(path)
    path.write_text(NO_REDUNDANCY + '[[equation]]\nname = "e2"\nexpr = "1 - 2"\n')
    with pytest.raises(ModelError, match=r"equation\.e2: `1 - 2` = 0 has neither a known signal nor an unknown in it"):
        sound_model(path)


def test_what_no_test_that_can_be_run_sees_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """e2 is a loop of its own: y2 can be predicted, but with two solutions."""
    path = tmp_path / "square.toml"
    fault = '[equation.fault]\nname = "{0}"\ncomponent = "c"\nenters = "u -> u + {0}"\nsizes = [1.0]\n'
    text = NO_REDUNDANCY + fault.format("f1") + '[[equation]]\nname = "e2"\nexpr = "a - 3*u"\n'
    text += '[unknown.b]\nunit = "1"\n[[equation]]\nname = "e3"\nexpr = "b*b - u"\n' + fault.format("f3")
    text += '[[equation]]\nname = "e4"\nexpr = "b*b - 2*u + b"\n'
    path.write_text(text)
    assert main([str(path)]) == 0
    out = capsys.readouterr().out
    assert "warning: fault.f3: no test that sees it can be run; t01: with residual e4, e3 cannot be solved" in out
    assert "fault.f1: no test" not in out


def test_two_sensors_of_one_thing_are_a_test(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A consistency relation of two known signals has no unknown, and predicts the first."""
    path = tmp_path / "pair.toml"
    signal = 'unit = "1"\nmin = 0.0\nmax = 1.0\nnoise = 0.1\n'
    text = NO_REDUNDANCY.replace('[unknown.a]\nunit = "1"\n', f"[known.a]\n{signal}")
    fault = '[equation.fault]\nname = "f"\ncomponent = "c"\nenters = "u -> u + f"\nsizes = [1.0]\n'
    path.write_text(text + fault)
    assert main([str(path)]) == 0
    assert "1 tests (MTES), 1 of them can be run" in capsys.readouterr().out


def test_names_without_numbers_are_listed(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    names = ["pump", "valve9", "valve10", "valve11", "valve13", "tank"]
    path = tmp_path / "names.json"
    path.write_text(json.dumps({"X": [[1]] * 6, "F": [[1]] + [[0]] * 5, "names": {"equations": names}}))
    assert main([str(path)]) == 0
    assert "pump,valve9-valve11,valve13,tank" in capsys.readouterr().out


def test_why_answers_one_question(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["uds", "--why", "fA_t", "fA_p", "--json", "-"])
    assert "--why answers one question; leave --json" in capsys.readouterr().err


def test_no_sensor_measures_a_derivative(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["uds", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    proposed = {name for sets in found["sensor_sets"].values() for sensors in sets for name in sensors}
    assert proposed & {"q_ori", "q_dos"}
    assert not proposed & {"dp_tp", "dp_bp", "dp_ap", "dp_du"}
    states = [r["states"] for t in found["tests"] for r in t["residuals"] if r["causality"] == "mixed"]
    assert len(states) > 100
    assert not any(states)


def test_a_fault_outside_of_the_redundant_part_is_not_detectable(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "half.json"
    path.write_text('{"X": [[1, 0], [1, 0], [0, 1]], "F": [[1, 0], [0, 0], [0, 1]]}')
    assert main([str(path)]) == 0
    out = capsys.readouterr().out
    assert "  f2  not detectable\n" in out
    assert "fault.f2: is not detectable: no test contains e3; a sensor of x2 would give one" in out


def test_redundancy_without_a_fault_is_told_apart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "healthy.toml"
    path.write_text(NO_REDUNDANCY + '[[equation]]\nname = "e2"\nexpr = "a - 2*u"\n')
    assert main([str(path)]) == 1
    assert "no test is sensitive to a fault" in capsys.readouterr().out


def test_an_unknown_model_is_an_input_error() -> None:
    with pytest.raises(
        ModelError, match=r"^nowhere: cannot be read; give a model file, a system's folder, or a shipped model: .*uds"
    ):
        main(["nowhere"])


def test_a_model_without_the_added_sensors_is_written_for_production_vehicles(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written = tmp_path / "production.toml"
    assert main(["uds", "--without", "y_p_tp", "y_p_ap", "--model", str(written)]) == 0
    model = load_model(str(written))
    assert [*model.known] == ["y_p_du", "n_p", "dc_dose"]
    assert (load_model("uds").sensor_set, model.sensor_set) == ("instrumented", "production")
    [generator] = build_bank(model).generators
    assert {*generator.inputs} == {*model.known}
    assert generator.faults == [name for name in load_model("uds").faults if name not in ("fy_p_tp", "fy_p_ap")]


def test_a_model_with_sensors_that_are_not_there_yet_is_not_written(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["uds", "--sensors", "p_bp", "--model", "x.toml"])
    assert caught.value.code == 2
    assert "neither range nor noise is known" in capsys.readouterr().err

"""`faultline code`: files that run, for all tests or for one residual; what cannot be is refused by name."""

import ast
import subprocess
from pathlib import Path

import pytest

from faultline.analysis.codegen.command import main
from faultline.analysis.model.file import shipped_models
from faultline.service.core.errors import InputError


def test_every_test_that_can_be_run_is_written_in_both_languages(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["uds", "--out", str(tmp_path / "code")]) == 0
    names = {path.name for path in (tmp_path / "code").iterdir()}
    tests = ["t02", "t06", "t08", "t09", "t10", "t12", "t13", "t19", "t20", "t21"]
    assert names == {f"uds_{test}.{ending}" for test in tests for ending in ("py", "h", "c")}
    assert "wrote uds_t02.py, uds_t02.h, uds_t02.c: residual e16, integral causality" in capsys.readouterr().out
    for test in tests:
        ast.parse((tmp_path / "code" / f"uds_{test}.py").read_text())


def test_one_residual_of_another_causality(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["uds", "--test", "t01", "--residual", "e16", "--filter", "2", "--out", str(tmp_path)]) == 0
    assert "derivative causality" in capsys.readouterr().out
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-c", "uds_t01_e16.c", "-o", "t01.o"]
    subprocess.run(["cc", *strict], cwd=tmp_path, check=True)


def test_models_and_forms_go_into_one_folder_and_link_together(tmp_path: Path) -> None:
    chosen = ["three-tank", "--test", "t10", "--residual", "e12"]
    assert main(["uds", "--test", "t10", "--out", str(tmp_path)]) == 0
    assert main(["three-tank", "--test", "t10", "--out", str(tmp_path)]) == 0
    assert main([*chosen, "--out", str(tmp_path)]) == 0
    assert main([*chosen, "--form", "derivative", "--out", str(tmp_path)]) == 0
    names = {"uds_t10", "three_tank_t10", "three_tank_t10_e12", "three_tank_t10_e12_derivative"}
    assert {path.stem for path in tmp_path.iterdir()} == names
    (tmp_path / "main.c").write_text("int main(void) { return 0; }\n")
    subprocess.run(["cc", "main.c", *(f"{name}.c" for name in names), "-lm"], cwd=tmp_path, check=True)


RC = shipped_models()["rc"].read_text()


@pytest.mark.parametrize(
    ("name", "identifier"), [("RC circuit, 2 of 3", "RC_circuit__2_of_3"), ("2nd", "model_2nd"), ("Öl", "model__l")]
)
def test_a_model_name_of_any_characters_makes_an_identifier(tmp_path: Path, name: str, identifier: str) -> None:
    (tmp_path / "own.toml").write_text(RC.replace('name = "rc"', f'name = "{name}"'))
    assert main([str(tmp_path / "own.toml"), "--out", str(tmp_path / "code")]) == 0
    assert {path.stem for path in (tmp_path / "code").iterdir()} == {f"{identifier}_t01"}


UNTESTED = """
schema = 1
name = "untested"
[known.y]
unit = "1"
min = 0.0
max = 1.0
noise = 0.1
[unknown.x]
unit = "1"
[[equation]]
name = "e1"
expr = "y - x"
fault = {name = "f", component = "sensor", enters = "x -> x + f", sizes = [0.1]}
"""
SECOND_WAY = """
[[equation]]
name = "e2"
expr = "x - y"
"""


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (UNTESTED, "nothing is redundant: no unknown can be computed in two ways; `faultline structure`"),
        (UNTESTED.replace("fault =", "#") + SECOND_WAY, "the model has no fault"),
    ],
)
@pytest.mark.parametrize("arguments", [[], ["--test", "t01"]])
def test_a_model_without_any_test_says_why(tmp_path: Path, text: str, reason: str, arguments: list[str]) -> None:
    (tmp_path / "untested.toml").write_text(text)
    with pytest.raises(InputError, match=f"untested: there is no test, because {reason}"):
        main([str(tmp_path / "untested.toml"), *arguments, "--out", str(tmp_path / "code")])


def test_a_form_without_a_residual_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["uds", "--form", "derivative", "--out", str(tmp_path)])
    assert "--form needs --residual" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["uds", "--test", "t99"], "uds: no test t99; those are t01, t02"),
        (
            ["uds", "--test", "t01"],
            "uds: t01 cannot be run: no residual equation has integral causality; name another",
        ),
        (["uds", "--test", "t02", "--residual", "e01"], "residual e01 is not among e03, e04"),
        (["uds/production", "--test", "t09", "--residual", "e10"], "more than one solution|cannot be solved|loop"),
        (["uds/production"], "uds_production: no test can be run; choose one with --test and --residual"),
        (["model.json"], "model.json: a structural model has no formulas, .*; write its equations as formulas"),
        (
            ["uds", "--test", "t01", "--residual", "e16", "--form", "derivative"],
            "e16 is no differential constraint, .*; leave --form away, or take one of t01: e12, e13, e14",
        ),
    ],
)
def test_what_cannot_be_written_is_named(tmp_path: Path, arguments: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        main([*arguments, "--out", str(tmp_path / "code")])
    assert not (tmp_path / "code").exists()

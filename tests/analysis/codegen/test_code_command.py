"""`faultline code`: files that run, for all tests or for one residual; what cannot be is refused by name."""

import ast
import subprocess
from pathlib import Path

import pytest

from analysis.codegen.command import main
from service.core.errors import InputError


def test_every_test_that_can_be_run_is_written_in_both_languages(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["uds4", "--out", str(tmp_path / "code")]) == 0
    names = {path.name for path in (tmp_path / "code").iterdir()}
    tests = ["t02", "t06", "t08", "t09", "t10", "t12", "t13", "t19", "t20", "t21"]
    assert names == {f"{test}.{ending}" for test in tests for ending in ("py", "h", "c")}
    assert "wrote t02.py, t02.h, t02.c: residual e16, integral causality" in capsys.readouterr().out
    for test in tests:
        ast.parse((tmp_path / "code" / f"{test}.py").read_text())


def test_one_residual_of_another_causality(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["uds4", "--test", "t01", "--residual", "e16", "--filter", "2", "--out", str(tmp_path)]) == 0
    assert "derivative causality" in capsys.readouterr().out
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-c", "t01_e16.c", "-o", "t01.o"]
    subprocess.run(["cc", *strict], cwd=tmp_path, check=True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["uds4", "--test", "t99"], "uds4: no test t99; those are t01, t02"),
        (
            ["uds4", "--test", "t01"],
            "uds4: t01 cannot be run: no residual equation has integral causality; name another",
        ),
        (["uds4", "--test", "t02", "--residual", "e01"], "residual e01 is not among e03, e04"),
        (["uds1", "--test", "t09", "--residual", "e10"], "more than one solution|cannot be solved|loop"),
        (["uds1"], "uds1: no test can be run; choose one with --test and --residual"),
    ],
)
def test_what_cannot_be_written_is_named(tmp_path: Path, arguments: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        main([*arguments, "--out", str(tmp_path / "code")])
    assert not (tmp_path / "code").exists()

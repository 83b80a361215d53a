"""docs/models.md: what a newcomer copies from it works."""

import contextlib
import io
import re
import shlex
from pathlib import Path

import pytest

from faultline.service.cli import main

PAGE = (Path(__file__).resolve().parents[3] / "docs" / "models.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, flags=re.DOTALL)


def test_the_commands_of_the_page_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    [toml, names], [json] = blocks("toml"), blocks("json")
    Path("tank.toml").write_text(toml)
    Path("names.toml").write_text(names)
    Path("tank.json").write_text(json)
    commands = [line for block in blocks("sh") for line in block.splitlines()]
    codes = {}
    for line in commands:
        program, *arguments = shlex.split(line)
        assert program == "faultline"
        codes[line] = main(arguments)
    out, err = capsys.readouterr()
    assert err == ""
    why = "faultline structure tank.toml --why f_clogged fy"
    assert codes == dict.fromkeys(commands, 0) | {why: 1}, "the two cannot be told apart"
    assert "Findings" not in out
    assert "1 MSO sets, 1 tests (MTES), 1 of them can be run" in out
    assert sorted(path.suffix for path in Path("code").iterdir()) == [".c", ".h", ".py"]


def test_the_python_of_the_page_runs() -> None:
    [code] = blocks("python")
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(compile(code, "docs/models.md", "exec"), {})  # noqa: S102 (our own page)
    first, *rest = out.getvalue().splitlines()
    assert first.startswith("f_clogged is not isolable from fy with integral causality")
    assert rest == ["('h',) 1.0", "('q',) 5.0", "[(0, 1)]"]

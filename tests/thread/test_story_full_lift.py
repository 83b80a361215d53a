"""docs/story-full-lift.md: its commands run, and print what the page says they print."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from analysis.model import load_model

FAULTLINE = str(Path(sys.executable).with_name("faultline"))
PAGE = (Path(__file__).resolve().parents[2] / "docs" / "story-full-lift.md").read_text()
COMMANDS = [line for block in re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL) for line in block.splitlines()]
[PRINTED] = re.findall(r"```text\n(.*?)```", PAGE, flags=re.DOTALL)
NUMBER = r"(?<![\w.])\d+(?:\.\d+)?"


def test_what_the_page_says_comes_out(tmp_path: Path) -> None:
    printed = ""
    for command in COMMANDS:
        program, *arguments = shlex.split(command)
        assert program == ".venv/bin/faultline"
        done = subprocess.run(
            [FAULTLINE, *arguments], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=600
        )
        assert done.returncode == 0, done.stdout + done.stderr
        printed += done.stdout
    lines = {re.sub(NUMBER, "#", line): line for line in printed.splitlines()}
    for line in PRINTED.splitlines():
        came = lines.get(re.sub(NUMBER, "#", line), "")
        figures, ours = ([float(number) for number in re.findall(NUMBER, text)] for text in (line, came))
        assert ours == pytest.approx(figures, rel=0.1), f"the page says\n{line}\nand it printed\n{printed}"
    found = load_model(str(tmp_path / "out" / "story" / "found" / "model.toml"))
    before = load_model(str(tmp_path / "out" / "story" / "before" / "model.toml"))
    assert {*found.parameters} - {*before.parameters} == {"full_open_gain_g"}
    assert before.equations == load_model("uds4").equations

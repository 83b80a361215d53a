"""The stories in docs: their commands run, and print what the pages say they print. `make test` runs the first one."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from faultline.analysis.model import Model, load_model

FAULTLINE = str(Path(sys.executable).with_name("faultline"))
DOCS = Path(__file__).resolve().parents[2] / "docs"
NUMBER = r"(?<![\w.])\d+(?:\.\d+)?"


def told(story: str, folder: Path, unsure: int = 0) -> None:
    """Runs the page in a folder: so many of its calls of `discover` end without one name."""
    page = (DOCS / f"story-{story}.md").read_text()
    commands = [line for block in re.findall(r"```sh\n(.*?)```", page, flags=re.DOTALL) for line in block.splitlines()]
    printed, codes = "", []
    for command in commands:
        program, *arguments = shlex.split(command)
        assert program == ".venv/bin/faultline"
        done = subprocess.run(
            [FAULTLINE, *arguments], cwd=folder, capture_output=True, text=True, check=False, timeout=600
        )
        codes.append(done.returncode)
        assert done.returncode == 0 or (done.returncode == 1 and arguments[0] == "discover"), done.stdout + done.stderr
        printed += done.stdout
    assert sum(codes) == unsure, printed
    lines = [(re.sub(NUMBER, "#", line), _figures(line)) for line in printed.splitlines()]
    for line in "".join(re.findall(r"```text\n(.*?)```", page, flags=re.DOTALL)).splitlines():
        came = [figures for text, figures in lines if text == re.sub(NUMBER, "#", line)]
        said = any(figures == pytest.approx(_figures(line), rel=0.1) for figures in came)
        assert said, f"the page says\n{line}\nand it printed\n{printed}"


def _figures(line: str) -> list[float]:
    return [float(number) for number in re.findall(NUMBER, line)]


def added(model: Path) -> set[str]:
    """The parameters that a model has more than the shipped one."""
    return {*load_model(str(model)).parameters} - {*shipped().parameters}


def shipped() -> Model:
    return load_model("uds")


def discovered(folder: Path) -> dict[str, Any]:
    """What `discover` wrote for programs."""
    found: dict[str, Any] = json.loads((folder / "discovery.json").read_text())
    return found


def test_a_valve_that_passes_more_when_held_open(tmp_path: Path) -> None:
    told("full-lift", tmp_path)
    assert added(tmp_path / "out" / "story" / "found" / "model.toml") == {"full_open_gain_g"}
    assert load_model(str(tmp_path / "out" / "story" / "before" / "model.toml")).equations == shipped().equations
    bundles = discovered(tmp_path / "out" / "story" / "found")["bundle"]["data"]
    orifice, pump = (
        [bundles[which]["verdicts"][name] for which in ("before", "after")]
        for name in ("truck-drive-s11-fA_ori", "truck-drive-s12-fq_pump")
    )
    assert [verdict["contained"] for verdict in orifice + pump] == [True] * 4
    assert [verdict["isolated"] for verdict in orifice] == [["fA_ori"], ["fA_ori"]]
    assert [verdict["first"] for verdict in pump] == [["fA_p", "fq_pump"], ["fq_pump"]]
    assert [verdict["delay_s"] for verdict in orifice] == pytest.approx([98.2, 14.2], abs=1.0)
    assert [verdict["delay_s"] for verdict in pump] == pytest.approx([35.1, 11.1], abs=1.0)


@pytest.mark.long
def test_air_in_the_hose_or_a_hose_that_stiffens(tmp_path: Path) -> None:
    told("air-or-stiff-hose", tmp_path, unsure=1)
    assert added(tmp_path / "out" / "air" / "found" / "model.toml") >= {"entrained_air_V_a"}


@pytest.mark.long
def test_a_hose_that_creeps(tmp_path: Path) -> None:
    (tmp_path / "docs").symlink_to(DOCS)
    told("creeping-hose", tmp_path, unsure=1)
    found = tmp_path / "out" / "creep" / "found"
    assert added(found / "model.toml") == {"creeping_hose_C", "creeping_hose_tau"}
    [idle] = [r for r in discovered(found)["regimes"] if (r["output"], r["mode"]) == ("y_p_ap", "idle")]
    assert idle["rms_before"] > 1.5 * idle["expected"]
    assert idle["rms_after"] < 1.1 * idle["expected"]

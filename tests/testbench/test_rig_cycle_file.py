"""Cycles that somebody has written down."""

from pathlib import Path

import numpy as np
import pytest

from faultline.testbench.command import main
from faultline.testbench.cycles import DOSING_FROM, STANDING, SYSTEM, Segment, cycle, read_cycle
from faultline.testbench.errors import RigError

TEXT = """
schema = 1
name = "low"
text = "dosing at low pressure"
[[segment]]
duration_s = 30
setpoint_bar = 6.0
duty = 0.5
[[segment]]
duration_s = 10.0
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "low.toml"
    path.write_text(text)
    return path


def test_what_is_written_follows_the_start(tmp_path: Path) -> None:
    found = cycle(str(written(tmp_path, TEXT)))
    assert (found.name, found.text) == ("low", "dosing at low pressure")
    assert found.segments(120.0, np.random.default_rng(0)) == [
        Segment(STANDING, None),
        Segment(DOSING_FROM - STANDING, SYSTEM),
        Segment(30.0, 6e5, 0.5),
        Segment(10.0, None, 0.0),
        Segment(40.0, SYSTEM),
    ]


def test_it_is_recorded_under_its_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, TEXT)
    folders = ["--out", str(tmp_path / "bench"), "--truth", str(tmp_path / "truth")]
    assert main(["record", "--cycle", str(path), *folders]) == 0
    folder = tmp_path / "bench" / "bench-low-s0"
    assert 'cycle = "low"' in (folder / "recording.toml").read_text()
    lines = (folder / "can.log").read_text().splitlines()
    first, last = (float(line.split()[0].strip("()")) for line in (lines[0], lines[-1]))
    assert last - first == pytest.approx(80.0, abs=0.5)  # to the end of the cycle
    assert "bench-low-s0" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("schema = 2", "schema: must be 1, not 2"),
        ("schema = [", "not TOML: "),
        ('schema = 1\nname = "a/b"', "name: 'a/b' is no name for a folder"),
        ('schema = 1\nname = "a"', "segment: needs at least one"),
        (
            TEXT + "pressure = 3",
            r"segment\[1\]: pressure: unknown key; allowed here are duration_s, setpoint_bar, duty",
        ),
        (TEXT.replace("6.0", "60.0"), r"segment\[0\]\.setpoint_bar: must be a number from 1.5 to 13, not 60.0"),
        (TEXT.replace("0.5", "true"), r"segment\[0\]\.duty: must be a number from 0 to 1, not True"),
        (TEXT.replace("duration_s = 10.0", "duty = 0"), r"segment\[1\]\.duration_s: must be a number"),
        (TEXT + "duty = 0.3", r"segment\[1\]\.duty: nothing is dosed while the pump is off"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(RigError, match=f"^{path}: {message}"):
        read_cycle(path)


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"none\.toml: cannot be read: No such file or directory"):
        cycle(str(tmp_path / "none.toml"))

"""What the demo promises, replaces, and refuses to measure; the demo itself runs in `tests/thread/test_demo.py`."""

import dataclasses
from pathlib import Path

import pytest

from faultline.testbench import demo
from faultline.testbench.promise import RECORDINGS, Verdict, problems

PERFECT = Verdict(
    recording="r",
    faults=["fA_du"],
    onset_s=150.0,
    detected=True,
    delay_s=4.0,
    isolated=["fA_du", "fy_p_ap"],
    first=["fA_du"],
    contained=True,
    named=True,
    tests=["t02"],
    false_alarms=0,
    could_tell={"t02": 0.9},
    blind=[],
    apart_ticks=0,
)


def test_what_was_promised_has_no_problems() -> None:
    assert problems(PERFECT) == []
    both = ["fA_t", "fy_p_tp"]
    assert problems(dataclasses.replace(PERFECT, faults=["fA_t"], isolated=both, first=both)) == []
    assert problems(dataclasses.replace(PERFECT, faults=[], detected=False, isolated=[], first=[])) == []


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"detected": False, "isolated": [], "first": []}, "not detected"),
        ({"isolated": ["fy_p_ap"], "first": ["fy_p_ap"]}, "should hold fA_du"),
        ({"isolated": ["fA_du", "fA_ori"]}, "should hold fA_du"),
        ({"first": ["fA_du", "fy_p_ap"]}, "should be ranked first, alone"),
        ({"isolated": []}, "should hold fA_du"),
        ({"false_alarms": 1}, "1 false alarms"),
        ({"could_tell": {"t02": 0.9, "t06": 0.5}}, "t06 could tell in 50 % of it only"),
    ],
)
def test_what_was_not_promised_is_said(change: dict[str, object], word: str) -> None:
    [problem] = problems(dataclasses.replace(PERFECT, **change))  # type: ignore[arg-type]
    assert word in problem


def test_a_fault_free_run_in_which_a_test_was_blind_proves_nothing() -> None:
    silent = dataclasses.replace(PERFECT, faults=[], onset_s=None, detected=False, could_tell={"t02": 0.0})
    assert problems(silent) == ["t02 could tell in 0 % of it only"]


def test_a_folder_that_is_not_a_demos_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Such as `out`, which a rig's recordings and truths may be in."""
    mine = tmp_path / "out" / "truth"
    mine.mkdir(parents=True)
    (mine / "mine.toml").write_text("schema = 1\n")
    assert demo.main(["--out", str(tmp_path / "out")]) == 2
    assert "is no demo's folder; name another with --out, or remove it" in capsys.readouterr().err
    assert (mine / "mine.toml").read_text() == "schema = 1\n"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (".", "is the folder you are in, or above it"),
        ("..", "is the folder you are in, or above it"),
        ("../link", "exists and is no demo's folder"),
    ],
)
def test_what_cannot_be_replaced_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], given: str, message: str
) -> None:
    inside = tmp_path / "demo" / "inside"
    inside.mkdir(parents=True)
    (inside / demo.MARKER).touch()
    (inside.parent / demo.MARKER).touch()
    (inside / "file").write_text("kept")
    (inside.parent / "link").symlink_to(inside)
    monkeypatch.chdir(inside)
    assert demo.main(["--out", given]) == 2
    assert message in capsys.readouterr().err
    assert (inside / "file").read_text() == "kept"


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(NotADirectoryError, match=f"'{tmp_path}/file'"):
        demo.main(["--out", str(tmp_path / "file" / "out")])


@pytest.mark.parametrize("speed", ["0", "-1", "inf", "nan"])
def test_a_speed_that_is_none_is_refused_before_anything_is_written(tmp_path: Path, speed: str) -> None:
    with pytest.raises(SystemExit) as caught:
        demo.main(["--out", str(tmp_path / "new"), "--speed", speed])
    assert caught.value.code == 2
    assert not (tmp_path / "new").exists()


class Busy(demo.Demo):
    """A demo on a machine that is late by the given log times [s] in turn."""

    def __init__(self, out: Path, late: list[float]) -> None:
        super().__init__(out, 20.0)
        self.late = late
        self.speeds: list[float] = []
        self._logs = {recording: out / recording.name for recording in RECORDINGS}

    def _play(self, log: Path, bus: str, speed: float) -> float:
        self.speeds.append(speed)
        return self.late.pop(0)

    def _judge(self, recording: object, events: Path | None) -> Verdict:
        return PERFECT


def test_a_replay_that_this_machine_could_not_keep_up_with_is_repeated_slower(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    busy = Busy(tmp_path, [3.0, 0.3, 0.1])
    assert busy._live(RECORDINGS[-1], "nowhere") is PERFECT
    assert busy.speeds == [20.0, 10.0, 5.0]
    assert capsys.readouterr().out.count("not counted: this machine was too busy") == 2


def test_a_machine_that_stays_too_busy_is_no_verdict(tmp_path: Path) -> None:
    with pytest.raises(demo.DemoError, match=r"more than 0\.2 s of log time late 3 times; stop what else runs here"):
        Busy(tmp_path, [3.0, 2.0, 1.0])._live(RECORDINGS[-1], "nowhere")

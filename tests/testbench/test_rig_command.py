"""`faultline rig`: what it prints, and one line with exit code 2 for whatever is wrong."""

import json
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import pytest

from faultline.testbench.command import main
from faultline.testbench.faults import FAULTS

SHORT = ["record", "--cycle", "validation", "--duration", "60"]


def where(folder: Path) -> list[str]:
    return ["--out", str(folder / "recordings"), "--truth", str(folder / "truth")]


def test_record_says_where(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fault = ["--fault", "fA_t", "--size", "0.65", "--onset", "45"]
    assert main([*SHORT, *where(tmp_path), *fault, "--seed", "7"]) == 0
    out = capsys.readouterr().out
    name = "bench-validation-s7-fA_t"
    assert str(tmp_path / "recordings" / name) in out
    assert str(tmp_path / "truth" / f"{name}.toml") in out
    assert (tmp_path / "recordings" / name / "recording.toml").is_file()


def test_list_names_everything(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    text = capsys.readouterr().out
    assert main(["list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert set(listed["faults"]) == set(FAULTS)
    assert set(listed["cycles"]) == {"training", "validation", "maximum", "drive", "excite"}
    for name in (*listed["faults"], *listed["cycles"], *listed["vehicles"]):
        assert name in text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--cycle", "nowhere"], "training, validation, maximum, drive, excite"),
        (["--vehicle", "bicycle"], "bench"),
        (["--fault", "fA_du"], "belong together"),
        (["--size", "0.5"], "belong together"),
        (["--fault", "fA_zz", "--size", "0.5", "--onset", "20"], "fA_t, fA_p"),
        (["--fault", "fA_du", "--size", "1.5", "--onset", "20"], "fraction of the area lost"),
        (["--fault", "fy_p_du", "--size", "1e9", "--onset", "20"], "Pa"),
        (["--fault", "fA_du", "--size", "0.5", "--onset", "60"], "onset 60 s"),
        (["--duration", "20"], "at least 60"),
        (["--dbc", "missing.dbc"], "missing.dbc: No such file"),
    ],
)
def test_wrong_use_is_one_line_and_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    assert main([*SHORT, *where(tmp_path), *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("faultline rig: error: ")
    assert error.count("\n") == 1
    assert said in error
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("arguments", [["--size", "nan"], ["--seed", "-1"], ["--id", "../x"], ["--onset", "soon"]])
def test_malformed_values_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main([*SHORT, *where(tmp_path), *arguments])
    assert stopped.value.code == 2
    assert repr(arguments[1]) in capsys.readouterr().err


@pytest.mark.parametrize("truth", ["recordings", "recordings/bench-validation-s0", "recordings/bench-validation-s0/t"])
def test_truth_may_not_lie_with_the_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str], truth: str) -> None:
    assert main([*SHORT, "--out", str(tmp_path / "recordings"), "--truth", str(tmp_path / truth)]) == 2
    assert "--truth" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text.replace("VERSION", "no DBC"), "is not a DBC file"),
        (lambda text: text.replace("UDS_ECU", "OTHER"), "has no message UDS_ECU"),
        (lambda text: text.replace("dc_dose", "dose"), "dc_dose"),
        (lambda text: text.replace("BO_ 2566852669 200;", "BO_ 2566852669 0;"), "cycle time"),
    ],
)
def test_unfit_dbc_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: Callable[[str], str], said: str
) -> None:
    path = tmp_path / "other.dbc"
    path.write_text(change((resources.files("faultline.dbc") / "uds.dbc").read_text()))
    assert main([*SHORT, *where(tmp_path), "--dbc", str(path)]) == 2
    error = capsys.readouterr().err
    assert str(path) in error
    assert said in error
    assert error.count("\n") == 1


def test_unwritable_folder_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(NotADirectoryError, match=f"'{tmp_path}/file'"):
        main([*SHORT, "--out", str(tmp_path / "file"), "--truth", str(tmp_path / "truth")])

"""`faultline convert`: all frames in each format, and what a format cannot hold is said."""

import json
import sys
from pathlib import Path

import pytest

from faultline.service import convert
from faultline.service.core.errors import InputError
from faultline.service.logs import Log, open_any
from faultline.service.logs.batch import ERROR, EXTENDED, FD, REMOTE, SENT, joined
from faultline.service.logs.writers import TARGETS

LOG = """\
(1700000000.000001) can0 18FF103D#0011223344556677
(1700000000.500002) can1 123#AB T
(1700000001.000003) can0 123##1000102030405060708090A0B
(1700000001.500004) can1 00000124#R4
(1700000002.000005) can0 20000000#0000000000000000
(1700000002.500006) can0 124#
"""
BASE = ("asc", "blf", "candump", "csv", "db", "trc")


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "drive.log"
    path.write_text(LOG)
    return path


@pytest.mark.parametrize("name", BASE)
def test_all_frames_come_back(log: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    out = log.with_name(f"other{TARGETS[name].ending}")
    assert convert.main([str(log), "--to", name, "--out", str(out), "--json"]) == 0
    said = capsys.readouterr()
    document = json.loads(said.out)
    assert (document["frames"], document["remote"], document["errors"]) == (4, 1, 1)
    assert document["not_read"] == []
    for each in document["not_kept"]:
        assert f"faultline convert: {log}: {each}\n" in said.err
    one, other = (joined(list(open_any(path).batches())) for path in (log, out))
    data = one.has_data
    assert other.identifier[data].tolist() == one.identifier[data].tolist()
    assert other.data[data].tolist() == one.data[data].tolist()
    assert other.length[data].tolist() == one.length[data].tolist()
    kept = TARGETS[name].flags & (FD | REMOTE | ERROR | SENT)
    assert (other.flags & kept).tolist() == (one.flags & kept).tolist()
    assert (other.flags & EXTENDED)[data].tolist() == (one.flags & EXTENDED)[data].tolist()
    assert (other.time - other.time[0]).tolist() == pytest.approx((one.time - one.time[0]).tolist(), abs=2e-6)
    if TARGETS[name].has_channels:
        assert other.channel.tolist() == one.channel.tolist()


def test_what_a_format_cannot_hold_is_said(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log.write_text(LOG.replace("00.000001", "00.000001500"))
    convert.main([str(log), "--to", "asc", "--out", str(log.with_suffix(".asc"))])
    convert.main([str(log), "--to", "csv", "--out", str(log.with_suffix(".csv"))])
    said = capsys.readouterr().err
    assert "asc numbers channels: can0 is 1, can1 is 2" in said
    assert "asc counts times from the first frame, which was at 1700000000.0000" in said
    assert "csv has no channels: can0, can1 are not kept" in said
    assert "csv does not say which frames the logger sent: 1 are marked no longer" in said


def test_progress_is_shown_on_a_terminal_only(
    log: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    command = [str(log), "--to", "candump", "--out", str(log.with_suffix(".txt"))]
    assert convert.main(command) == 0
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert convert.main(command) == 0
    clear = "\r\x1b[K"
    said = [f"reading {log}", "looking what it holds: 0 of 6 frames", "writing: 0 of 6 frames", "reading it back"]
    assert capsys.readouterr().err == "".join(f"{clear}faultline convert: {each}" for each in said) + clear


def test_the_line_of_progress_is_gone_before_an_error(
    log: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with pytest.raises(InputError):
        convert.main([str(log.with_name("absent.log")), "--to", "asc"])
    assert capsys.readouterr().err.endswith("absent.log\r\x1b[K")


def test_damage_is_said_and_the_rest_is_written(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log.write_text(LOG + "?\n" + LOG)
    assert convert.main([str(log), "--to", "blf", "--out", str(log.with_suffix(".blf"))]) == 0
    assert "1 lines could not be read (line 7: no candump line: '?')" in capsys.readouterr().err
    assert open_any(log.with_suffix(".blf")).report.frames == 8


def test_one_channel(log: Path) -> None:
    convert.main([str(log), "--to", "candump", "--out", str(log.with_name("one.log")), "--channel", "can1"])
    text = "(1700000000.500002) can1 123#AB T\n(1700000001.500004) can1 00000124#R4\n"
    assert log.with_name("one.log").read_text() == text


def test_a_log_is_not_written_over_itself(log: Path) -> None:
    with pytest.raises(InputError, match="is the log itself; give another file with --out"):
        convert.main([str(log), "--to", "candump", "--out", str(log)])
    assert log.read_text() == LOG


def test_without_times_some_formats_take_it(tmp_path: Path) -> None:
    path = tmp_path / "drive.txt"
    path.write_text("  can0  123   [2]  00 11\n  can0  124   [4]  remote request\n" * 9)
    with pytest.raises(
        InputError, match="its frames have no times, and blf needs them; convert it to candump, parquet"
    ):
        convert.main([str(path), "--to", "blf", "--out", str(tmp_path / "x.blf")])
    convert.main([str(path), "--to", "candump", "--out", str(tmp_path / "x.log")])
    found = open_any(tmp_path / "x.log")
    assert (found.report.frames, found.report.remote, found.format.has_times) == (9, 9, False)


def test_what_is_not_read_back_is_not_kept(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forgets(_log: Log, path: Path) -> None:
        path.write_text("".join(LOG.splitlines(keepends=True)[:3]))

    monkeypatch.setitem(TARGETS, "candump", TARGETS["candump"]._replace(write=forgets))
    out = log.with_name("other.log")
    with pytest.raises(
        InputError, match=r"\(4, 1, 1\) data, remote and error frames were written, \(3, 0, 0\) are read"
    ):
        convert.main([str(log), "--to", "candump", "--out", str(out)])
    assert not out.exists()


def test_it_needs_a_file(log: Path) -> None:
    with pytest.raises(InputError, match="--out -: a converted log is read back"):
        convert.main([str(log), "--to", "asc", "--out", "-"])

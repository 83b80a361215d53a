"""Logs in the formats that python-can reads, by round trips through its writers."""

from pathlib import Path

import can
import pytest

from faultline.service.logs import Frame, LogError, open_log, read_log

START = 1_767_225_600.0
FRAMES = [
    Frame(START + 0.01 * k, 0x18FF103D if k % 3 else 0x123, bool(k % 3), bytes([k % 256] * (k % 9))) for k in range(500)
]


def write(path: Path, frames: list[Frame] = FRAMES) -> Path:
    with can.Logger(path) as logger:
        for frame in frames:
            logger(
                can.Message(
                    timestamp=frame.t, arbitration_id=frame.can_id, is_extended_id=frame.is_extended, data=frame.data
                )
            )
    return path


@pytest.mark.parametrize("ending", [".asc", ".blf", ".csv", ".db", ".log", ".trc"])
def test_every_format_gives_the_same_frames(tmp_path: Path, ending: str) -> None:
    frames, report = read_log(write(tmp_path / f"drive{ending}"))
    assert report.frames == len(frames) == len(FRAMES)
    assert not report.lost
    assert [frame[1:] for frame in frames] == [frame[1:] for frame in FRAMES]
    first, start = frames[0].t, FRAMES[0].t
    for found, wanted in zip(frames, FRAMES, strict=True):
        assert found.t - first == pytest.approx(wanted.t - start, abs=2e-4)  # TRC has tenths of a millisecond


def test_a_command_takes_it(tmp_path: Path) -> None:
    log = open_log(write(tmp_path / "drive.blf"))
    assert (log.id, len(list(log.frames()))) == ("drive", len(FRAMES))


def test_remote_and_error_frames_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "drive.asc"
    with can.Logger(path) as logger:
        logger(can.Message(timestamp=1.0, arbitration_id=1, is_remote_frame=True, is_extended_id=False))
        logger(can.Message(timestamp=2.0, is_error_frame=True))
        logger(can.Message(timestamp=3.0, arbitration_id=2, data=b"\1", is_extended_id=False))
    frames, report = read_log(path)
    assert [frame.can_id for frame in frames] == [2]
    assert (report.remote, report.errors) == (1, 1)


def test_a_bad_row_costs_only_itself(tmp_path: Path) -> None:
    path = write(tmp_path / "drive.csv")
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:101], "1767225602.0,zz,yes", *lines[101:]]))
    frames, report = read_log(path)
    assert len(frames) == report.frames == len(FRAMES)
    assert report.damaged
    assert "line 102: no row of a log: '1767225602.0,zz,yes'" in report.summary()


@pytest.mark.parametrize("ending", [".asc", ".blf", ".csv", ".db", ".trc"])
@pytest.mark.parametrize("content", [b"", b"no log at all\n", b"\x00\xff" * 300])
def test_what_is_no_log_is_refused_with_its_name(tmp_path: Path, ending: str, content: bytes) -> None:
    path = tmp_path / f"drive{ending}"
    path.write_bytes(content)
    with pytest.raises(LogError, match=rf"^{path}: no frame could be read \(.*is it really a {ending[1:].upper()} log"):
        read_log(path)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"none\.blf: cannot be read: No such file or directory"):
        read_log(tmp_path / "none.blf")

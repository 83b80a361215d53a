"""A log is read anew for each pass, in memory that does not grow with it."""

import os
import sys
import threading
from pathlib import Path
from subprocess import run

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from faultline.service.logs import LogError, open_any, open_log, reading
from faultline.service.logs.batch import ERROR, batch_of, joined
from faultline.service.logs.order import STEP_AHEAD_S, STEP_BACK_S, Ordering, without_outliers
from faultline.service.logs.report import Frame, LogReport


def written(path: Path, count: int, channel: str = "can0") -> Path:
    with path.open("w") as file:
        for k in range(count):
            file.write(f"({1700000000 + k / 455:.6f}) {channel} 18FF{k % 50:02X}3D#00112233{k % 2**32:08X}\n")
    return path


def test_passes_give_the_same_whether_batches_are_kept_or_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "x.log", 30_000)
    kept = open_log(path)
    monkeypatch.setattr(reading, "KEPT", 0)
    again = open_log(path)
    assert kept.kept is not None
    assert again.kept is None
    assert list(kept.frames()) == list(again.frames()) == list(again.frames())
    assert kept.report == again.report
    assert kept.sha256 == again.sha256
    assert next(again.relative()).t == 0.0


MEMORY = """
import resource, sys
from pathlib import Path
from faultline.service.logs import open_any
log = open_any(Path(sys.argv[1]))
count = sum(len(batch) for batch in log.batches())
print(count, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def test_memory_does_not_grow_with_the_log(tmp_path: Path) -> None:
    """Of ten minutes of a real truck's traffic, and of a log some four times as long."""
    peaks = []
    for count in (273_000, 1_200_000):
        path = written(tmp_path / "x.log", count)
        done = run([sys.executable, "-c", MEMORY, path], capture_output=True, text=True, check=True)
        read, peak = map(int, done.stdout.split())
        assert read == count
        peaks.append(peak)
    assert peaks[1] <= 1.1 * peaks[0], peaks


def test_a_pipe_is_copied_as_it_is_read_more_than_once(tmp_path: Path) -> None:
    content = written(tmp_path / "x.log", 100).read_bytes()
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_bytes, args=[content])
    writer.start()
    found = open_any(pipe)
    writer.join()
    assert found.report.frames == len(list(found.frames())) == 100
    assert found.sha256 == open_any(tmp_path / "x.log").sha256


def test_one_channel_of_a_log(tmp_path: Path) -> None:
    path = tmp_path / "x.log"
    path.write_text("(1.0) can0 123#00\n(1.5) can1 123#01\n(2.0) can0 124#02\n(2.5) can1 123#03\n")
    found = open_log(path, "can1")
    assert [frame.data[0] for frame in found.frames()] == [1, 3]
    assert (found.start_s, found.report.length_s, found.report.frames) == (1.5, 1.0, 2)
    assert found.report.channels == {"can0": {(0x123, False), (0x124, False)}, "can1": {(0x123, False)}}
    with pytest.raises(LogError, match="has no frame of channel can2; it has can0, can1"):
        open_log(path, "can2")


def one_by_one(times: list[float]) -> tuple[list[float], int]:
    """The rule, frame by frame."""
    found, steps, shift, last = [], 0, 0.0, times[0]
    for each in times:
        t = each + shift
        if not -STEP_BACK_S <= t - last <= STEP_AHEAD_S:
            steps += 1
            shift += last - t
            t = last
        last = max(t, last)
        found.append(last)
    return found, steps


TIMES = st.lists(
    st.one_of(st.floats(0, 10), st.floats(0, 1e5), st.floats(-1e9, 2e9), st.sampled_from([0.0, 1.0, 3600.0, 3601.0])),
    min_size=1,
    max_size=300,
)


@given(TIMES, st.integers(1, 50), st.data())
def test_order_by_arrays_is_order_frame_by_frame(times: list[float], size: int, data: st.DataObject) -> None:
    report = LogReport()
    ordering = Ordering(report)
    batch = batch_of([Frame(t, 1, False, b"") for t in times])
    parts = [ordering.ordered(batch[slice(k, k + size)]) for k in range(0, len(times), size)]
    assert (joined(parts).time.tolist(), report.clock_steps) == one_by_one(times)


def test_error_frames_never_move_the_clock() -> None:
    report = LogReport()
    batch = batch_of([Frame(t, 1, False, b"") for t in (5.0, 1e9, 6.0, 7.0, 5.5, 8.0)])
    batch.flags[[0, 1, 4]] = ERROR
    ordered = Ordering(report).ordered(batch)
    assert not report.clock_steps
    assert ordered.time[[2, 3, 5]].tolist() == [6.0, 7.0, 8.0]
    assert ordered.time[4] == 7.0
    assert bool((np.diff(ordered.time[1:]) >= 0).all())


def without(times: list[float], size: int) -> tuple[list[float], int]:
    report = LogReport()
    batch = batch_of([Frame(t, 1, False, b"") for t in times])
    parts = without_outliers([batch[slice(k, k + size)] for k in range(0, len(times), size)], report)
    return joined(list(parts)).time.tolist(), report.outliers


@pytest.mark.parametrize("size", [1, 2, 3, 100])
@pytest.mark.parametrize(
    ("times", "found", "count"),
    [
        ([1, 2, 900, 3, 4], [1, 2, 2, 3, 4], 1),
        ([100, 101, 7, 102], [100, 101, 101, 102], 1),
        ([1, 2, 900, 900, 901, 3], [1, 2, 2, 2, 2, 3], 3),
        ([1, 60, 120, 7000, 180, 240], [1, 60, 120, 120, 180, 240], 1),
        ([1, 2, 900, 901, 902], [1, 2, 900, 901, 902], 0),
        ([10, 11, 2000000, 2000001, 5, 6], [10, 11, 2000000, 2000001, 5, 6], 0),
        ([1, 2, *[900] * 9, 3], [1, 2, *[900] * 9, 3], 0),
        ([1, 2, 900, 3, 4, 901, 5], [1, 2, 2, 3, 4, 4, 5], 2),
    ],
    ids=["ahead", "back", "three", "slow", "a pause", "a clock that was set", "too many", "two"],
)
def test_times_far_from_those_around_them_are_replaced(
    times: list[float], found: list[float], count: int, size: int
) -> None:
    assert without(times, size) == (found, count)


@given(TIMES, st.integers(1, 50))
def test_outliers_are_the_same_in_pieces_of_any_size(times: list[float], size: int) -> None:
    assert without(times, size) == without(times, len(times))


def test_a_damaged_digit_of_a_time_moves_nothing_behind_it(tmp_path: Path) -> None:
    (tmp_path / "x.log").write_text("".join(f"({t}.0) can0 123#00\n" for t in (100, 101, 902, 103, 104)))
    found = open_log(tmp_path / "x.log")
    assert [frame.t for frame in found.frames()] == [100.0, 101.0, 101.0, 103.0, 104.0]
    assert found.report.losses() == ["1 times are far from those around them and were replaced"]
    assert found.report.lost
    (tmp_path / "x.csv").write_text("time,p\n100,1\n101,2\n902,3\n103,4\n")
    assert open_log(tmp_path / "x.csv").report.outliers == 1

"""The candump reader gives every frame that can be read and says what it could not."""

import gzip
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reading import parse_log

from faultline.service.logs import Frame, LogError, read_log

X = Path("x.log")
LINE = b"(1767225600.123456) can0 18FF103D#0011223344556677\n"


def test_reads_both_identifier_lengths_and_can_fd(tmp_path: Path) -> None:
    log = tmp_path / "can.log"
    log.write_bytes(
        LINE + b"(1767225600.200000) can0 123# R\n(1767225601.000000)  vcan1  00000123##1" + b"AB" * 12 + b"\r\n"
    )
    frames, report = read_log(log)
    assert frames == [
        Frame(1767225600.123456, 0x18FF103D, True, bytes.fromhex("0011223344556677")),
        Frame(1767225600.2, 0x123, False, b""),
        Frame(1767225601.0, 0x123, True, b"\xab" * 12),
    ]
    assert not report.lost
    assert report.summary() == "3 frames read, from 0.0 to 0.9 s"
    assert list(report.channels) == ["can0", "vcan1"]


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (b"hello", "no candump line: 'hello'"),
        (b"\0\0\0\0", "no candump line"),
        (b"(1.5) can0 12#00", "no frame after the time"),
        (b"(1.5) can0 123#001", "no frame after the time"),
        (b"(1.5) can0 123#001122334455667788", "no frame after the time"),
        (b"(1.5) can0 FFFFFFFF##000", "identifier FFFFFFFF"),
        (b"(1.5) can0 5FFFFFFF#00", "more than 29 bits"),
        (b"(1.5) can0 123##0" + b"00" * 13, "no CAN FD frame has 13 bytes"),
        (b"(1.5) can0 123##0001", "no CAN FD frame has 1.5 bytes"),
    ],
)
def test_a_bad_line_costs_only_itself(bad: bytes, reason: str) -> None:
    frames, report = parse_log(LINE + bad + b"\n" + LINE, X)
    assert len(frames) == report.frames == 2
    assert (report.bad, report.lost) == (1, True)
    number, told = report.places[0]
    assert number == 2
    assert reason in told
    assert f"1 lines could not be read (line 2: {told})" in report.summary()


def test_only_the_first_bad_lines_are_told() -> None:
    _, report = parse_log(LINE + b"?\n" * 5, X)
    assert (report.bad, [number for number, _ in report.places]) == (5, [2, 3, 4])
    assert report.summary().endswith("; ...)")


@pytest.mark.parametrize("cut", range(1, len(LINE)))
def test_a_line_cut_anywhere_is_counted_and_not_used(cut: int) -> None:
    frames, report = parse_log(LINE + LINE[:cut], X)
    assert len(frames) == 1
    assert report.truncated
    assert report.lost
    assert not report.damaged  # nothing in the file says that more follows
    assert "the last line is cut off" in report.summary()


def test_remote_and_error_frames_are_skipped_and_counted() -> None:
    frames, report = parse_log(b"(1.0) can0 123#R8\n(1.0) can0 20000004#0000000000000000\n" + LINE, X)
    assert (len(frames), report.remote, report.errors) == (1, 1, 1)
    assert not report.lost
    assert report.summary() == "1 frames read, from 0.0 to 0.0 s, 1 remote and 1 error frames skipped"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"\n  \n", "is empty"),
        (b"time,y_p_ap\n0,1\n", "line 1: not a CAN log, no candump line: 'time,y_p_ap'"),
        (b"\x7fELF\x02\n\xff\xfe\n", "line 1: not a CAN log"),
        (LINE[:-1], "line 1: its only line is cut off"),
        (b"(1.0) can0 123#R\n", "holds no data frame"),
    ],
)
def test_what_is_no_log_is_refused_with_an_example(tmp_path: Path, content: bytes, words: str) -> None:
    log = tmp_path / "x.log"
    log.write_bytes(content)
    with pytest.raises(LogError) as caught:
        read_log(log)
    message = str(caught.value)
    assert message.startswith(f"{log}: ")
    assert words in message
    assert "(1767225600.123456) can0 18FF103D#0011223344556677" in message
    assert "\n" not in message


@pytest.mark.parametrize("name", ["absent.log", "."])
def test_what_cannot_be_opened_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(LogError, match="cannot be read"):
        read_log(tmp_path / name)


def _times(*times: float) -> tuple[list[float], int]:
    lines = b"".join(b"(%.6f) can0 123#00\n" % t for t in times)
    frames, report = parse_log(lines, X)
    return [round(frame.t, 6) for frame in frames], report.clock_steps


def test_time_never_goes_back() -> None:
    assert _times(100.0, 100.5, 100.4, 100.6) == ([100.0, 100.5, 100.5, 100.6], 0)


def test_a_clock_that_was_set_does_not_tear_the_log_apart() -> None:
    """A vehicle without a clock starts in 1970 and jumps: nobody must wait for fifty years of ticks."""
    assert _times(10.0, 11.0, 1767225600.0, 1767225601.0, 5.0, 6.0) == ([10.0, 11.0, 11.0, 12.0, 12.0, 13.0], 2)
    assert (
        "the clock was set 1 times" in parse_log(b"(9.0) can0 1#\n(9.0) can0 123#\n(2.0) can0 123#\n", X)[1].summary()
    )


@given(st.lists(st.binary(max_size=60).filter(lambda line: b"\n" not in line), max_size=20))
def test_no_content_breaks_the_reader(lines: list[bytes]) -> None:
    content = LINE + b"\n".join([*lines, b""])
    frames, report = parse_log(content, X)
    used = report.frames + report.bad + report.remote + report.errors
    assert frames[0].can_id == 0x18FF103D
    assert used + sum(not line.strip() or line.strip().startswith(b"#") for line in lines) == len(lines) + 1


def test_a_remark_is_no_damage() -> None:
    frames, report = parse_log(b"# Tuesday, second gear\n" + LINE + b"  # stopped\n" + LINE, X)
    assert len(frames) == 2
    assert not report.lost


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("ending", ["", ".gz"])
def test_text_of_windows_shell_is_read(tmp_path: Path, encoding: str, ending: str) -> None:
    text = "" if encoding == "utf-16" else "\ufeff"
    raw = (text + "".join(f"({k}.0) can0 123#{k % 256:02X}\n" for k in range(30_000))).encode(encoding)
    path = tmp_path / f"x.log{ending}"
    path.write_bytes(gzip.compress(raw) if ending else raw)
    frames, report = read_log(path)
    assert [frame.t for frame in frames] == [float(k) for k in range(30_000)]
    assert not report.lost


@given(
    st.lists(
        st.tuples(
            st.integers(0, 10**9),
            st.booleans(),
            st.integers(0, 0x7FF),
            st.sampled_from([0, 1, 7, 8, 12, 64]),
            st.binary(min_size=64, max_size=64),
        ),
        min_size=1,
        max_size=20,
    )
)
def test_gives_back_what_was_written(rows: list[tuple[int, bool, int, int, bytes]]) -> None:
    text = b""
    expected = []
    for step, (stamp, extended, can_id, size, data) in enumerate(rows):
        t = 1000 + step + stamp % 1000 / 1000
        name = b"%08X" % can_id if extended else b"%03X" % can_id
        mark = b"##0" if size > 8 else b"#"
        text += b"(%.6f) can0 %s%s%s\n" % (t, name, mark, data[:size].hex().upper().encode())
        expected.append((can_id, extended, data[:size]))
    frames, report = parse_log(text, X)
    assert [tuple(frame[1:]) for frame in frames] == expected
    assert not report.lost

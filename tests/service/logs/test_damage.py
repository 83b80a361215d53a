"""A log that is cut off or damaged, in every format: the same frames, or a report of what was lost; never silence."""

import random
import sqlite3
import struct
import time
import tracemalloc
import zlib
from pathlib import Path

import can
import pytest
from reading import parse_log

from faultline.service.logs import Frame, LogError, LogReport, read_log

START = 1_767_225_600.0
IDS = ((0x18FF103D, True), (0x0CF00400, True), (0x123, False))
FRAMES = [
    Frame(START + 0.01 * k, *IDS[k % 3], random.Random(k).randbytes(0 if k % 7 == 3 else 8))  # noqa: S311
    for k in range(400)
]
TEXTS = ("log", "asc", "csv", "trc")
MOST_S = 2.0


def written(folder: Path, ending: str, frames: list[Frame] = FRAMES, **options: int) -> bytes:
    """What python-can writes."""
    path = folder / f"whole.{ending}"
    path.unlink(missing_ok=True)
    with can.Logger(path, **options) as logger:
        for frame in frames:
            logger(
                can.Message(
                    timestamp=frame.t,
                    arbitration_id=frame.can_id,
                    is_extended_id=frame.is_extended,
                    data=frame.data,
                    channel=0 if ending != "log" else "can0",
                )
            )
    return path.read_bytes()


def read(content: bytes, ending: str) -> tuple[list[Frame], LogReport] | None:
    """What was read, in bounded time; None where it was refused."""
    began = time.process_time()
    try:
        return parse_log(content, Path(f"x.{ending}"))
    except LogError:
        return None
    finally:
        assert time.process_time() - began < MOST_S


def essence(frames: list[Frame]) -> list[tuple[float, int, bool, bytes]]:
    """Of frames, with times after the first."""
    return [(round(frame.t - frames[0].t, 4), *frame[1:]) for frame in frames]


@pytest.mark.parametrize("ending", [*TEXTS, "blf", "db"])
def test_a_log_cut_anywhere_is_never_silently_short(tmp_path: Path, ending: str) -> None:
    whole = written(tmp_path, ending)
    found = read(whole, ending)
    assert found is not None
    wanted = essence(found[0])
    assert (len(wanted), found[1].lost) == (len(FRAMES), False)
    cuts = random.Random(1).sample(range(1, len(whole)), 300)  # noqa: S311
    used = 0
    for cut in cuts:
        found = read(whole[:cut], ending)
        if found is None:
            continue
        used += 1
        frames, report = found
        assert essence(frames) == wanted[: len(frames)], cut
        assert report.lost or len(frames) == len(wanted) or is_between(whole, cut, ending), (cut, report.summary())
        if ending in ("asc", "blf", "db", "trc") and len(frames) < len(wanted):
            assert report.damaged or is_between(whole, cut, ending), (cut, report.summary())
    assert used > 100


def is_between(whole: bytes, cut: int, ending: str) -> bool:
    """True if the cut is between two lines of a file that says nothing about its length."""
    return ending in ("log", "csv", "trc") and (
        whole[cut - 1 : cut] == b"\n" or whole[cut:].lstrip(b" \r")[:1] == b"\n"
    )


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("ending", [*TEXTS, "blf"])
def test_damaged_bytes_are_reported(tmp_path: Path, ending: str, seed: int) -> None:
    """Bytes that no text has; in a BLF any, as its containers have checksums."""
    whole = written(tmp_path, ending)
    wanted = essence(FRAMES) if ending != "trc" else essence(parse_log(whole, Path("x.trc"))[0])
    chance = random.Random(seed)  # noqa: S311
    for _ in range(100):
        at, length = chance.randrange(len(whole)), chance.randint(1, 8)
        damage = chance.randbytes(length) if ending == "blf" else chance.choice([b"?", b"\0", b"\xff"]) * length
        found = read(whole[:at] + damage + whole[at + length :], ending)
        if found is not None:
            frames, report = found
            assert report.lost or essence(frames) == wanted, (seed, at, damage, report.summary())


@pytest.mark.parametrize("seed", range(3))
def test_damaged_databases_and_stored_containers_lose_no_frame_in_silence(tmp_path: Path, seed: int) -> None:
    """They have no checksums of their contents: a byte of data may change, but no frame is gone unnoticed."""
    chance = random.Random(seed)  # noqa: S311
    for ending, whole in (("db", written(tmp_path, "db")), ("blf", written(tmp_path, "blf", compression_level=0))):
        for _ in range(100):
            at, length = chance.randrange(len(whole)), chance.randint(1, 8)
            found = read(whole[:at] + chance.randbytes(length) + whole[at + length :], ending)
            if found is not None:
                frames, report = found
                skipped = report.remote + report.errors + report.others  # a flag or a kind may change
                assert report.lost or len(frames) + skipped == len(FRAMES), (seed, ending, at, report.summary())


def many(tmp_path: Path) -> bytes:
    """A BLF file of five containers."""
    frames = [FRAMES[k % len(FRAMES)]._replace(t=START + 0.01 * k) for k in range(12_000)]
    return written(tmp_path, "blf", frames)


def containers(whole: bytes) -> list[int]:
    """Where each begins."""
    found, at = [], whole.find(b"LOBJ")
    while at >= 0:
        found.append(at)
        at = whole.find(b"LOBJ", at + 4)
    return found


def test_reading_goes_on_behind_a_damaged_container(tmp_path: Path) -> None:
    whole = many(tmp_path)
    first, second, third, *_ = containers(whole)
    assert first < second < third
    middle = (second + third) // 2
    frames, report = parse_log(whole[:middle] + b"\0\0\0\0" + whole[middle + 4 :], Path("x.blf"))
    assert report.damaged
    assert 0.6 * 12_000 < len(frames) < 0.9 * 12_000
    assert frames[-1].t == pytest.approx(START + 119.99)
    assert f"byte {second}: a container is damaged" in report.summary()
    assert "the end is missing: its header counts 12000 objects" in report.summary()


def test_a_damaged_object_costs_only_itself(tmp_path: Path) -> None:
    whole = bytearray(written(tmp_path, "blf", compression_level=0))
    tenth = containers(bytes(whole))[10]  # the first is the container
    struct.pack_into("<L", whole, tenth + 8, 4800)
    frames, report = parse_log(bytes(whole), Path("x.blf"))
    assert len(frames) == len(FRAMES) - 1
    assert "an object says 4800 bytes, 32 of them header" in report.summary()


@pytest.mark.parametrize("size", [0, 1, 15, 0xFFFF_FFFF])
@pytest.mark.parametrize("level", [0, 6])
def test_an_object_of_no_size_does_not_hold_the_reader_up(tmp_path: Path, size: int, level: int) -> None:
    whole = written(tmp_path, "blf", compression_level=0)
    container = containers(whole)[0]
    inner = bytearray(whole[container + 32 :])
    struct.pack_into("<L", inner, 48 * 3 + 8, size)
    body = zlib.compress(inner, level) if level else bytes(inner)
    head = struct.pack("<4sHHLLH14x", b"LOBJ", 16, 1, 32 + len(body), 10, 2 if level else 0)
    tracemalloc.start()
    began = time.process_time()
    frames, report = parse_log(whole[:container] + head + body, Path("x.blf"))
    assert time.process_time() - began < MOST_S
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()
    assert report.damaged
    assert len(frames) >= len(FRAMES) - 2


def test_a_container_that_unpacks_without_end_is_refused_in_bounded_memory(tmp_path: Path) -> None:
    whole = written(tmp_path, "blf")
    bomb = zlib.compressobj()
    body = b"".join([*(bomb.compress(bytes(1 << 20)) for _ in range(500)), bomb.flush()])
    head = struct.pack("<4sHHLLH14x", b"LOBJ", 16, 1, 32 + len(body), 10, 2)
    tracemalloc.start()
    frames, report = parse_log(whole + head + body, Path("x.blf"))
    assert tracemalloc.get_traced_memory()[1] < 80e6
    tracemalloc.stop()
    assert len(frames) == len(FRAMES)
    assert report.damaged


def test_many_small_containers_of_one_object_take_no_longer_than_their_bytes() -> None:
    begin = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 1 << 20, 65)  # of an object of 1 MiB
    parts = [begin, *(b"\0" for _ in range(100_000))]
    body = b"".join(struct.pack("<4sHHLLH14x", b"LOBJ", 16, 1, 32 + len(part), 10, 0) + part for part in parts)
    head = struct.pack("<4sL8xQQLL32x", b"LOGG", 72, 72 + len(body), 0, 1, 0)
    began = time.process_time()
    with pytest.raises(LogError, match="its header counts 1 objects, it has 0"):
        parse_log(head + body, Path("x.blf"))
    assert time.process_time() - began < MOST_S


def test_a_blf_that_its_logger_did_not_close(tmp_path: Path) -> None:
    whole = bytearray(written(tmp_path, "blf"))
    whole[16:72] = struct.pack("<QQLL32x", 144, 144, 0, 0)  # as written at the start
    frames, report = parse_log(bytes(whole), Path("x.blf"))
    assert len(frames) == len(FRAMES)
    assert report.missing == "its logger did not close it"


def test_a_blf_says_how_long_it_should_be(tmp_path: Path) -> None:
    whole = many(tmp_path)
    _, report = parse_log(whole[: len(whole) * 35 // 100], Path("x.blf"))
    assert report.said_s == pytest.approx(119.99)
    assert 20 < report.length_s < 60
    assert report.span == f"0.0 to {report.length_s:.1f} s of 120.0 s"


VECTOR = b"""date Wed Apr 16 09:21:13.159 am 2025
base hex  timestamps absolute
internal events logged
// version 13.0.0
Begin TriggerBlock Wed Apr 16 09:21:13.159 am 2025
   0.000000 Start of measurement
   0.005000 CAN  1 Status:chip status error active
   0.010000 1  18FF103Dx       Rx   d 8 00 11 22 33 44 55 66 77  Length = 273910 BitCount = 141 ID = 419369021x
   0.015000 1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 0.0%
   0.020000 2  123             Tx   d 2 AB CD  Length = 130000 BitCount = 67 ID = 291
   0.021000 2  123             TxRq d 2 AB CD
   0.030000 1  200             Rx   r
   0.040000 1  ErrorFrame      ECC: 10100010
   0.050000 SV: 2 0 1 ::Speed = 12
   0.060000 CANFD   1 Rx   456x  Engine_Data  1 0 9 12 00 01 02 03 04 05 06 07 08 09 0a 0b 107000 140 303000 a00 0 0
   0.070000 1  J1939TP FEE3p 6 0 0 - Rx d 23 A0 0F A6 60 3B D1
   0.080000 log trigger event
End TriggerBlock
"""


def test_an_asc_as_vector_writes_it() -> None:
    frames, report = parse_log(VECTOR, Path("x.asc"))
    assert frames == [
        Frame(0.01, 0x18FF103D, True, bytes.fromhex("0011223344556677")),
        Frame(0.02, 0x123, False, b"\xab\xcd"),
        Frame(0.06, 0x456, True, bytes(range(12))),
    ]
    assert not report.lost
    assert (report.remote, report.errors) == (1, 1)
    assert list(report.channels) == ["1", "2"]


def test_an_asc_of_decimal_numbers_and_relative_times() -> None:
    content = (
        b"base dec  timestamps relative\n0.5 1 291 Rx d 2 255 16\n0.25 1 291 Rx d 2 1 2\n0.25 1 300 Rx d 2 1 256\n"
    )
    frames, report = parse_log(content, Path("x.asc"))
    assert frames == [Frame(0.5, 291, False, b"\xff\x10"), Frame(0.75, 291, False, b"\1\2")]
    assert report.bad == 1


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"   0.010000 1  18FF103Dx Rx d 8 00 11 22 33 44", "says 8 bytes and has 5"),
        (b"   0.010000 1  18FF103Dx Rx d 2 00 11 22", "says 2 bytes and has 3"),
        (b"   0.010000 1  18F?103Dx Rx d 2 00 11", "no frame nor event"),
        (b"   0.010000 1  18FF103Dx ?x d 2 00 11", "no frame nor event"),
        (b"   0.010000    CF0233Dx Rx d 2 00 11", "no frame nor event"),
        (b"   0.010000 CANFD 1 Rx 456x 1 0 9 12 00 01", "says 12 bytes and has 2"),
        (b"   0.010000 1  FFFFFFFFx Rx d 2 00 11", "more than 29 bits"),
        (b"   0.010000 1  800 Rx d 2 00 11", "more than 11 bits"),
        (b"   0.0?0000 1  18FF103Dx Rx d 2 00 11", "no frame nor event"),
    ],
)
def test_a_bad_line_of_asc_is_counted_and_costs_only_itself(line: bytes, reason: str) -> None:
    good = b"0.010000 1  123 Rx d 1 00\n"
    frames, report = parse_log(good + line + b"\n" + good, Path("x.asc"))
    assert (len(frames), report.bad, report.damaged) == (2, 1, True)
    assert reason in report.places[0][1]


TRC = {
    "1.0": (b"", b"     1)      1841 0123 2 AB CD\n     2)   1842 FFFFFFFF 4 00 00 00 04\n     3) 1843 0123 0 RTR\n"),
    "1.1": (
        b";$FILEVERSION=1.1\n",
        b"1)  1841.3  Rx  0123  2  AB CD\n2) 1842.0 Warng FFFFFFFF 4 00 00 00 08 BUSHEAVY\n",
    ),
    "1.3": (b";$FILEVERSION=1.3\n", b"1)  1841.3 2 Rx  0123 - 2  AB CD\n"),
    "2.0": (
        b";$FILEVERSION=2.0\n;$STARTTIME=43474.4\n;$COLUMNS=N,O,T,I,d,l,D\n",
        b"1  1841.3 DT  0123 Rx 2  AB CD\n2  1842.3 ST     Rx    00 00 00 00\n3 1843.3 RR 0123 Rx 2\n",
    ),
    "2.1": (b";$FILEVERSION=2.1\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n", b"1  1841.3 FD 2 0123 Rx -  2  AB CD\n"),
}


@pytest.mark.parametrize("version", TRC)
def test_every_version_of_trc(version: str) -> None:
    head, lines = TRC[version]
    frames, report = parse_log(head + lines, Path("x.trc"))
    assert [frame[1:] for frame in frames] == [(0x123, False, b"\xab\xcd")]
    assert not report.lost
    frames, report = parse_log(head + lines + lines.replace(b"AB CD", b"AB"), Path("x.trc"))
    assert (len(frames), report.damaged) == (1, True)
    assert "says 2 bytes and has 1" in report.summary()


def test_a_trc_of_an_unknown_version_is_refused() -> None:
    with pytest.raises(LogError, match=r"x\.trc: TRC version 9\.9 is not known; save it as 2\.1"):
        parse_log(b";$FILEVERSION=9.9\n" + TRC["2.1"][1], Path("x.trc"))


PAGE = 4096
COLUMNS = "ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER, error INTEGER, dlc INTEGER, data BLOB"


def database(folder: Path) -> tuple[bytearray, list[Frame]]:
    """As python-can's, of 5,000 rows in 40 leaf pages; the second page is the table's root."""
    frames = [FRAMES[k % len(FRAMES)]._replace(t=START + k) for k in range(5000)]
    path = folder / "rows.db"
    with sqlite3.connect(path) as connection:
        connection.execute(f"CREATE TABLE messages ({COLUMNS})")
        rows = [(t, number, is_extended, 0, 0, len(data), data) for t, number, is_extended, data in frames]
        connection.executemany("INSERT INTO messages VALUES (?, ?, ?, ?, ?, ?, ?)", rows)
    return bytearray(path.read_bytes()), frames


def said_of(report: LogReport) -> str:
    """The first place, which says how many rows are gone."""
    return f"row {report.places[0][0]}: {report.places[0][1]}"


@pytest.mark.parametrize("damage", [bytes(PAGE), random.Random(1).randbytes(PAGE)], ids=["zeros", "noise"])  # noqa: S311
def test_rows_behind_a_damaged_root_page_are_read_from_the_leaves(tmp_path: Path, damage: bytes) -> None:
    raw, frames = database(tmp_path)
    raw[PAGE : 2 * PAGE] = damage
    found, report = parse_log(bytes(raw), Path("x.db"))
    assert found == frames
    assert report.damaged
    assert "row 5001: how many rows are gone behind row 5000 is not known; the database is damaged" in said_of(report)


def test_rows_of_a_root_page_that_has_lost_most_cells(tmp_path: Path) -> None:
    raw, frames = database(tmp_path)
    struct.pack_into(">H", raw, PAGE + 3, 1)  # cells
    found, report = parse_log(bytes(raw), Path("x.db"))
    assert found == frames
    assert report.damaged


def test_rows_of_a_leaf_page_that_is_gone_are_counted(tmp_path: Path) -> None:
    raw, frames = database(tmp_path)
    raw[9 * PAGE : 10 * PAGE] = bytes(PAGE)
    found, report = parse_log(bytes(raw), Path("x.db"))
    gone = len(frames) - len(found)
    assert 90 < gone < 200
    assert report.bad == gone
    assert f"{gone} rows are not there; the database is damaged" in said_of(report)
    first = report.places[0][0]
    assert found == [*frames[: first - 1], *frames[first - 1 + gone :]]


def test_nobody_knows_how_many_rows_were_behind_a_last_page_that_is_gone(tmp_path: Path) -> None:
    raw, frames = database(tmp_path)
    raw[-PAGE:] = bytes(PAGE)
    found, report = parse_log(bytes(raw), Path("x.db"))
    assert found == frames[: len(found)]
    assert f"row {len(found) + 1}: how many rows are gone behind row {len(found)} is not known" in said_of(report)


def test_a_table_that_numbers_its_rows_says_how_many_there_were(tmp_path: Path) -> None:
    path = tmp_path / "x.db"
    with sqlite3.connect(path) as connection:
        connection.execute(f"CREATE TABLE messages (id INTEGER PRIMARY KEY AUTOINCREMENT, {COLUMNS})")
        row = (
            "INSERT INTO messages (ts, arbitration_id, extended, remote, error, dlc, data) VALUES (?, 1, 0, 0, 0, 1, ?)"
        )
        connection.executemany(row, [(1000.5 + k, b"x") for k in range(2000)])
    raw = bytearray(path.read_bytes())
    tables = [at for at in range(0, len(raw), PAGE) if raw[at] == 0x05]  # an inner page: the root of the large one
    raw[tables[0] : tables[0] + PAGE] = bytes(PAGE)
    with pytest.raises(LogError, match="row 1: 2000 rows are not there; the database is damaged"):
        parse_log(bytes(raw), Path("x.db"))


def test_rows_that_were_deleted_are_not_missed(tmp_path: Path) -> None:
    raw, frames = database(tmp_path)
    path = tmp_path / "x.db"
    path.write_bytes(raw)
    with sqlite3.connect(path) as connection:
        connection.execute("DELETE FROM messages WHERE rowid BETWEEN 1000 AND 3000")
    found, report = parse_log(path.read_bytes(), Path("x.db"))
    assert found == [*frames[:999], *frames[3000:]]
    assert not report.lost


def test_a_database_that_is_cut_off_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    whole = written(tmp_path, "db")
    (tmp_path / "cut.db").write_bytes(whole[: len(whole) * 6 // 10])
    frames, report = read_log(tmp_path / "cut.db")
    assert 0 < len(frames) < len(FRAMES)
    assert report.missing == f"its header says {len(whole)} bytes, it has {len(whole) * 6 // 10}"
    assert list(tmp_path.glob("cut.db*")) == [tmp_path / "cut.db"]

"""Damage of every kind in every format, packed or not: no hang, no crash, the rest is read, losses are counted."""

import gzip
import random
import re
import time
from pathlib import Path

import can
import pytest

from faultline.service.logs import Frame, LogError, open_any
from faultline.service.logs.writers import TARGETS

START = 1_767_225_600.0
IDS = ((0x18FF103D, True), (0x0CF00400, True), (0x123, False))
COUNT = 3000
MOST_S = 5.0
FORMATS = ("candump", "asc", "trc", "csv", "blf", "db")


def frames() -> list[Frame]:
    chance = random.Random(0)  # noqa: S311
    return [Frame(START + 0.01 * k, *IDS[k % 3], chance.randbytes(8)) for k in range(COUNT)]


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """A log of all frames in each format."""
    folder = tmp_path_factory.mktemp("logs")
    first = folder / "first.log"
    first.write_text(
        "".join(f"({f.t:.6f}) can0 {f.can_id:0{8 if f.is_extended else 3}X}#{f.data.hex()}\n" for f in frames())
    )
    log = open_any(first)
    found = {}
    for name in FORMATS:
        path = folder / f"whole{TARGETS[name].ending}"
        TARGETS[name].write(log, path)
        found[name] = path.read_bytes()
    return found


def damaged(raw: bytes, chance: random.Random) -> tuple[bytes, str, int, int]:
    """Some damage, what it is, and where it begins and ends in the new bytes."""
    at, size = chance.randrange(len(raw)), chance.choice([1, 8, 100, 5000])
    match chance.choice(["cut", "flip", "zeros", "garbage", "removed", "random"]):
        case "cut":
            return raw[:at], "cut", at, at
        case "flip":
            return raw[:at] + bytes([raw[at] ^ 1 << chance.randrange(8)]) + raw[at + 1 :], "flip", at, at + 1
        case "zeros":
            return raw[:at] + bytes(min(size, len(raw) - at)) + raw[at + size :], "zeros", at, at + size
        case "garbage":
            return raw[:at] + chance.randbytes(size) + raw[at:], "garbage", at, at + size
        case "removed":
            return raw[:at] + raw[at + size :], "removed", at, at
        case _:
            return raw[:at] + chance.randbytes(min(size, len(raw) - at)) + raw[at + size :], "random", at, at + size


@pytest.mark.parametrize("packed", [False, True], ids=["", "gz"])
@pytest.mark.parametrize("name", FORMATS)
def test_no_damage_is_silent_or_hangs(logs: dict[str, bytes], tmp_path: Path, name: str, packed: bool) -> None:
    raw = gzip.compress(logs[name], 1) if packed else logs[name]
    wanted = {(f.can_id, f.data) for f in frames()}
    path = tmp_path / f"x{TARGETS[name].ending}{'.gz' if packed else ''}"
    for seed in range(40):
        content, what, begin, end = damaged(raw, random.Random(seed))  # noqa: S311
        path.write_bytes(content)
        began = time.process_time()
        try:
            log = open_any(path)
        except LogError as error:
            assert "\n" not in str(error)  # noqa: PT017
            continue
        finally:
            assert time.process_time() - began < MOST_S, (seed, what)
        report = log.report
        right = sum((f.can_id, f.data) in wanted for f in log.frames())
        place = (seed, what, begin, end, report.summary())
        if right < COUNT:
            between = name in ("candump", "csv", "trc") and not packed  # two lines may be where a cut is
            between |= name == "db" and report.frames == COUNT  # it has no checksums: a frame's data may be others
            assert report.lost or report.remote or report.errors or what in ("flip", "random") or between, place
        if not packed and name in ("candump", "asc", "csv", "trc") and what != "cut":
            share = 1 - (5000 if end - begin > 1000 or what == "removed" else 300) / len(raw)
            assert right >= share * COUNT - 5 or (name == "trc" and begin < 500), place


def test_a_packed_log_of_several_members_goes_on_behind_a_damaged_one(tmp_path: Path) -> None:
    """As of a logger that packs each part by itself, and appends."""
    parts = [
        "".join(f"({START + k:.6f}) can0 123#{k % 256:02X}\n" for k in range(n, n + 1000)).encode()
        for n in range(0, 5000, 1000)
    ]
    members = [gzip.compress(each) for each in parts]
    path = tmp_path / "x.log.gz"
    path.write_bytes(b"".join(members))
    assert open_any(path).report.frames == 5000
    assert not open_any(path).report.lost
    middle = bytearray(members[2])
    middle[len(middle) // 2 : len(middle) // 2 + 20] = bytes(20)
    path.write_bytes(b"".join([*members[:2], bytes(middle), *members[3:]]))
    report = open_any(path).report
    assert report.damaged
    assert report.packing.startswith("it is damaged before byte")
    begin, end = map(int, re.findall(r"unpacked bytes (\d+) to (\d+) are doubtful", report.packing)[0])
    assert begin == len(parts[0]) + len(parts[1])
    assert begin < end < begin + 1.1 * len(parts[2])  # what is wrong may be longer
    assert 4000 <= report.frames < 5000
    found = [(f.t, f.data[0]) for f in open_any(path).frames() if len(f.data) == 1]
    assert sum(each in found for each in [(START + k, k % 256) for k in range(0, 2000, 100)]) == 20
    assert found[-1][1] == 4999 % 256
    path.write_bytes(b"".join(members)[: -len(members[4]) // 2])
    report = open_any(path).report
    assert "the compression is damaged: it is cut off at byte" in report.summary()
    assert report.frames > 4000


def test_rows_behind_damage_of_a_database_are_read(logs: dict[str, bytes], tmp_path: Path) -> None:
    raw = bytearray(logs["db"])
    middle = len(raw) // 2
    raw[middle : middle + 3000] = random.Random(1).randbytes(3000)  # noqa: S311
    path = tmp_path / "x.db"
    path.write_bytes(raw)
    report = open_any(path).report
    assert report.damaged
    assert COUNT * 0.85 < report.frames < COUNT
    assert report.length_s == pytest.approx(0.01 * (COUNT - 1))
    assert report.frames + report.bad == COUNT


def test_a_line_without_end_takes_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "x.log.gz"
    with gzip.open(path, "wb", 1) as file:
        file.write(b"(1.0) can0 123#00\n")
        for _ in range(80):
            file.write(bytes(1 << 20))
    report = open_any(path).report
    assert report.frames == 1
    assert report.missing == "no line ends within 64 MiB"


def test_python_can_reads_the_same_number_of_frames(logs: dict[str, bytes], tmp_path: Path) -> None:
    for name, raw in logs.items():
        path = tmp_path / f"x{TARGETS[name].ending}"
        path.write_bytes(raw)
        assert sum(1 for _ in can.LogReader(path)) == open_any(path).report.frames == COUNT, name

"""Ordinary MF4 logs are read without asammdf, and alike; others by it; damage costs a block and is said."""

import importlib
import random
import struct
from pathlib import Path

import can
import can.io.mf4
import numpy as np
import pytest
from asammdf import MDF, Signal

from faultline.service.logs import mf4, open_any
from faultline.service.logs.batch import Batch, joined, widened
from faultline.service.logs.channels import Channels
from faultline.service.logs.mf4_ordinary import OrdinaryMf4
from faultline.service.logs.mf4_tree import OddError, missing
from faultline.service.logs.pieces import Source
from faultline.service.logs.report import LogReport

START = 1_767_225_600.0
COUNT = 60_000  # two blocks of 4 MiB


def written(path: Path, count: int, compression: int) -> Path:
    chance = random.Random(1)  # noqa: S311
    # python-can may have been imported without asammdf (faultline/__init__.py)
    with importlib.reload(can.io.mf4).MF4Writer(path, compression_level=compression) as writer:
        for k in range(count):
            kind = k % 50
            writer.on_message_received(
                can.Message(
                    timestamp=START + 0.001 * k,
                    arbitration_id=0x123 if kind == 7 else 0x18FF103D,
                    is_extended_id=kind != 7,
                    is_fd=kind == 7,
                    is_remote_frame=kind == 8,
                    is_error_frame=kind == 9,
                    is_rx=kind != 10,
                    dlc=None if kind not in (8, 9) else 4 * (kind == 8),
                    data=chance.randbytes({7: 24, 8: 0, 9: 0}.get(kind, k % 9)),
                    channel=k % 3,
                )
            )
    return path


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Not compressed, deflated, and transposed before that."""
    folder = tmp_path_factory.mktemp("mf4")
    return [written(folder / f"{k}.mf4", 3000, k) for k in range(3)]


def read(path: Path, *, by_asammdf: bool = False) -> tuple[Batch, LogReport]:
    report, channels = LogReport(unit="record"), Channels()
    batches = mf4._by_asammdf(path, report, channels) if by_asammdf else mf4.read_mf4(Source(path), report, channels)
    return widened(joined(list(batches)), 64), report


@pytest.mark.parametrize("compression", range(3))
def test_an_ordinary_file_is_read_as_by_asammdf(
    logs: list[Path], compression: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    other, other_report = read(logs[compression], by_asammdf=True)
    monkeypatch.setattr(mf4, "find_spec", lambda _: None)  # as if it were not installed
    one, report = read(logs[compression])
    assert len(one) == 3000
    for name in Batch.__slots__:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)
    assert report == other_report


def test_a_damaged_block_costs_its_records_and_a_cut_one_the_rest(tmp_path: Path) -> None:
    path = written(tmp_path / "x.mf4", COUNT, 1)
    whole = path.read_bytes()
    first = whole.index(b"##DZ")
    size = struct.unpack_from("<Q", whole, first + 8)[0]
    raw = bytearray(whole)
    raw[first + size // 2 : first + size // 2 + 100] = bytes(100)
    path.write_bytes(raw)
    log = open_any(path)
    assert log.report.damaged
    assert 0 < log.report.frames < COUNT // 2
    assert log.report.frames + log.report.remote + log.report.errors + log.report.bad == COUNT
    assert "record 0: a block is damaged" in log.report.summary()


def test_more_records_than_the_file_says_are_read_and_said(logs: list[Path], tmp_path: Path) -> None:
    raw = bytearray(logs[0].read_bytes())
    at = next(
        k for k in range(0, len(raw), 8) if raw[k : k + 4] == b"##CG" and struct.unpack_from("<Q", raw, k + 80)[0]
    )
    says = struct.unpack_from("<Q", raw, at + 80)[0]
    for count in (0, says - 5):
        struct.pack_into("<Q", raw, at + 80, count)
        path = tmp_path / "x.mf4"
        path.write_bytes(raw)
        frames, report = read(path)
        assert len(frames) == 3000
        assert f"record {count}: the file says {count} records and has {says}" in report.summary()


@pytest.mark.parametrize("compression", range(3))
def test_damage_anywhere_is_said_or_left_to_asammdf(logs: list[Path], compression: int, tmp_path: Path) -> None:
    """Contents of the tree's blocks but the names of channels, which hold no checksum."""
    whole, path = logs[compression].read_bytes(), tmp_path / "x.mf4"
    chance = random.Random(compression)  # noqa: S311
    read_here = 0
    for _ in range(300):
        raw, at = bytearray(whole), chance.randrange(len(whole))
        match chance.randrange(3):
            case 0:
                del raw[at:]
            case 1:
                raw[at : at + 8] = chance.randbytes(len(raw[at : at + 8]))
            case _:
                raw[at : at + 300] = bytes(len(raw[at : at + 300]))
        path.write_bytes(raw)
        try:
            found = OrdinaryMf4(path)
            count = sum(map(len, found.batches()))
        except OddError:
            continue
        read_here += 1
        names = b"CAN_" in whole[max(0, at - 32) : at + 332]
        assert count == 3000 or found.bad or missing(path) or names, at
    assert read_here > 50


def test_what_is_not_ordinary_is_left_to_asammdf(logs: list[Path], tmp_path: Path) -> None:
    raw = bytearray(logs[0].read_bytes())
    raw[:8] = b"UnFinMF "
    raw[60] = 1  # its counters of records are not right
    path = tmp_path / "x.mf4"
    path.write_bytes(raw)
    with pytest.raises(OddError, match="not finished"):
        OrdinaryMf4(path)
    frames, report = read(path)
    assert len(frames) == 3000
    assert report.missing == "its logger did not close it"


def test_other_groups_are_no_matter(logs: list[Path], tmp_path: Path) -> None:
    path = tmp_path / "x.mf4"
    with MDF(logs[2]) as mdf:
        mdf.append(Signal(np.arange(5.0), np.arange(5.0), name="pressure", unit="Pa"))
        mdf.save(path)
    one, _ = read(path)
    assert len(one) == 3000

"""MF4 and Parquet, by the libraries of the extras: there and back, damaged, and as Arrow without a copy."""

import random
from pathlib import Path

import can
import numpy as np
import pyarrow
import pytest
from asammdf import MDF
from pyarrow import parquet

from faultline.service.logs import LogError, LogReport, open_any, open_log
from faultline.service.logs.arrow import arrow
from faultline.service.logs.batch import ERROR, EXTENDED, FD, REMOTE, SENT, Batch, joined
from faultline.service.logs.parquet import COLUMNS
from faultline.service.logs.writers import TARGETS

START = 1_767_225_600.0
COUNT = 5000
EXTRAS = ("mf4", "parquet")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of frames of all kinds on two channels."""
    chance = random.Random(1)  # noqa: S311
    lines = []
    for k in range(COUNT):
        t, channel = START + 0.01 * k, f"can{k % 2}"
        match k % 50:
            case 7:
                lines.append(f"({t:.6f}) {channel} 123##1{chance.randbytes(24).hex()} T")
            case 8:
                lines.append(f"({t:.6f}) {channel} 00000123#R4")
            case 9:
                lines.append(f"({t:.6f}) {channel} 20000000#{'0' * 16}")
            case _:
                lines.append(f"({t:.6f}) {channel} 18FF103D#{chance.randbytes(k % 9).hex()}")
    path = tmp_path_factory.mktemp("log") / "drive.log"
    path.write_text("\n".join([*lines, ""]))
    return path


@pytest.fixture(scope="module")
def made(log: Path) -> dict[str, Path]:
    found = {}
    for name in EXTRAS:
        found[name] = log.with_suffix(TARGETS[name].ending)
        TARGETS[name].write(open_any(log), found[name])
    return found


def whole(path: Path) -> Batch:
    return joined(list(open_any(path).batches()))


def counts(report: LogReport) -> tuple[int, int, int]:
    return report.frames, report.remote, report.errors


@pytest.mark.parametrize("name", EXTRAS)
def test_there_and_back(log: Path, made: dict[str, Path], name: str) -> None:
    given, back = open_any(log), open_any(made[name])
    assert back.format.name == name.upper()
    assert counts(back.report) == counts(given.report) == (COUNT - 200, 100, 100)
    assert not back.report.lost, back.report.summary()
    one, other = whole(log), whole(made[name])
    order = np.lexsort((one.identifier, one.time)), np.lexsort((other.identifier, other.time))
    one, other = one[order[0]], other[order[1]]
    np.testing.assert_allclose(one.time, other.time, atol=1e-6)
    has_data = one.has_data
    np.testing.assert_array_equal(one.data, other.data)
    np.testing.assert_array_equal(one.length[has_data], other.length[has_data])
    kept = FD | REMOTE | ERROR | SENT
    np.testing.assert_array_equal(one.flags & kept, other.flags & kept)
    np.testing.assert_array_equal((one.flags & EXTENDED)[has_data], (other.flags & EXTENDED)[has_data])
    np.testing.assert_array_equal(one.identifier[has_data], other.identifier[has_data])


@pytest.mark.parametrize("name", EXTRAS)
@pytest.mark.parametrize("seed", range(6))
def test_damage_is_said_and_ends_nothing_else(made: dict[str, Path], tmp_path: Path, name: str, seed: int) -> None:
    raw = bytearray(made[name].read_bytes())
    chance = random.Random(seed)  # noqa: S311
    at = chance.randrange(len(raw))
    if seed % 2:
        raw[at : at + 200] = chance.randbytes(len(raw[at : at + 200]))
    else:
        del raw[at:]
    path = tmp_path / made[name].name
    path.write_bytes(raw)
    try:
        report = open_any(path).report
    except LogError as error:
        assert "\n" not in str(error)  # noqa: PT017
        return
    if sum(counts(report)) < COUNT:
        assert report.damaged, (seed, report.summary())


def test_an_mf4_that_is_cut_off_says_where(made: dict[str, Path], tmp_path: Path) -> None:
    raw = made["mf4"].read_bytes()
    path = tmp_path / "cut.mf4"
    path.write_bytes(raw[: len(raw) * 7 // 10])
    with pytest.raises(LogError, match=r"no frame could be read|beyond its end") as caught:
        open_log(path)
    assert "\n" not in str(caught.value)


def test_an_mf4_that_its_logger_did_not_close(made: dict[str, Path], tmp_path: Path) -> None:
    raw = bytearray(made["mf4"].read_bytes())
    raw[:8] = b"UnFinMF "
    path = tmp_path / "open.mf4"
    path.write_bytes(raw)
    report = open_any(path).report
    assert report.missing == "its logger did not close it"


def test_python_can_and_asammdf_read_the_same(made: dict[str, Path]) -> None:
    with can.LogReader(made["mf4"]) as reader:
        assert sum(1 for _ in reader) == COUNT
    with MDF(made["mf4"]) as mdf:
        assert sum(group.channel_group.cycles_nr for group in mdf.groups) == COUNT


def test_parquet_has_the_columns_that_are_documented(made: dict[str, Path]) -> None:
    table = parquet.read_table(made["parquet"])
    assert tuple(table.column_names) == COLUMNS
    assert table.schema.metadata[b"schema"] == b"faultline.frames/1"
    assert table["channel"].to_pylist()[:2] == ["can0", "can1"]
    assert [len(each) for each in table["data"].to_pylist()[:6]] == list(range(6))


def test_another_table_is_no_log(tmp_path: Path) -> None:
    path = tmp_path / "x.parquet"
    parquet.write_table(pyarrow.table({"step": [1.0], "p": [2.0]}), path)
    with pytest.raises(
        LogError, match=r"x\.parquet: a Parquet file without time, channel, identifier, .* its columns are step, p"
    ):
        open_log(path)


def test_a_batch_is_seen_as_arrow_without_a_copy(log: Path) -> None:
    batch = next(open_any(log).batches())
    view = arrow(batch)
    assert view.num_rows == len(batch)
    for k, name in enumerate(("time", "channel", "identifier", "flags", "length", "data")):
        column = getattr(batch, name)
        assert view.column(k).buffers()[1].address == column.ctypes.data, name
    assert view.column(5)[3].as_py() == batch.data[3].tobytes()

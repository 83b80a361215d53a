"""Tables of values as Parquet: units of the fields' metadata, dates, gaps; what `diagnose --out` writes is one."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from faultline.service.core.signals.values import Quality
from faultline.service.diagnose.command import main
from faultline.service.logs import Log, LogError, open_log
from faultline.service.survey.command import survey_log

GOLDEN = Path(__file__).resolve().parents[1] / "golden"


def came(log: Log, name: str, unit: str) -> list[tuple[float, float, str]]:
    """Return time, value and quality of all that came of a signal."""
    return [
        (round(float(t), 6), float(value), Quality(quality).name)
        for piece in log.signals(log.table({name: unit}, "x")).pieces()
        if name in piece.columns
        for t, value, quality in zip(piece.time[piece.columns[name].row], *piece.columns[name][1:], strict=True)
    ]


@pytest.mark.parametrize("dates", [False, True])
def test_units_times_and_gaps(tmp_path: Path, dates: bool) -> None:
    at = [1.7e9, 1.7e9 + 0.5, 1.7e9 + 1.0, 1.7e9 + 1.5]
    times = pyarrow.array([datetime.fromtimestamp(t, UTC) for t in at]) if dates else pyarrow.array(at)
    fields = [
        pyarrow.field("timestamp", times.type),
        pyarrow.field("p", pyarrow.float64(), metadata={"unit": "kPa"}),
        pyarrow.field("word [1]", pyarrow.string()),
    ]
    columns = [times, pyarrow.array([1.0, None, np.inf, 2.0]), pyarrow.array(["a", None, "b", "c"])]
    path = tmp_path / "x.parquet"
    parquet.write_table(pyarrow.Table.from_arrays(columns, schema=pyarrow.schema(fields)), path, row_group_size=3)
    log = open_log(path)
    found = came(log, "p", "Pa")
    assert [(t, quality) for t, _, quality in found] == [(0.0, "GOOD"), (1.0, "ERROR"), (1.5, "GOOD")]
    assert [found[0][1], found[2][1]] == [1000.0, 2000.0]
    assert [quality for _, _, quality in came(log, "word", "1")] == ["ERROR"] * 3
    survey = survey_log(log)
    assert [(each.name, each.unit, each.count, each.not_numbers) for each in survey.columns] == [
        ("p", "kPa", 2, 1),
        ("word", "1", 0, 3),
    ]


def test_rows_without_a_time_are_lost_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "x.parquet"
    parquet.write_table(pyarrow.table({"t": [0.0, None, 1.0], "p": [1.0, 2.0, 3.0]}), path)
    report = open_log(path).report
    assert (report.frames, report.bad, report.places) == (2, 1, [(1, "no time")])


def test_what_diagnose_writes_is_read_again(tmp_path: Path) -> None:
    out = tmp_path / "ticks.parquet"
    assert main([str(GOLDEN / "log"), "--bundle", str(GOLDEN / "bundle"), "--out", str(out)]) == 1
    ticks = parquet.read_table(out)
    found = came(open_log(out), "y_p_du", "Pa")
    expected = [each for each in ticks.column("y_p_du").to_pylist() if each is not None]
    assert [value for _, value, _ in found] == expected
    twice = [str(GOLDEN / "log"), str(GOLDEN / "log"), "--bundle", str(GOLDEN / "bundle"), "--out", str(out)]
    assert main(twice) == 1
    with pytest.raises(LogError, match=r"ticks\.parquet: holds the ticks of 2 recordings"):
        open_log(out)

"""Tables of values as logs: known by their header, sampled as frames are, with or without a CAN log beside."""

import gzip
import re
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest

from faultline.service.bundle.load import load_bundle
from faultline.service.core.errors import InputError
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.event import Event
from faultline.service.core.signals.received import Signals
from faultline.service.core.signals.values import Quality
from faultline.service.diagnose.command import main
from faultline.service.logs import Log, LogError, open_log

GOLDEN = Path(__file__).resolve().parents[2] / "golden"
BUNDLE = load_bundle(GOLDEN / "bundle")
UNITS = {each.signal: each.unit for each in BUNDLE.manifest.inputs}
PRESSURE = {"p": "Pa"}


def received(signals: Signals, name: str) -> list[tuple[float, float, str]]:
    """Return time, value and quality of what came of a signal."""
    return [
        (round(t, 6), round(value, 6), Quality(quality).name)
        for piece in signals.pieces()
        if (column := piece.columns.get(name)) is not None
        for t, value, quality in zip(
            piece.time[column.row].tolist(), column.value.tolist(), column.quality.tolist(), strict=True
        )
    ]


def opened(tmp_path: Path, text: str, name: str = "x.csv") -> Log:
    path = tmp_path / name
    path.write_bytes(gzip.compress(text.encode()) if name.endswith(".gz") else text.encode())
    return open_log(path)


def values(tmp_path: Path, text: str, name: str = "x.csv") -> list[tuple[float, float, str]]:
    log = opened(tmp_path, text, name)
    return received(log.signals(log.table(PRESSURE, "x")), "p")


EXPECTED = [(0.0, 1000.0, "GOOD"), (0.5, 1500.0, "GOOD"), (1.0, 2000.0, "GOOD")]


@pytest.mark.parametrize(
    "text",
    [
        "time,p\n10,1000\n10.5,1500\n11,2000\n",
        "Timestamp [ms],p (hPa)\n10000,10\n10500,15\n11000,20\n",
        "t;p [kPa]\r\n10,0;1,0\r\n10,5;1,5\r\n11,0;2,0\r\n",
        "time\tp\ns\tkPa\n10\t1\n10.5\t1.5\n11\t2\n",
        "# a logger's words\n\n,time_exp,p\n0,10,1000\n1,10.5,1500\n2,11,2000\n",
        'time,note,p\n10,"a, b",1000\n10.5,,1500\n11,c,2000\n',
        "time,p\n2026-11-25T00:00:10Z,1000\n2026-11-25T00:00:10.500,1500\n2026-11-25T01:00:11+01:00,2000\n",
        "time,p\n1700000000000,1000\n1700000000500,1500\n1700000001000,2000\n",
        "time,p\n10,1000\n10.5,1500\ntime,p\n\n11,2000\n",
        "time,p\n12:00:10,1000\n12:00:10.500,1500\n12:00:11,2000\n",
        "Zeit;p\n31.12.2025 23:59:59,5;1000\n01.01.2026 00:00:00,0;1500\n1.1.2026 0:00:00,5;2000\n",
        "date,p\n2025/12/31 23:59:59.5,1000\n2026/01/01,1500\n2026/1/1 0:00:00.5,2000\n",
        "t_ms,p\n20,1000\n520,1500\n1020,2000\n",
        "Datetime,p\n9/6/2017 23:59:59.5,1000\n9/7/2017 0:00:00,1500\n9/7/2017 00:00:00.5,2000\n",
        "Date,p\n6/9/2017 11:59:59.5 PM,1000\n7/9/2017 12:00:00 AM,1500\n7/9/2017 12:00:00.5 am,2000\n",
        "Date;p\n31/8/2017 23:59:59,5;1000\n1/9/2017 0:00:00;1500\n1/9/2017 0:00:00,5;2000\n",
    ],
    ids=[
        "plain", "ms", "decimal comma", "units below", "pandas", "quotes", "dates", "epoch", "header again", "clock",
        "day first", "slashes", "unit in the name", "month first", "day first with slashes", "a day above 12",
    ],
)  # fmt: skip
@pytest.mark.parametrize("name", ["x.csv", "x.log", "x.csv.gz"])
def test_a_table_is_known_by_its_header(tmp_path: Path, text: str, name: str) -> None:
    assert values(tmp_path, text, name) == EXPECTED
    assert not open_log(tmp_path / name).report.lost


def test_a_table_in_utf_16(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_bytes("time;p\n10;1000\n10,5;1500\n11;2000\n".encode("utf-16"))
    log = open_log(tmp_path / "x.csv")
    assert received(log.signals(log.table(PRESSURE, "x")), "p") == EXPECTED


def test_of_two_columns_of_one_name_none_is_taken(tmp_path: Path) -> None:
    log = opened(tmp_path, "time,p,q,p\n0,1,2,3\n1,1,2,3\n")
    with pytest.raises(LogError, match=r"no column is p; its columns are p \(column 2\), q, p \(column 4\): say which"):
        log.table(PRESSURE, "x")


def test_times_that_are_none_are_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"x\.csv: line 3: '13/31/2026' in column 'time' is no time; give seconds, or"):
        opened(tmp_path, "time,p\n13/30/2026,1\n13/31/2026,2\n")


def test_an_empty_cell_is_silence_and_a_word_is_no_number(tmp_path: Path) -> None:
    found = values(tmp_path, "time,p,q\n0,1,1\n1,,2\n2,NaN,3\n3,sensor fault,4\n4,inf,5\n5,2,6\n")
    assert [(t, quality) for t, _, quality in found] == [(0.0, "GOOD"), (3.0, "ERROR"), (4.0, "ERROR"), (5.0, "GOOD")]
    assert np.isnan([value for _, value, quality in found if quality == "ERROR"]).all()


def test_rows_without_times_are_counted_and_a_lost_one_leaves_its_place(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("u;p\n-;kPa\n1,5;1,0\n1,5;2,0\n1,5\n;3,5\n")
    for text, expected in (("period_s = 0.5", [0.0, 0.5, 1.5]), ("period_s = 4", [0.0, 4.0, 12.0])):
        recording = 'schema = 1\nid = "x"\nkind = "instrumented"\nsource = "s"\nvehicle = "v"\ncycle = "c"\n'
        recording += f'sensor_set = "instrumented"\n[table]\nfile = "x.csv"\n{text}\n'
        (tmp_path / "recording.toml").write_text(recording)
        log = open_log(tmp_path)
        found = received(log.signals(log.table(PRESSURE, "x")), "p")
        assert [(t, value) for t, value, _ in found] == list(zip(expected, (1000.0, 2000.0, 3500.0), strict=True))
        assert log.report.bad == 1


def test_a_truth_is_one_or_zero(tmp_path: Path) -> None:
    found = values(tmp_path, "time,p,q\n0,TRUE,1\n1,False,2\n")
    assert [(value, quality) for _, value, quality in found] == [(1.0, "GOOD"), (0.0, "GOOD")]


def test_a_damaged_row_costs_itself_and_is_counted_with_its_place(tmp_path: Path) -> None:
    text = "time,p,q\n0,1,1\n1,2\nx,3,3\n3,4,4\n4,5,5,5\n5,6,6\n6,7"
    log = opened(tmp_path, text)
    assert [t for t, _, _ in received(log.signals(log.table(PRESSURE, "x")), "p")] == [0.0, 3.0, 5.0]
    report = log.report
    assert (report.frames, report.bad, report.truncated) == (3, 3, True)
    assert [number for number, _ in report.places] == [3, 4, 6]
    assert report.summary().startswith("3 rows read, from 0.0 to 5.0 s, 18 bytes are lost, 3 lines could not be read")


def test_a_clock_that_is_set_back_moves_what_follows(tmp_path: Path) -> None:
    log = opened(tmp_path, "time,p\n100,1\n101,2\n7,3\n8,4\n")
    assert [t for t, _, _ in received(log.signals(log.table(PRESSURE, "x")), "p")] == [0.0, 1.0, 1.0, 2.0]
    assert log.report.clock_steps == 1


def test_pieces_and_the_whole_are_the_same(tmp_path: Path) -> None:
    """Of 2 MB, some of whose pieces are numbers alone, and some are not."""
    rows = [f"{k / 100},{k},{'' if k % 40000 == 17 else k * 2}" for k in range(120_000)]
    found = values(tmp_path, "time,q,p\n" + "\n".join(rows) + "\n")
    assert len(found) == 119_997
    assert [(t, value) for t, value, _ in found[-2:]] == [(1199.98, 239996.0), (1199.99, 239998.0)]


def events_of(log: Log) -> list[Event]:
    monitor = Monitor(BUNDLE.manifest, BUNDLE.bank(), BUNDLE.table, "x", BUNDLE.id)
    return [*monitor.signals(log.signals(load_bundle(GOLDEN / "bundle").table))]


def table_of(log: Log, names: list[str], times: float = 0.0) -> str:
    """Return what came of these signals as a table, a row for each message."""
    rows: dict[float, dict[str, float]] = {}
    for piece in log.signals(log.table(UNITS, "x")).pieces():
        for name in names:
            column = piece.columns[name]
            for t, value in zip(piece.time[column.row].tolist(), column.value.tolist(), strict=True):
                rows.setdefault(t, {})[name] = value
    lines = [",".join(["time", *(f"{name} [{UNITS[name]}]" for name in names)])]
    for t in sorted(rows):
        cells = (repr(rows[t][name]) if name in rows[t] else "" for name in names)
        lines.append(",".join([repr(t + times), *cells]))
    return "\n".join(lines) + "\n"


def test_a_table_of_the_golden_log_gives_its_events(tmp_path: Path) -> None:
    log = open_log(GOLDEN / "log")
    given = [(each.tick, each.transition, each.diagnoses) for each in events_of(log)]
    assert [transition for _, transition, _ in given][-2:] == ["occurred", "refined"]
    found = events_of(opened(tmp_path, table_of(log, [*UNITS])))
    assert [(each.tick, each.transition, each.diagnoses) for each in found] == given


@pytest.fixture
def beside(tmp_path: Path) -> Path:
    """The golden recording, whose y_p_tp is taken from a table in kPa on a clock of its own."""
    folder = tmp_path / "recording"
    copytree(GOLDEN / "log", folder)
    text = table_of(open_log(GOLDEN / "log"), ["y_p_tp"], times=5.0).splitlines()
    rows = [line.split(",") for line in text[1:]]
    (folder / "bench.csv").write_text(
        "seconds,tank\n" + "".join(f"{t},{(float(value) - 500.0) / 1000}\n" for t, value in rows)
    )
    with (folder / "recording.toml").open("a") as file:
        file.write('\n[table]\nfile = "bench.csv"\ntime = "seconds"\noffset_s = -5.0\n')
        file.write('signals = { y_p_tp = { column = "tank", unit = "kPa", offset = 0.5 } }\n')
    return folder


def test_signals_of_a_bus_and_of_a_table_beside_it(beside: Path) -> None:
    golden, log = open_log(GOLDEN / "log"), open_log(beside)
    for name in UNITS:
        expected = received(golden.signals(golden.table(UNITS, "x")), name)
        found = received(log.signals(log.table(UNITS, "x")), name)
        assert [(t, quality) for t, _, quality in found] == [(t, quality) for t, _, quality in expected]
        np.testing.assert_allclose([each[1] for each in found], [each[1] for each in expected], rtol=1e-9)
    given = [(each.tick, each.transition) for each in events_of(golden)]
    assert [(each.tick, each.transition) for each in events_of(log)] == given
    assert main([str(beside), "--bundle", str(GOLDEN / "bundle")]) == 1


def test_damage_of_the_table_is_damage_of_the_log(beside: Path) -> None:
    with (beside / "bench.csv").open("a") as file:
        file.write("?,1\n")
    report = open_log(beside).report
    assert report.damaged
    assert "of the table beside it 4 bytes are lost, 1 lines could not be read" in report.summary()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("offset_s = -5.0", "offset_s = 500.0", "bench.csv: from 5.0.* they have no time in common; give `offset_s`"),
        ('"tank"', '"tink"', "no column 'tink' for y_p_tp; its columns are tank"),
        ('"kPa"', '"km/h"', "tank is in 'km/h', which cannot be converted to 'Pa', the unit of y_p_tp"),
        ('time = "seconds"', 'time = "minutes"', "no table of values with a column of times .*name the column"),
        ('"bench.csv"', '"none.csv"', "none.csv: not found; recording.toml names it as the table"),
        ('unit = "kPa"', 'units = "kPa"', "recording.toml: Object contains unknown field `units`"),
    ],
)
def test_what_does_not_fit_is_named(beside: Path, old: str, new: str, words: str) -> None:
    path = beside / "recording.toml"
    path.write_text(path.read_text().replace(old, new))

    def read() -> None:
        log = open_log(beside)
        log.signals(log.table(UNITS, "x"))

    with pytest.raises(LogError, match=words):
        read()


def test_a_table_without_the_signals_is_refused_with_its_columns(tmp_path: Path) -> None:
    opened(tmp_path, "time,a,b\n0,1,2\n1,2,3\n")
    with pytest.raises(InputError, match=r"no column is .*y_p_du.*; its columns are a, b: say which is which"):
        main([str(tmp_path / "x.csv"), "--bundle", str(GOLDEN / "bundle")])


def test_a_table_has_no_frames_to_replay(tmp_path: Path) -> None:
    log = opened(tmp_path, "time,p\n0,1\n1,2\n")
    with pytest.raises(LogError, match=re.escape("x.csv: a CSV table of values, which has no CAN frames")):
        next(log.relative())


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("y_p_tp =", "y_p_tpp =", r"\[table.signals\] y_p_tpp is none of the signals: did you mean y_p_tp\?"),
        ("offset = 0.5", "offset = nan", "scale and offset of y_p_tp .* must be numbers"),
    ],
)
def test_an_entry_that_would_do_nothing_or_harm_is_refused(beside: Path, old: str, new: str, words: str) -> None:
    path = beside / "recording.toml"
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(LogError, match=words):
        main([str(beside), "--bundle", str(GOLDEN / "bundle")])

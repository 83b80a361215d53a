"""Recordings are read strictly; whatever is wrong is named with its place."""

import hashlib
from pathlib import Path

import pytest

from faultline.service.logs import LogError, load_recording, open_log

DBC = 'VERSION "1"\n'
LOG = "(100.000000) can0 18FF103D#0011223344556677\n(101.500000) can0 123#00\n"
TOML = f"""schema = 1
id = "drive-1"
kind = "instrumented"
source = "test"
vehicle = "bench"
cycle = "none"
sensor_set = "instrumented"
[can]
file = "can.log"
dbc = "uds.dbc"
dbc_sha256 = "{hashlib.sha256(DBC.encode()).hexdigest()}"
"""
BENCH = (
    TOML.replace("instrumented", "bench", 1)
    + """[external]
file = "external.csv"
time_column = "time_s"
unit = "V"
[external.tables.y_p_tp]
column = "p_tp_V"
volts = [0.5, 4.5]
pascal = [0.0, 250000.0]
"""
)


def _write(folder: Path, toml: str = TOML) -> Path:
    (folder / "recording.toml").write_text(toml)
    (folder / "can.log").write_text(LOG)
    (folder / "uds.dbc").write_text(DBC)
    (folder / "external.csv").write_text("time_s,p_tp_V\n")
    return folder


def test_opens_an_instrumented_recording(tmp_path: Path) -> None:
    log = open_log(_write(tmp_path))
    assert (log.id, log.dbc, log.duration_s) == ("drive-1", DBC, 1.5)
    assert log.recording is not None
    assert log.recording.can_log.dbc_sha256 == hashlib.sha256(DBC.encode()).hexdigest()
    assert log.sha256 == hashlib.sha256(LOG.encode()).hexdigest()
    assert [frame.t for frame in log.frames()] == [100.0, 101.5]
    assert [frame.t for frame in log.relative()] == [0.0, 1.5]
    assert log.report.summary() == "2 frames read, from 0.0 to 1.5 s"


def test_opens_a_bare_log_which_has_no_dbc(tmp_path: Path) -> None:
    log = open_log(_write(tmp_path) / "can.log")
    assert (log.id, log.recording, len(list(log.frames()))) == ("can", None, 2)
    with pytest.raises(LogError, match="names no DBC; give its recording's folder"):
        _ = log.dbc


def test_loads_a_bench_recording_but_does_not_diagnose_it(tmp_path: Path) -> None:
    recording = load_recording(_write(tmp_path, BENCH))
    assert recording.external is not None
    assert recording.external.tables["y_p_tp"].pascal == [0.0, 250000.0]
    with pytest.raises(LogError, match=f"run `faultline ingest {tmp_path} --out DIR` first"):
        open_log(tmp_path)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("recording.toml", "recording.toml: not found; is this a recording's folder"),
        ("can.log", "can.log: not found; recording.toml names it as the CAN log"),
        ("uds.dbc", "uds.dbc: not found; recording.toml names it as the log's DBC"),
        ("external.csv", "external.csv: not found; a bench recording needs the second logger's file"),
    ],
)
def test_a_missing_file_is_named_with_its_role(tmp_path: Path, name: str, words: str) -> None:
    (_write(tmp_path, BENCH) / name).unlink()
    with pytest.raises(LogError, match=words):
        open_log(tmp_path)


def test_another_dbc_is_refused(tmp_path: Path) -> None:
    (_write(tmp_path) / "uds.dbc").write_text(DBC + "BS_:\n")
    with pytest.raises(LogError, match=r"uds\.dbc: not the DBC of this recording"):
        open_log(tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("schema = 1", "schema = 2", "schema is 2, this faultline reads 1"),
        ("schema = 1\n", "", "required and not there: schema;"),
        ("schema = 1", "schema = ", "not valid TOML"),
        ('file = "can.log"', "file = 3", "Expected `str`, got `int` - at `can.file`"),
        ('cycle = "none"\n', "", "required and not there: cycle;"),
        ("[can]", "colour = 1\n[can]", "unknown field `colour`"),
        ('file = "can.log"', 'file = "can.log"\nrate = 1', "unknown field `rate` - at `can`"),
        ('kind = "bench"', 'kind = "road"', "Invalid enum value 'road' - at `kind`"),
        ('id = "drive-1"', 'id = "../x"', "at `id`"),
        ('kind = "bench"', 'kind = "instrumented"', "kind is instrumented but there is an"),
        ('unit = "V"', 'unit = "mV"', "Invalid enum value 'mV' - at `external.unit`"),
        ("volts = [0.5, 4.5]", "volts = [4.5, 0.5]", "external.tables.y_p_tp.volts: must increase"),
        ("volts = [0.5, 4.5]", "volts = [0.5, 2.0, 4.5]", "external.tables.y_p_tp: 3 volts for 2 pascal"),
        ("volts = [0.5, 4.5]", "volts = [0.5]", r"external.tables\[...\].volts"),
    ],
)
def test_what_is_wrong_in_the_file_is_named_with_its_place(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in BENCH
    _write(tmp_path, BENCH.replace(old, new))
    with pytest.raises(LogError, match=words) as caught:
        load_recording(tmp_path)
    assert str(caught.value).startswith(f"{tmp_path / 'recording.toml'}: ")
    assert "\n" not in str(caught.value)


def test_a_bench_recording_names_its_second_logger(tmp_path: Path) -> None:
    _write(tmp_path, TOML.replace("instrumented", "bench", 1))
    with pytest.raises(LogError, match=r"kind is bench but there is no \[external\]"):
        load_recording(tmp_path)


def test_a_file_that_is_not_text_is_refused(tmp_path: Path) -> None:
    (_write(tmp_path) / "recording.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(LogError, match="not valid TOML"):
        load_recording(tmp_path)


def test_all_that_is_absent_or_marked_is_named_at_once(tmp_path: Path) -> None:
    text = BENCH.replace('id = "drive-1"\n', "").replace('source = "test"', 'source = "FILL IN: where from"')
    _write(tmp_path, text.replace('dbc = "uds.dbc"\n', "").replace('column = "p_tp_V"', 'column = "FILL IN"'))
    with pytest.raises(LogError) as caught:
        load_recording(tmp_path)
    assert str(caught.value).removeprefix(f"{tmp_path / 'recording.toml'}: ") == (
        "required and not there: id, can.dbc; add them, or let `faultline ingest --init` write it; "
        "still to be filled in: source, external.tables.y_p_tp.column"
    )

"""Ingest is asked for what was hidden in a made-up bench recording: offset, drift and zero; and for its losses."""

import csv
import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database

from analysis.recordings.command import main
from service.core.decode import compile_dbc
from service.core.errors import InputError
from service.core.signals import Quality, Vector
from service.logs import Log, load_recording, open_log

DBC = (Path(__file__).parents[3] / "dbc" / "uds.dbc").read_bytes()
DATABASE = cantools.database.load_string(DBC.decode(), "dbc")
ATMOSPHERE = 101_325.0
START = 1_767_225_600.0
OFFSET, DRIFT = -2.345, 37e-6  # CAN time = OFFSET + (1 + DRIFT) * logger time
ZERO = {"y_p_tp": -1_800.0, "y_p_ap": 2_700.0}
STANDING = 15.0
DURATION = 420.0
SPAN = {"y_p_tp": 250_000.0, "y_p_ap": 1_600_000.0}


@dataclass
class Bench:
    """What to hide in a recording, and what to break."""

    standing: float = STANDING
    duration: float = DURATION
    tables: str = "y_p_tp y_p_ap"
    spoil: Callable[[list[str]], list[str]] = list
    """Changes the rows of the CSV."""


def _profiles(bench: Bench) -> Callable[[Vector], dict[str, Vector]]:
    """Pressures, speed and dose at any time: steps through a first-order lag, as a pump and its hose give them."""
    rng = np.random.default_rng(5)
    t = np.arange(-10.0, bench.duration + 10.0, 0.01)
    changes = np.arange(40.0, bench.duration, 15.0)
    dose = np.select([t < 40.0], [0.0], rng.choice([0.0, 0.3, 0.6, 1.0], len(changes) + 1)[np.searchsorted(changes, t)])
    target = np.where(t < bench.standing, 0.0, 9e5) - 1.5e5 * dose
    gauge = np.zeros_like(t)
    for k in range(1, len(t)):
        gauge[k] = gauge[k - 1] + 0.01 / 1.5 * (target[k] - gauge[k - 1])
    fine = {
        "y_p_ap": ATMOSPHERE + gauge,
        "y_p_tp": ATMOSPHERE - 0.02 * gauge,
        "y_p_du": ATMOSPHERE + 0.97 * gauge - 0.1e5 * dose,
        "n_p": np.where(t < bench.standing, 0.0, 20.0 + 10.0 * dose),
        "dc_dose": dose,
    }
    return lambda at: {name: np.interp(at, t, value) for name, value in fine.items()}


def _can_log(bench: Bench, rng: np.random.Generator) -> str:
    assert isinstance(DATABASE, Database)
    message = DATABASE.get_message_by_name("UDS_ECU")
    t = np.arange(0.0, bench.duration, 0.2) + rng.uniform(-0.01, 0.01, round(bench.duration / 0.2))
    t -= t[0]
    at = _profiles(bench)(t)
    du = at["y_p_du"] + 800.0 * rng.standard_normal(len(t))
    lines = []
    for k, time in enumerate(t):
        data = message.encode(
            {"y_p_du": du[k] / 1e3, "n_p": at["n_p"][k], "dc_dose": 100 * at["dc_dose"][k]}, padding=True
        )
        lines.append(f"({START + time:.6f}) can0 18FF103D#{data.hex().upper()}\n")
    return "".join(lines)


def _csv(bench: Bench, rng: np.random.Generator) -> str:
    logger = np.arange(0.0, bench.duration + 5.0, 0.1) + rng.uniform(-0.004, 0.004, round(bench.duration / 0.1) + 50)
    at = _profiles(bench)(OFFSET + (1 + DRIFT) * logger)
    rows = ["time_s,p_tp_V,p_ap_V"]
    volts = {
        signal: 0.5 + 4.0 * (at[signal] + ZERO[signal] + 300.0 * rng.standard_normal(len(logger))) / SPAN[signal]
        for signal in ("y_p_tp", "y_p_ap")
    }
    rows += [f"{t:.4f},{a:.5f},{b:.5f}" for t, a, b in zip(logger, volts["y_p_tp"], volts["y_p_ap"], strict=True)]
    return "\n".join([*bench.spoil(rows), ""])


def _write(folder: Path, bench: Bench) -> Path:
    folder.mkdir(parents=True)
    rng = np.random.default_rng(11)
    (folder / "can.log").write_text(_can_log(bench, rng))
    (folder / "external.csv").write_text(_csv(bench, rng))
    (folder / "uds.dbc").write_bytes(DBC)
    tables = "".join(
        f'[external.tables.{name}]\ncolumn = "{name[2:]}_V"\nvolts = [0.5, 4.5]\npascal = [0.0, {SPAN[name]}]\n'
        for name in bench.tables.split()
    )
    (folder / "recording.toml").write_text(
        'schema = 1\nid = "made-up"\nkind = "bench"\nsource = "a \\"test\\""\nvehicle = "bench"\ncycle = "steps"\n'
        'start = 2026-01-01T00:00:00Z\nsensor_set = "instrumented"\n[can]\nfile = "can.log"\ndbc = "uds.dbc"\n'
        f'dbc_sha256 = "{hashlib.sha256(DBC).hexdigest()}"\n'
        f'[external]\nfile = "external.csv"\ntime_column = "time_s"\nunit = "V"\n{tables}'
    )
    return folder


def _ingest(tmp_path: Path, bench: Bench, *options: str) -> tuple[Path, dict[str, object]]:
    assert main([str(_write(tmp_path / "bench", bench)), "--out", str(tmp_path / "logs"), *options]) == 0
    folder = tmp_path / "logs" / "made-up"
    return folder, json.loads((folder / "ingest.json").read_text())


@pytest.fixture(scope="module")
def ingested(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, object]]:
    """The instrumented recording of an unbroken bench recording, and its report."""
    return _ingest(tmp_path_factory.mktemp("whole"), Bench())


def _number(report: dict[str, object], name: str) -> float:
    value = report[name]
    assert isinstance(value, int | float)
    return value


def test_gives_back_the_clock(ingested: tuple[Path, dict[str, object]]) -> None:
    _, report = ingested
    assert _number(report, "offset_s") == pytest.approx(OFFSET, abs=0.02)
    assert _number(report, "drift_ppm") == pytest.approx(DRIFT * 1e6, abs=20)
    assert _number(report, "correlation") > 0.95


def test_gives_back_the_zero_errors(ingested: tuple[Path, dict[str, object]]) -> None:
    _, report = ingested
    assert report["zero_pa"] == {name: pytest.approx(error, abs=100.0) for name, error in ZERO.items()}
    assert _number(report, "standstill_s") == pytest.approx(STANDING - 1.0, abs=0.3)


def _decoded(log: Log, names: set[str]) -> dict[str, list[tuple[float, float, Quality]]]:
    table = compile_dbc(log.dbc, dict.fromkeys(names, "Pa"), "uds.dbc")
    tracks: dict[str, list[tuple[float, float, Quality]]] = {name: [] for name in names}
    for t, can_id, extended, data in log.relative():
        for name, value, quality in table.decode(can_id, extended, data):
            tracks[name].append((t, value, quality))
    return tracks


def test_puts_the_sensors_on_the_can_log_in_pascal(ingested: tuple[Path, dict[str, object]]) -> None:
    log = open_log(ingested[0])
    assert (log.id, load_recording(ingested[0]).source) == ("made-up", 'a "test"; ingested')
    tracks = _decoded(log, {"y_p_tp", "y_p_ap"})
    for name, noise in (("y_p_tp", 300.0), ("y_p_ap", 300.0)):
        t, value, quality = (np.array(column) for column in zip(*tracks[name], strict=True))
        assert (quality == Quality.GOOD).all()
        error = value - _profiles(Bench())(t)[name]
        assert abs(np.median(error)) < 100.0
        assert np.median(np.abs(error)) < 2 * noise
        assert t[0] >= 0.0
        assert t[-1] <= DURATION
        assert np.median(np.diff(t)) == pytest.approx(0.1, abs=0.002)


def test_keeps_every_frame_of_the_bench_log(ingested: tuple[Path, dict[str, object]]) -> None:
    bench = ingested[0].parents[1] / "bench" / "can.log"
    lines = (ingested[0] / "can.log").read_text().splitlines()
    assert [line for line in lines if "18FF103D#" in line] == bench.read_text().splitlines()
    assert {line.split()[2].split("#")[0] for line in lines} == {"18FF103D", "18FF20F9"}
    assert all(line.endswith("FFFFFFFF") for line in lines if "18FF20F9#" in line)


def test_uniform_data_are_aligned_and_unfiltered_in_phase(ingested: tuple[Path, dict[str, object]]) -> None:
    with (ingested[0] / "uniform.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["t", "y_p_tp", "y_p_ap", "y_p_du", "n_p", "dc_dose"]
    t = np.array([float(row["t"]) for row in rows])
    assert np.allclose(np.diff(t), 0.2)
    expected = _profiles(Bench())(t)
    for name in ("y_p_ap", "y_p_du"):
        error = np.array([float(row[name]) for row in rows]) - expected[name]
        assert np.sqrt(np.mean(error**2)) < 2_500.0, name


def test_equal_input_gives_equal_bytes(tmp_path: Path, ingested: tuple[Path, dict[str, object]]) -> None:
    again, _ = _ingest(tmp_path, Bench())
    names = sorted(path.name for path in again.iterdir())
    assert names == ["can.log", "ingest.json", "recording.toml", "uds.dbc", "uniform.csv"]
    for name in names:
        assert (again / name).read_bytes() == (ingested[0] / name).read_bytes(), name


def test_bad_rows_and_cells_are_counted_and_the_rest_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def spoil(rows: list[str]) -> list[str]:
        rows[600] = "59.9,1.0"  # a cell is missing
        rows[700] = "garbage,1.0,1.0"
        rows[800] = rows[800].partition(",")[0] + ",,"  # blank
        rows[900] = rows[900].rpartition(",")[0] + ",4.9"  # beyond the table
        return [*rows[:-1], rows[-1][:9]]  # cut off

    folder, report = _ingest(tmp_path, Bench(spoil=spoil))
    assert (report["bad_rows"], report["bad_cells"]) == (3, 3)
    assert report["first_bad_row"] == "line 601: 2 cells instead of 3"
    said = capsys.readouterr().out
    assert "3 bad rows (first: line 601: 2 cells instead of 3), 3 cells without a value" in said
    tracks = _decoded(open_log(folder), {"y_p_tp", "y_p_ap"})
    missing = {name: sum(q is Quality.NOT_AVAILABLE for _, _, q in track) for name, track in tracks.items()}
    assert missing == {"y_p_tp": 1, "y_p_ap": 2}


def test_a_truncated_can_log_is_used_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bench = _write(tmp_path / "bench", Bench())
    content = (bench / "can.log").read_bytes()
    (bench / "can.log").write_bytes(content[: len(content) * 2 // 3 + 7])
    assert main([str(bench), "--out", str(tmp_path / "logs")]) == 0
    assert "CAN log: " in (said := capsys.readouterr().out)
    assert "the last line is cut off" in said


def test_without_a_standstill_the_datasheets_zero_stays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, report = _ingest(tmp_path, Bench(standing=0.0))
    assert report["standstill_s"] == 0.0
    assert report["zero_pa"] == {"y_p_tp": None, "y_p_ap": None}
    assert "keep their datasheet's zero" in capsys.readouterr().out


def test_json_is_the_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, report = _ingest(tmp_path, Bench(duration=120.0), "--json")
    assert json.loads(capsys.readouterr().out) == report


def test_what_is_there_is_kept_unless_forced(tmp_path: Path) -> None:
    bench = _write(tmp_path / "bench", Bench(duration=120.0))
    arguments = [str(bench), "--out", str(tmp_path / "logs")]
    assert main(arguments) == 0
    with pytest.raises(InputError, match="exists; remove it or use --force"):
        main(arguments)
    (tmp_path / "logs" / "made-up" / "old").touch()
    assert main([*arguments, "--force"]) == 0
    assert not (tmp_path / "logs" / "made-up" / "old").exists()
    assert [path.name for path in (tmp_path / "logs").iterdir()] == ["made-up"]


def test_never_replaces_the_bench_recording(tmp_path: Path) -> None:
    bench = _write(tmp_path / "made-up", Bench(duration=120.0))
    with pytest.raises(InputError, match="would replace the bench recording itself"):
        main([str(bench), "--out", str(tmp_path), "--force"])
    assert (bench / "external.csv").exists()


def _swap(rows: list[str]) -> list[str]:
    """Another drive's pressures under this drive's times."""
    rng = np.random.default_rng(1)
    noise = 2.0 + 0.5 * np.cumsum(rng.standard_normal(len(rows))) / np.sqrt(len(rows))
    return [rows[0], *(f"{row.split(',')[0]},1.0,{v:.4f}" for row, v in zip(rows[1:], noise, strict=False))]


def _flat(rows: list[str]) -> list[str]:
    return [rows[0], *(f"{row.split(',')[0]},1.0,1.0" for row in rows[1:])]


@pytest.mark.parametrize(
    ("bench", "words"),
    [
        (Bench(duration=120.0, spoil=_swap), "does not follow the CAN log's y_p_du"),
        (Bench(duration=120.0, spoil=_flat), "does not follow the CAN log's y_p_du"),
        (Bench(duration=120.0, spoil=lambda rows: rows[:200]), "shorter than 30 s"),
        (Bench(duration=120.0, spoil=lambda rows: rows[:1]), "external.csv: no two rows can be read"),
        (Bench(duration=120.0, spoil=lambda _: []), "external.csv: line 1: no column time_s, p_tp_V, p_ap_V"),
        (Bench(duration=120.0, spoil=lambda rows: ["time_s,p_tp_V", *rows[1:]]), "no column p_ap_V; recording.toml"),
        (Bench(duration=120.0, tables="y_p_tp"), "external.tables has no y_p_ap"),
    ],
)
def test_what_cannot_be_aligned_is_refused(tmp_path: Path, bench: Bench, words: str) -> None:
    folder = _write(tmp_path / "bench", bench)
    with pytest.raises(InputError, match=words) as caught:
        main([str(folder), "--out", str(tmp_path / "logs")])
    assert str(folder) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "logs").exists()


def _without(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def _replace(name: str, old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new))

    return change


def _other_dbc(old: str, new: str) -> Callable[[Path], None]:
    """A DBC of which the recording knows the hash."""

    def change(folder: Path) -> None:
        dbc = DBC.replace(old.encode(), new.encode())
        assert dbc != DBC
        (folder / "uds.dbc").write_bytes(dbc)
        _replace("recording.toml", hashlib.sha256(DBC).hexdigest(), hashlib.sha256(dbc).hexdigest())(folder)

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_without("external.csv"), "external.csv: not found; a bench recording needs the second logger's file"),
        (_without("can.log"), "can.log: not found"),
        (_replace("uds.dbc", "ACM", "XCM"), "uds.dbc: not the DBC of this recording"),
        (_replace("can.log", "18FF103D", "18FF113D"), "can.log: no frame carries y_p_du, n_p, dc_dose"),
        (_replace("can.log", "18FF103D", "18FF20F9"), "can.log: no frame carries"),
        (_other_dbc("UDS_SENSORS", "SENSORS"), "uds.dbc: has no message UDS_SENSORS"),
        (_other_dbc("SG_ y_p_tp : 0|16", "SG_ y_p_xx : 0|16"), "UDS_SENSORS has no signal y_p_tp"),
        (_other_dbc('[0|321.275] "kPa"', '[0|321.275] "psi"'), "UDS_SENSORS.y_p_tp is in 'psi'"),
    ],
)
def test_a_recording_that_lacks_something_is_refused(
    tmp_path: Path, change: Callable[[Path], None], words: str
) -> None:
    folder = _write(tmp_path / "bench", Bench(duration=120.0))
    change(folder)
    with pytest.raises(InputError, match=words):
        main([str(folder), "--out", str(tmp_path / "logs")])


def test_an_instrumented_recording_is_not_ingested_again(ingested: tuple[Path, dict[str, object]]) -> None:
    with pytest.raises(InputError, match="kind is instrumented, already ingested"):
        main([str(ingested[0]), "--out", str(ingested[0].parent / "again")])

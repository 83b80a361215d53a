"""Ingest is asked for what was hidden in a made-up bench recording: offset, drift and zero; and for its losses."""

import csv
import hashlib
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database

from faultline.analysis.model.file import SYSTEMS
from faultline.analysis.recordings import bench as bench_module
from faultline.analysis.recordings.bench import setup_of
from faultline.analysis.recordings.command import main
from faultline.service.core.errors import InputError
from faultline.service.core.signals.dbc import compile_dbc
from faultline.service.core.signals.values import FloatArray, Quality
from faultline.service.logs import Log, load_recording, open_log
from faultline.testbench.bus import load_dbc
from faultline.testbench.cycles import CYCLES
from faultline.testbench.recording import record
from faultline.testbench.request import Request
from faultline.testbench.vehicles import vehicle

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
    ambient: float = ATMOSPHERE
    trimmed: bool = False  # the controller's own sensor shows the standard atmosphere
    tables: str = "y_p_tp y_p_ap"
    spoil: Callable[[list[str]], list[str]] = list
    """Changes the rows of the CSV."""


def _profiles(bench: Bench) -> Callable[[FloatArray], dict[str, FloatArray]]:
    """Pressures, speed and dose at any time: steps through a first-order lag, as a pump and its hose give them."""
    rng = np.random.default_rng(5)
    t = np.arange(-10.0, bench.duration + 10.0, 0.01)
    changes = np.arange(40.0, bench.duration, 15.0)
    dose = np.select([t < 40.0], [0.0], rng.choice([0.0, 0.3, 0.6, 1.0], len(changes) + 1)[np.searchsorted(changes, t)])
    target = np.where(t < bench.standing, 0.0, 9e5) - 1.5e5 * dose
    gauge = np.zeros_like(t)
    for k in range(1, len(t)):
        gauge[k] = gauge[k - 1] + 0.01 / 0.5 * (target[k] - gauge[k - 1])
    fine = {
        "y_p_ap": bench.ambient + gauge,
        "y_p_tp": bench.ambient - 0.02 * gauge,
        "y_p_du": bench.ambient + 0.97 * gauge - 0.03e5 * dose,
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
    du = at["y_p_du"] + 800.0 * rng.standard_normal(len(t)) + bench.trimmed * (ATMOSPHERE - bench.ambient)
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


def _channels(report: dict[str, object]) -> dict[str, dict[str, object]]:
    channels = report["channels"]
    assert isinstance(channels, list)
    return {channel["signal"]: channel for channel in channels}


def test_gives_back_the_clock(ingested: tuple[Path, dict[str, object]]) -> None:
    _, report = ingested
    assert _number(report, "offset_s") == pytest.approx(OFFSET, abs=0.02)
    assert _number(report, "drift_ppm") == pytest.approx(DRIFT * 1e6, abs=40)
    assert _number(report, "correlation") > 0.95


def test_gives_back_the_zero_errors(ingested: tuple[Path, dict[str, object]]) -> None:
    _, report = ingested
    zero = {name: channel["zero_pa"] for name, channel in _channels(report).items() if name in ZERO}
    assert zero == {name: pytest.approx(error, abs=100.0) for name, error in ZERO.items()}
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
    assert names == ["can.log", "ingest.json", "recording.toml", "synchronisation.png", "uds.dbc", "uniform.csv"]
    for name in names:
        assert (again / name).read_bytes() == (ingested[0] / name).read_bytes(), name


def test_a_drive_is_known_again_when_ingested_with_another_clock(
    tmp_path: Path, ingested: tuple[Path, dict[str, object]]
) -> None:
    """Its log is another one; what was tuned on the one must not be judged on the other."""
    folder, _ = ingested
    again, _ = _ingest(tmp_path, Bench(), "--offset", str(OFFSET + 0.3), "--drift", "60")
    logs = [open_log(folder), open_log(again)]
    assert len({log.sha256 for log in logs}) == 2
    assert {log.drive for log in logs} == {hashlib.sha256((tmp_path / "bench" / "can.log").read_bytes()).hexdigest()}


def test_bad_rows_and_cells_are_counted_and_the_rest_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def spoil(rows: list[str]) -> list[str]:
        rows[600] = "59.9,1.0"  # a cell is missing
        rows[700] = "garbage,1.0,1.0"
        rows[800] = rows[800].partition(",")[0] + ",,"  # blank
        rows[900] = rows[900].rpartition(",")[0] + ",4.9"  # beyond the table
        return [*rows[:-1], rows[-1][:9]]  # cut off

    folder, report = _ingest(tmp_path, Bench(spoil=spoil))
    assert report["bad_rows"] == 3
    lost = {name: (channel["blank"], channel["outside_table"]) for name, channel in _channels(report).items()}
    assert (lost["y_p_tp"], lost["y_p_ap"]) == ((1, 0), (1, 1))
    assert report["first_bad_row"] == "line 601: 2 cells instead of 3"
    said = capsys.readouterr().out
    assert "3 bad rows (first: line 601: 2 cells instead of 3)" in said
    assert "1 cells without a value; 1 cells outside the table" in said
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
    assert {channel["zero_pa"] for channel in _channels(report).values()} == {None}
    assert "keep their datasheet's zero" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("hPa", "options", "source"),
    [(845.0, (), "seen"), (845.0, ("--ambient-hpa", "845"), "given"), (1013.25, (), "assumed")],
)
def test_at_altitude_only_each_sensors_own_error_is_taken_off(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], hPa: float, options: tuple[str, ...], source: str
) -> None:
    _, report = _ingest(tmp_path, Bench(duration=120.0, ambient=100.0 * hPa), *options)
    said = capsys.readouterr().out
    zero = {name: channel["zero_pa"] for name, channel in _channels(report).items() if name in ZERO}
    assert zero == {name: pytest.approx(error, abs=300.0) for name, error in ZERO.items()}
    assert report["ambient"] == source
    assert _number(report, "ambient_pa") == pytest.approx(100.0 * hPa, abs=200.0)
    assert ("DOUBTFUL: at standstill all sensors show about 84" in said) == (source == "seen")
    assert ("set the model's ambient pressures (p_tank, p_exh) to 84" in said) == (hPa < 1000.0)
    assert "mbar taken off" in said


def test_zeros_that_are_alike_are_doubted_though_the_controllers_own_sensor_is_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As at altitude, where the controller trims its own."""
    _ingest(tmp_path, Bench(duration=120.0, ambient=84_500.0, trimmed=True))
    assert "DOUBTFUL: all added sensors are off alike from 1013 hPa" in capsys.readouterr().out


def test_a_bench_log_of_two_buses_is_not_merged(tmp_path: Path) -> None:
    """It became one vehicle's, all of it on can0, and no later check could see that."""
    bench = _write(tmp_path / "bench", Bench())
    lines = (bench / "can.log").read_text().splitlines(keepends=True)
    (bench / "can.log").write_text("".join(line + line.replace(" can0 ", " can1 ") for line in lines))
    arguments = [str(bench), "--out", str(tmp_path / "logs")]
    with pytest.raises(InputError, match=r"the same messages come on can0 and can1: say which bus with `channel`"):
        main(arguments)
    text = (bench / "recording.toml").read_text()
    (bench / "recording.toml").write_text(text.replace("[can]\n", '[can]\nchannel = "can1"\n'))
    assert main(arguments) == 0


@pytest.mark.parametrize("hPa", ["84500", "0.845", "-845"])
def test_an_ambient_pressure_in_another_unit_is_refused(tmp_path: Path, hPa: str) -> None:
    with pytest.raises(InputError, match=r"--ambient-hpa .*: give an absolute pressure between 500 and 1100 hPa"):
        main([str(tmp_path), "--out", str(tmp_path), f"--ambient-hpa={hPa}"])


def test_json_is_the_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, report = _ingest(tmp_path, Bench(duration=120.0), "--json")
    assert json.loads(capsys.readouterr().out) == report


OTHER_NAMES = {"y_p_ap": "s_up", "y_p_du": "s_down", "n_p": "speed", "dc_dose": "duty", "UDS_SENSORS": "ADDED"}


def _renamed(path: Path) -> None:
    text = path.read_text()
    for old, new in OTHER_NAMES.items():
        text = re.sub(rf"\b{old}\b", new, text)
    path.write_text(text)


def test_another_systems_names_give_the_same_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Roles are read from the system: with other names for the same quantities every frame is the same."""
    plain, _ = _ingest(tmp_path, Bench(duration=120.0))
    system, bench = tmp_path / "plant", tmp_path / "bench"
    shutil.copytree(SYSTEMS / "uds", system)
    (bench / "uds.dbc").rename(bench / "plant.dbc")
    for path in (system / "model.toml", system / "system.toml", bench / "plant.dbc", bench / "recording.toml"):
        _renamed(path)
    text = (bench / "recording.toml").read_text().replace("uds.dbc", "plant.dbc")
    digest = hashlib.sha256((bench / "plant.dbc").read_bytes()).hexdigest()
    (bench / "recording.toml").write_text(text.replace(hashlib.sha256(DBC).hexdigest(), digest))
    arguments = [str(bench), "--out", str(tmp_path / "other")]
    with pytest.raises(InputError, match=r"external\.tables has no y_p_ap, which the clocks are aligned by"):
        main(arguments)
    capsys.readouterr()
    assert main([*arguments, "--system", str(system), "--offset", "5"]) == 0
    assert "s_up DOES NOT FOLLOW s_down" in capsys.readouterr().out
    assert main([*arguments, "--system", str(system), "--force"]) == 0
    folder = tmp_path / "other" / "made-up"
    assert (folder / "can.log").read_bytes() == (plain / "can.log").read_bytes()
    assert (folder / "uniform.csv").read_text().startswith("t,y_p_tp,s_up,s_down,speed,duty\n")
    assert load_recording(folder).can_log.dbc == "plant.dbc"


def test_a_system_without_a_bench_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"three-tank/system\.toml: has no \[bench\], .* add it as docs/recordings"):
        main([str(tmp_path), "--out", str(tmp_path), "--system", "three-tank"])
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "system.toml").write_text("schema = 1\n[bench]\n")
    monkeypatch.setattr(bench_module, "SYSTEMS", tmp_path)
    with pytest.raises(InputError, match=r"which system is on the bench\? give --system, one of one, two or a folder"):
        setup_of(None)


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


def _column(place: int, change: Callable[[int, float], str]) -> Callable[[list[str]], list[str]]:
    """Changes the cells of one column, by row number and value."""

    def spoil(rows: list[str]) -> list[str]:
        cells = [row.split(",") for row in rows]
        for number, row in enumerate(cells[1:], start=1):
            row[place] = change(number, float(row[place]))
        return [",".join(row) for row in cells]

    return spoil


def _other_drive() -> Callable[[int, float], str]:
    """Another drive's pressure under this drive's times."""
    noise = np.cumsum(np.random.default_rng(1).standard_normal(2000)) / 40.0
    return lambda number, _: f"{2.0 + noise[number]:.4f}"


def _set_back(rows: list[str]) -> list[str]:
    return [*rows[:700], *(f"{float(row.split(',')[0]) - 60.0:.4f},{row.partition(',')[2]}" for row in rows[700:])]


def _shuffled(rows: list[str]) -> list[str]:
    return [row for k in range(0, len(rows) - 1, 2) for row in (rows[k + 1], rows[k])][1:] + rows[-1:]


@pytest.mark.parametrize(
    ("bench", "words"),
    [
        (Bench(duration=120.0, spoil=_column(2, _other_drive())), "is downstream|downstream of it|does not follow"),
        (Bench(duration=120.0, spoil=_column(2, lambda *_: "1.0")), r"p_ap_V \(y_p_ap\): is constant at 2.000 bar"),
        (Bench(duration=120.0, spoil=_column(1, lambda *_: "1.0")), r"p_tp_V \(y_p_tp\): is constant"),
        (Bench(duration=120.0, spoil=_column(2, lambda _, v: f"{1e3 * v:.1f}")), "median is .* looks like mV, give V"),
        (Bench(duration=120.0, spoil=_column(2, lambda _, v: f"{v + 1.0:.4f}")), "y_p_ap reads 5.0. bar at standstill"),
        (Bench(duration=120.0, spoil=_column(1, lambda _, v: f"{v * 0.4:.4f}")), "y_p_tp reads 0.2. bar at standstill"),
        (
            Bench(spoil=_column(2, lambda _, v: f"{0.5 + 0.6 * (v - 0.5):.4f}")),
            r"y_p_ap reads 3.. bar less than y_p_du",
        ),
        (
            Bench(duration=120.0, spoil=_column(0, lambda _, v: f"{1e3 * v:.1f}")),
            "time goes on by 100.* from row to row",
        ),
        (Bench(duration=120.0, spoil=_set_back), "line 701: time goes back from 69.[89].* to .* split the file there"),
        (Bench(duration=120.0, spoil=lambda rows: [rows[0], *_shuffled(rows[1:])]), "rows cannot be used"),
        (Bench(duration=120.0, spoil=lambda rows: rows[:200]), "less than 30 s in common at any offset"),
        (Bench(duration=120.0, spoil=lambda rows: rows[:1]), "external.csv: no two rows can be read"),
        (Bench(duration=120.0, spoil=lambda _: []), "external.csv: line 1: no column time_s, p_tp_V, p_ap_V"),
        (Bench(duration=120.0, spoil=lambda rows: ["time_s,p_tp_V", *rows[1:]]), "no column p_ap_V; recording.toml"),
        (Bench(duration=120.0, tables="y_p_tp"), "external.tables has no y_p_ap"),
    ],
)
def test_what_cannot_be_used_is_refused(tmp_path: Path, bench: Bench, words: str) -> None:
    folder = _write(tmp_path / "bench", bench)
    with pytest.raises(InputError, match=words) as caught:
        main([str(folder), "--out", str(tmp_path / "logs")])
    assert str(folder) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "logs").exists()


def test_a_clock_that_was_set_midway_is_named(tmp_path: Path) -> None:
    """On a drive of the rig, whose doses are not alike: the made-up ones here fit a second later nearly as well."""
    asked = Request("drive", vehicle("bench"), CYCLES["drive"], (), 11, 600.0)
    folder, _ = record(asked, load_dbc(), tmp_path / "out", tmp_path / "truth", force=False, progress=lambda _: None)
    rows = (folder / "external.csv").read_text().splitlines()
    later = _column(0, lambda number, t: f"{t + (number > 2200):.4f}")(rows)
    (folder / "external.csv").write_text("\n".join([*later, ""]))
    with pytest.raises(InputError, match=r"from \d+ to \d+ s the windows say another offset .* split the recording"):
        main([str(folder), "--out", str(tmp_path / "logs")])


def test_swapped_columns_are_named(tmp_path: Path) -> None:
    folder = _write(tmp_path / "bench", Bench())
    text = (folder / "recording.toml").read_text().replace('"p_tp_V"', '"other"').replace('"p_ap_V"', '"p_tp_V"')
    (folder / "recording.toml").write_text(text.replace('"other"', '"p_ap_V"'))
    noise = np.random.default_rng(7)
    rows = (folder / "external.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows[1:]]
    tank = [
        f"{t},{2.1 + 0.005 * noise.standard_normal():.4f},{v}" for t, _, v in cells
    ]  # hardly anything happens there
    (folder / "external.csv").write_text("\n".join([rows[0], *tank, ""]))
    with pytest.raises(InputError, match=r"column of y_p_tp follows .* that of y_p_ap does not; the two are swapped"):
        main([str(folder), "--out", str(tmp_path / "logs")])


def test_a_stuck_sensor_of_the_controller_tells_no_clock_but_one_may_be_given(tmp_path: Path) -> None:
    folder = _write(tmp_path / "bench", Bench(duration=120.0))
    lines = (folder / "can.log").read_text().splitlines()
    stuck = [line[: line.index("#") + 1] + "204E" + line[line.index("#") + 5 :] for line in lines]
    (folder / "can.log").write_text("\n".join([*stuck, ""]))
    with pytest.raises(InputError, match=r"y_p_du is constant at 10\.000 bar; the controller's sensor is stuck"):
        main([str(folder), "--out", str(tmp_path / "logs")])
    assert main([str(folder), "--out", str(tmp_path / "logs"), "--offset", str(OFFSET)]) == 0


def test_loggers_that_never_ran_together_are_refused(tmp_path: Path) -> None:
    """The other half of the drive is no alignment: what little the ends have in common by chance is not believed."""
    folder = _write(tmp_path / "bench", Bench())
    lines = (folder / "can.log").read_text().splitlines()
    (folder / "can.log").write_text("\n".join([*lines[:900], ""]))  # until 180 s
    rows = (folder / "external.csv").read_text().splitlines()
    (folder / "external.csv").write_text("\n".join([rows[0], *rows[2200:], ""]))  # from 220 s on
    with pytest.raises(InputError, match=r"cannot be aligned for certain|does not follow"):
        main([str(folder), "--out", str(tmp_path / "logs")])
    with pytest.raises(InputError, match="nothing overlaps: check --offset"):
        main([str(folder), "--out", str(tmp_path / "logs"), "--offset", "0"])


def test_a_clock_given_by_hand_is_taken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, report = _ingest(tmp_path, Bench(duration=120.0), "--offset", "-2.345", "--drift", "37")
    assert (report["clock"], report["offset_s"], report["drift_ppm"]) == ("given", -2.345, 37.0)
    assert report["clock_error_s"] is None
    assert _number(report, "correlation") > 0.95
    assert "offset -2.345 s, drift +37.0 ppm (given" in capsys.readouterr().out
    assert (folder / "synchronisation.png").read_bytes().startswith(b"\x89PNG")


def test_a_clock_given_wrongly_is_taken_but_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _ingest(tmp_path, Bench(duration=120.0), "--offset", "5")
    assert "y_p_ap DOES NOT FOLLOW y_p_du with it" in capsys.readouterr().out


def test_a_drift_alone_says_nothing(tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as caught:
        main([str(tmp_path), "--out", str(tmp_path), "--drift", "37"])
    assert caught.value.code == 2


@pytest.mark.parametrize(("separator", "decimal"), [(";", ","), (";", "."), ("\t", ",")])
def test_other_separators_and_decimal_commas_are_read(tmp_path: Path, separator: str, decimal: str) -> None:
    def foreign(rows: list[str]) -> list[str]:
        return [row.replace(",", separator).replace(".", decimal) for row in rows]

    plain, _ = _ingest(tmp_path / "plain", Bench(duration=120.0))
    other, _ = _ingest(tmp_path / "other", Bench(duration=120.0, spoil=foreign))
    assert (other / "can.log").read_bytes() == (plain / "can.log").read_bytes()


def test_a_silence_stays_empty_and_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """For a third of the time y_p_du is off and the logger lost 10 s: the rest aligns, and nothing is made up."""
    bench = _write(tmp_path / "bench", Bench(spoil=lambda rows: [*rows[:2500], *rows[2600:]]))
    lines = (bench / "can.log").read_text().splitlines()
    off = range(1100, 1800)
    changed = [
        line.partition("#")[0] + "#FFFF" + line.partition("#")[2][4:] if k in off else line
        for k, line in enumerate(lines)
    ]
    (bench / "can.log").write_text("\n".join([*changed, ""]))
    assert main([str(bench), "--out", str(tmp_path / "logs")]) == 0
    folder = tmp_path / "logs" / "made-up"
    channels = _channels(json.loads((folder / "ingest.json").read_text()))
    assert [name for name, channel in channels.items() if channel["gaps"]] == ["y_p_tp", "y_p_ap", "y_p_du"]
    assert channels["y_p_du"]["gaps"] == [[pytest.approx(220.0, abs=0.3), pytest.approx(360.0, abs=0.3)]]
    assert "silent 1 times for 140.2 s (219.8..360.0 s), left empty" in capsys.readouterr().out
    with (folder / "uniform.csv").open() as stream:
        rows = {float(row["t"]): row for row in csv.DictReader(stream)}
    assert (rows[300.0]["y_p_du"], rows[252.0]["y_p_ap"]) == ("", "")
    assert "" not in (rows[300.0]["y_p_ap"], rows[300.0]["n_p"], rows[252.0]["n_p"], rows[240.0]["y_p_ap"])


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

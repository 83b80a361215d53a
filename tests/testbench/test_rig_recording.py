"""The files: what a bench would hand over and nothing more, the truth apart, equal bytes for equal requests."""

import hashlib
import tomllib
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import can
import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database

from faultline.testbench import can_logger
from faultline.testbench.bus import Knowledge, load_dbc
from faultline.testbench.cycles import CYCLES
from faultline.testbench.errors import RigError
from faultline.testbench.faults import Fault
from faultline.testbench.recording import record
from faultline.testbench.request import Request
from faultline.testbench.second_logger import RANGES
from faultline.testbench.sensors import EcuSensors
from faultline.testbench.vehicles import VEHICLES

DURATION = 70.0
FAULT = Fault("fA_du", 0.65, 50.0)


def request(name: str = "r", seed: int = 3, faults: tuple[Fault, ...] = (FAULT,)) -> Request:
    return Request(name, VEHICLES["bench"], CYCLES["validation"], faults, seed, DURATION)


def write(folder: Path, wanted: Request, force: bool = False) -> tuple[Path, Path]:
    return record(wanted, load_dbc(), folder / "out", folder / "truth", force=force, progress=lambda _: None)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return write(tmp_path_factory.mktemp("rig"), request())


@pytest.fixture(scope="module")
def signals(recording: tuple[Path, Path]) -> dict[str, list[tuple[float, dict[str, float]]]]:
    """Every message of the CAN log by name, decoded by the recording's own DBC."""
    database = cantools.database.load_file(recording[0] / "uds.dbc", strict=True)
    assert isinstance(database, Database)
    found = defaultdict(list)
    for line in (recording[0] / "can.log").read_text().splitlines():
        stamp, channel, frame = line.split()
        identifier, data = frame.split("#")
        assert channel == "can0"
        assert len(identifier) == 8
        message = database.get_message_by_frame_id(int(identifier, 16))
        assert len(data) == 2 * message.length
        values = message.decode(bytes.fromhex(data))
        assert isinstance(values, dict)
        found[message.name].append((float(stamp.strip("()")), {k: float(str(v)) for k, v in values.items()}))
    return dict(found)


def external(recording: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.loadtxt(recording / "external.csv", delimiter=",", skiprows=1)


def test_folder_holds_the_four_files_and_names_them(recording: tuple[Path, Path]) -> None:
    folder, _ = recording
    assert {path.name for path in folder.iterdir()} == {"recording.toml", "can.log", "external.csv", "uds.dbc"}
    about = tomllib.loads((folder / "recording.toml").read_text())
    assert (about["schema"], about["id"], about["kind"]) == (1, "r", "bench")
    assert (about["vehicle"], about["cycle"], about["sensor_set"]) == ("bench", "validation", "instrumented")
    assert about["can"]["file"] == "can.log"
    assert about["can"]["dbc_sha256"] == hashlib.sha256((folder / "uds.dbc").read_bytes()).hexdigest()
    assert set(about["external"]["tables"]) == {"y_p_tp", "y_p_ap"}
    header = (folder / "external.csv").read_text().splitlines()[0].split(",")
    tables = about["external"]["tables"].values()
    assert header == [about["external"]["time_column"], *(table["column"] for table in tables)]


def test_truth_is_apart_and_says_the_fault(recording: tuple[Path, Path]) -> None:
    folder, truth = recording
    assert not truth.is_relative_to(folder)
    fault = {"name": "fA_du", "size": 0.65, "unit": "1", "onset_s": 50.0, "profile": "abrupt"}
    expected = {"schema": 1, "recording": "r", "fault": [fault], "effects": {"laminar_filters": 0.06}, "vehicle": {}}
    told = tomllib.loads(truth.read_text())
    assert set(told.pop("logger")) == {*RANGES, "offset_s", "drift"}
    assert told == expected
    for path in folder.iterdir():
        assert b"fA_du" not in path.read_bytes()


def test_bus_carries_the_controllers_frames_only(signals: dict[str, list[tuple[float, dict[str, float]]]]) -> None:
    assert set(signals) == {"UDS_ECU", "A1SCRDSI1", "A1SCRDSR1", "A1SCRDSR3", "A1DEFSI", "AT1T1I1"}


def test_frames_come_at_their_cycle_times_with_jitter(
    signals: dict[str, list[tuple[float, dict[str, float]]]],
) -> None:
    for name, period in {"UDS_ECU": 0.2, "A1SCRDSI1": 0.05, "A1DEFSI": 1.0}.items():
        gaps = np.diff([t for t, _ in signals[name]])
        assert gaps.mean() == pytest.approx(period, rel=0.02)
        assert 1e-4 < gaps.std() < 0.1 * period


def test_log_starts_at_zero_and_time_only_advances(recording: tuple[Path, Path]) -> None:
    lines = (recording[0] / "can.log").read_text().splitlines()
    stamps = [float(line[1 : line.index(")")]) for line in lines]
    assert stamps[0] == can_logger.START
    assert stamps[-1] - stamps[0] == pytest.approx(DURATION, abs=0.1)
    assert (np.diff(stamps) > 2e-4).all()  # a frame takes its time on the bus


def test_signals_agree_across_frames_and_have_sane_values(
    signals: dict[str, list[tuple[float, dict[str, float]]]],
) -> None:
    ecu = [values for t, values in signals["UDS_ECU"] if t - can_logger.START > 62]
    assert np.mean([v["y_p_du"] for v in ecu]) == pytest.approx(1000, abs=20)
    assert np.mean([v["n_p"] for v in ecu]) == pytest.approx(33, abs=1)
    assert {v["dc_dose"] for v in ecu} == {100.0}
    start = [values for t, values in signals["UDS_ECU"] if t - can_logger.START < 10]
    assert np.mean([v["y_p_du"] for v in start]) == pytest.approx(101.3, abs=1)
    assert {v["n_p"] for v in start} == {0.0}
    coarse = [values["def_doser_pressure"] for t, values in signals["A1SCRDSI1"] if t - can_logger.START > 62]
    assert np.mean(coarse) == pytest.approx(1000, abs=20)
    rpm = [values["def_pump_speed"] for t, values in signals["A1DEFSI"] if t - can_logger.START > 62]
    assert np.mean(rpm) == pytest.approx(33 * 60, rel=0.03)


def test_bytes_without_a_signal_are_not_available(recording: tuple[Path, Path]) -> None:
    """J1939-71: a receiver must be able to tell what is not sent from zero."""
    for line in (recording[0] / "can.log").read_text().splitlines():
        identifier, data = line.split()[2].split("#")
        if identifier == "18FF103D":
            assert data.endswith("FFFF")
        if identifier == "0CF0233D":
            assert (data[4:10], data[12:]) == ("FFFFFF", "FFFF")


def test_payload_is_limited_to_the_range_that_means_a_value() -> None:
    """A sensor beyond the scale must not turn into J1939's `error` or `not available`."""
    sender = next(s for s in load_dbc().controllers if s.message.name == "UDS_ECU")
    data = sender.encode(Knowledge(p_du=1e9, n_p=1e9, duty=1e9, request=0.0))
    assert all(int.from_bytes(data[i : i + 2], "little") <= 0xFAFF for i in (0, 2, 4))


def test_volts_lie_on_the_converters_grid_and_hide_the_true_pressure(recording: tuple[Path, Path]) -> None:
    rows = external(recording[0])
    step = 5 / 2**14
    assert np.abs(rows[:, 1:] / step - np.round(rows[:, 1:] / step)).max() < 0.5 * 1e-4 / step + 1e-6
    assert rows[:, 1:].min() > 0.5
    assert rows[:, 1:].max() < 4.5


def test_external_sensors_have_noise_and_a_zero_error_at_rest(recording: tuple[Path, Path]) -> None:
    about = tomllib.loads((recording[0] / "recording.toml").read_text())
    rows = external(recording[0])
    rest = rows[rows[:, 0] < 10]
    for column, (signal, noise) in enumerate({"y_p_tp": 400, "y_p_ap": 800}.items(), start=1):
        table = about["external"]["tables"][signal]
        pascal = np.interp(rest[:, column], table["volts"], table["pascal"])
        assert pascal.std() == pytest.approx(noise, rel=0.3)
        assert 100 < abs(pascal.mean() - 101_325) < 1e4


def test_controller_sensor_saturates_and_has_twelve_bits() -> None:
    sensors = EcuSensors()
    readings = {sensors.p_du(p, 0.0) for p in np.linspace(9.99e5, 10.01e5, 200)}
    assert 5 <= len(readings) <= 7
    assert sensors.p_du(99e5, 0.0) < 16e5
    assert sensors.p_du(-1e5, 0.0) == 0.0
    assert sensors.n_p(0.0, 3.0) == 0.0


def test_equal_requests_give_equal_bytes_and_other_seeds_do_not(tmp_path: Path, recording: tuple[Path, Path]) -> None:
    again, truth = write(tmp_path, request())
    for path in again.iterdir():
        assert path.read_bytes() == (recording[0] / path.name).read_bytes()
    assert truth.read_bytes() == recording[1].read_bytes()
    other, _ = write(tmp_path, request(name="other", seed=4))
    for name in ("can.log", "external.csv"):
        assert (other / name).read_bytes() != (again / name).read_bytes()


def test_existing_recording_is_replaced_only_by_force(tmp_path: Path) -> None:
    folder, truth = write(tmp_path, request(faults=()))
    assert "fault" not in tomllib.loads(truth.read_text())
    (folder / "can.log").write_text("old")
    with pytest.raises(RigError, match="--force"):
        write(tmp_path, request())
    assert (folder / "can.log").read_text() == "old"
    write(tmp_path, request(), force=True)
    assert (folder / "can.log").read_text() != "old"
    assert [path.name for path in folder.parent.iterdir()] == ["r"]


@pytest.mark.parametrize("wanted", ["asc", "blf", "csv", "trc"])
def test_the_can_log_comes_in_other_formats(tmp_path: Path, recording: tuple[Path, Path], wanted: str) -> None:
    folder, _ = write(tmp_path, replace(request(), format=wanted))
    description = tomllib.loads((folder / "recording.toml").read_text())
    assert description["can"]["file"] == f"can.{wanted}"
    again, _ = write(tmp_path / "again", replace(request(), format=wanted))
    path = folder / f"can.{wanted}"
    if wanted in ("blf", "csv"):  # python-can writes the time of writing into the head of the others
        assert path.read_bytes() == (again / path.name).read_bytes()
    with can.LogReader(path) as other, can.LogReader(recording[0] / "can.log") as plain:
        found, expected = list(other), list(plain)
    assert [(m.arbitration_id, bytes(m.data)) for m in found] == [(m.arbitration_id, bytes(m.data)) for m in expected]
    times, wanted_times = ([m.timestamp - of[0].timestamp for m in of] for of in (found, expected))
    assert np.abs(np.subtract(times, wanted_times)).max() < 2e-4


@pytest.mark.parametrize(("size", "code"), [(1.0, 0xFFFF), (2.0, 0xFEFF)])
def test_a_sensor_that_is_off_is_said_in_the_codes_of_j1939(tmp_path: Path, size: float, code: int) -> None:
    """And the controller, blind, stops pump and dosing."""
    folder, _ = write(tmp_path, request(faults=(Fault("off_p_du", size, 60.0),)))
    database = cantools.database.load_file(folder / "uds.dbc", strict=True)
    assert isinstance(database, Database)
    message = database.get_message_by_name("UDS_ECU")
    p_du = next(signal for signal in message.signals if signal.name == "y_p_du")
    signals: list[tuple[float, float, float]] = []
    with can.LogReader(folder / "can.log") as frames:
        for frame in frames:
            if frame.arbitration_id == message.frame_id:
                raw = message.decode_simple(bytes(frame.data), scaling=False)
                signals.append((frame.timestamp, float(str(raw["y_p_du"])), float(str(raw["dc_dose"]))))
    t, read, dose = np.array(signals).T
    late, early = t - t[0] > 61.0, t - t[0] < 59.0
    top = (1 << p_du.length) - 1
    codes = {0xFFFF: top, 0xFEFF: top - (1 << (p_du.length - 8))}
    assert set(read[late]) == {codes[code]}
    assert codes[code] not in set(read[early])
    assert set(dose[late]) == {0}

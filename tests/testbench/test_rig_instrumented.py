"""The instrumented vehicle: the added sensors on the bus, zeroed, at 10 Hz, and the service reads the recording."""

import tomllib
from dataclasses import replace
from pathlib import Path

import cantools.database
import numpy as np
import pytest
from cantools.database.can import Database

from faultline.service.diagnose.command import main as diagnose
from faultline.service.logs import open_log
from faultline.service.logs.recording import load_recording
from faultline.testbench.bus import load_dbc
from faultline.testbench.command import main
from faultline.testbench.cycles import CYCLES
from faultline.testbench.faults import Fault
from faultline.testbench.plant import Array
from faultline.testbench.recording import record
from faultline.testbench.request import Kind, Request
from faultline.testbench.simulation import simulate
from faultline.testbench.units import ATMOSPHERE
from faultline.testbench.vehicles import VEHICLES

GOLDEN_BUNDLE = Path(__file__).parents[1] / "golden" / "bundle"
DURATION = 70.0


def made(folder: Path, *faults: Fault, seed: int = 3, kind: Kind = "instrumented") -> Path:
    wanted = Request("r", VEHICLES["bench"], CYCLES["validation"], faults, seed, DURATION)
    wanted = replace(wanted, kind=kind)
    return record(wanted, load_dbc(), folder / "out", folder / "truth", force=True, progress=lambda _: None)[0]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("rig"))


def sensors(folder: Path, *, scaled: bool = True) -> Array:
    """(frames, 3): time [s], y_p_tp, y_p_ap [kPa, or raw]."""
    database = cantools.database.load_file(folder / "uds.dbc", strict=True)
    assert isinstance(database, Database)
    message = database.get_message_by_name("UDS_SENSORS")
    found = []
    for frame in open_log(folder).relative():
        if frame.can_id == message.frame_id:
            values = message.decode_simple(frame.data, scaling=scaled)
            found.append((frame.t, float(str(values["y_p_tp"])), float(str(values["y_p_ap"]))))
    return np.array(found)


def test_the_service_loads_it(recording: Path) -> None:
    loaded = load_recording(recording)
    assert (loaded.kind, loaded.sensor_set, loaded.external) == ("instrumented", "instrumented", None)
    assert {path.name for path in recording.iterdir()} == {"recording.toml", "can.log", "uds.dbc"}
    assert "logger" not in tomllib.loads((recording.parents[1] / "truth" / "r.toml").read_text())


def test_a_production_vehicle_has_all_but_the_added_sensors(recording: Path, tmp_path: Path) -> None:
    folder = made(tmp_path, kind="production")
    loaded = load_recording(folder)
    assert (loaded.kind, loaded.sensor_set, loaded.external) == ("instrumented", "production", None)
    ids = [{frame.can_id for frame in open_log(each).frames()} for each in (recording, folder)]
    assert ids[0] - ids[1] == {load_dbc().sensor_box.message.frame_id}
    assert not ids[1] - ids[0]


def test_sensor_frames_come_at_ten_hertz_with_jitter(recording: Path) -> None:
    gaps = np.diff(sensors(recording)[:, 0])
    assert gaps.mean() == pytest.approx(0.1, rel=0.01)
    assert 1e-3 < gaps.std() < 0.01
    assert np.diff([frame.t for frame in open_log(recording).frames()]).min() > 2e-4  # one frame at a time


def test_sensors_follow_the_plant_with_noise_and_are_zeroed(recording: Path) -> None:
    read = sensors(recording)
    run = simulate(VEHICLES["bench"], CYCLES["validation"], (), 3, DURATION)
    for column, place, sensor in ((1, 0, "y_p_tp"), (2, 2, "y_p_ap")):
        noise = VEHICLES["bench"].external[sensor].noise
        error = 1e3 * read[:, column] - np.interp(read[:, 0], run.t, run.pressures[:, place])
        assert error.std() == pytest.approx(noise, rel=0.1)
        rest = 1e3 * read[read[:, 0] < 14.0, column]
        assert abs(rest.mean() - ATMOSPHERE) < 0.6 * noise  # 0.14 of it, sd; a bench's zero error is 4 times the noise


def test_the_controllers_frames_are_those_of_the_bench(tmp_path: Path, recording: Path) -> None:
    """The box only delays the others a little, which may cost one of them a period of the controller."""
    bench = made(tmp_path, kind="bench")
    lines = [(path / "can.log").read_text().split() for path in (bench, recording)]
    plain, more = (found[2::3] for found in lines)
    others = [frame for frame in more if not frame.startswith("18FF20")]
    assert [frame[:9] for frame in others] == [frame[:9] for frame in plain]
    assert sum(a != b for a, b in zip(others, plain, strict=True)) < 0.01 * len(plain)


@pytest.mark.parametrize(("size", "top"), [(1.0, 0xFF), (2.0, 0xFE)])
@pytest.mark.parametrize(("name", "column"), [("off_p_tp", 1), ("off_p_ap", 2)])
def test_a_sensor_that_is_off_says_so(tmp_path: Path, name: str, column: int, size: float, top: int) -> None:
    raw = sensors(made(tmp_path, Fault(name, size, 60.0)), scaled=False)
    late = raw[:, 0] > 60.0
    assert {int(value) >> 8 for value in raw[late, column]} == {top}
    assert (raw[~late, column] < 0xFB00).all()
    assert (raw[:, 3 - column] < 0xFB00).all()


def test_a_biased_sensor_is_biased(tmp_path: Path, recording: Path) -> None:
    biased, healthy = sensors(made(tmp_path, Fault("fy_p_ap", 2e4, 50.0))), sensors(recording)
    late = healthy[:, 0] > 50.0
    assert (biased[late, 2] - healthy[late, 2]).mean() == pytest.approx(20.0, rel=0.02)  # kPa
    assert (biased[~late] == healthy[~late]).all()


def test_diagnose_finds_a_fault_in_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = ["--out", str(tmp_path / "out"), "--truth", str(tmp_path / "truth")]
    fault = ["--fault", "fA_du", "--size", "0.65", "--onset", "70"]
    options = ["--kind", "instrumented", "--cycle", "validation", "--seed", "2", "--duration", "130", "--id", "r"]
    assert main(["record", *options, *fault, *folders]) == 0
    assert diagnose([str(tmp_path / "out/r"), "--bundle", str(GOLDEN_BUNDLE)]) == 1
    assert "fA_du" in capsys.readouterr().out


def test_it_has_no_second_logger_to_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = ["--out", str(tmp_path / "out"), "--truth", str(tmp_path / "truth")]
    options = ["--kind", "instrumented", "--logger", "noise=2"]
    assert main(["record", "--cycle", "drive", *options, *folders]) == 2
    assert "has no second logger to set; use --kind bench" in capsys.readouterr().err

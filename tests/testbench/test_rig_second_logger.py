"""The second logger: its own start, drift, jitter, losses and noise, by chance or as given, and what the truth says."""

import csv
import io
import tomllib
from pathlib import Path

import numpy as np
import pytest

from faultline.testbench.command import main
from faultline.testbench.cycles import CYCLES
from faultline.testbench.day import CALM
from faultline.testbench.errors import RigError
from faultline.testbench.faults import Fault
from faultline.testbench.second_logger import Clocking, SecondLogger, external_csv
from faultline.testbench.simulation import MARGIN, Run, simulate
from faultline.testbench.units import ATMOSPHERE
from faultline.testbench.vehicles import VEHICLES

Rows = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
DURATION = 60.0
SENSORS = VEHICLES["bench"].external


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate(VEHICLES["bench"], CYCLES["validation"], (), seed=3, duration=DURATION)


def rows(run: Run, logger: SecondLogger, seed: int = 1, faults: tuple[Fault, ...] = ()) -> tuple[Rows, Clocking]:
    random = np.random.default_rng(seed)
    clocking = logger.clocking(DURATION, random)
    text = external_csv(run, SENSORS, faults, DURATION, clocking, CALM, random, np.random.default_rng(2))
    return np.loadtxt(io.StringIO(text), delimiter=",", skiprows=1), clocking


def test_what_is_not_given_is_drawn(run: Run) -> None:
    recorded = [rows(run, SecondLogger(), seed) for seed in range(12)]
    for name, half in (("starts_s", 3.0), ("stops_s", 3.0), ("drift_ppm", 50.0)):
        values = [getattr(clocking, name) for _, clocking in recorded]
        assert -half < min(values) < -half / 4
        assert half / 4 < max(values) < half
    gaps = np.concatenate([np.diff(found[:, 0]) for found, _ in recorded])
    assert (gaps > 0).all()
    assert gaps.std() > 1e-3
    assert (gaps > 0.15).mean() == pytest.approx(0.005, abs=0.003)  # 7200 samples, sd 0.0008


def test_giving_one_changes_no_other() -> None:
    drawn = SecondLogger().clocking(DURATION, np.random.default_rng(1))
    given = SecondLogger(stops_s=20.0).clocking(DURATION, np.random.default_rng(1))
    assert (given.starts_s, given.drift_ppm) == (drawn.starts_s, drawn.drift_ppm)
    assert given.stops_s == 20.0


@pytest.mark.parametrize(("starts", "drift"), [(-87.3, 150.0), (2.0, -500.0), (20.0, 0.0)])
def test_the_inverse_finds_the_true_pressure_again(run: Run, starts: float, drift: float) -> None:
    """On the CAN time that the truth gives, a sensor without noise shows the plant's pressure of that very instant."""
    found, clocking = rows(run, SecondLogger(starts_s=starts, drift_ppm=drift, noise=0.0))
    offset, slope = clocking.inverse()
    t = offset + (1.0 + slope) * found[:, 0]
    sensor = SENSORS["y_p_ap"]
    read = np.interp(found[:, 2], sensor.volts, sensor.pascal)
    true = np.interp(t, run.t, run.pressures[:, 2])
    # 0.1 ms of the column times 1 bar/s, and a bit of the converter; a millisecond more would be 100 Pa more.
    error = read - true
    assert np.abs(error - np.median(error)).max() < 140
    assert abs(t[0] - starts) < 0.5
    assert t[-1] == pytest.approx(DURATION + clocking.stops_s, abs=1.0)


def test_before_the_run_everything_is_at_rest(run: Run) -> None:
    found, clocking = rows(run, SecondLogger(starts_s=-150.0, noise=0.0))
    offset, slope = clocking.inverse()
    early = offset + (1.0 + slope) * found[:, 0] < -MARGIN
    assert early.sum() > 1400
    assert np.ptp(found[early, 1:], axis=0).max() == 0.0


def test_after_the_log_the_run_goes_on(tmp_path: Path) -> None:
    """In the ladder's last step, at 10 bar: not at a pressure that merely stands still."""
    folders = ["--out", str(tmp_path / "out"), "--truth", str(tmp_path / "truth")]
    options = [
        "--duration",
        "60",
        "--id",
        "r",
        "--logger",
        "stops_s=60",
        "--logger",
        "dropped=0",
        "--logger",
        "noise=0",
    ]
    assert main(["record", "--cycle", "drive", *options, *folders]) == 0
    found = np.loadtxt(tmp_path / "out/r/external.csv", delimiter=",", skiprows=1)
    clock = tomllib.loads((tmp_path / "truth/r.toml").read_text())["logger"]
    t = clock["offset_s"] + (1 + clock["drift"]) * found[:, 0]
    assert t[-1] > 119.0
    late = t > 60.0 + MARGIN
    assert np.ptp(found[late, 2]) > 0.0
    assert np.diff(found[late, 2]).std() < 0.1


def test_more_is_lost_and_there_is_more_noise(run: Run) -> None:
    found, _ = rows(run, SecondLogger(starts_s=0.0, stops_s=0.0, dropped=0.3, noise=3.0))
    assert len(found) == pytest.approx(0.7 * 600, abs=40)
    sensor = SENSORS["y_p_tp"]
    rest = np.interp(found[found[:, 0] < 14.0, 1], sensor.volts, sensor.pascal)
    assert rest.std() == pytest.approx(3.0 * sensor.noise, rel=0.3)
    assert rest.mean() == pytest.approx(ATMOSPHERE, abs=4 * sensor.zero_sd)


def test_external_sensor_fault_shifts_the_reading_from_its_onset_on(run: Run) -> None:
    logger = SecondLogger(starts_s=0.0)
    healthy, _ = rows(run, logger)
    faulty, _ = rows(run, logger, faults=(Fault("fy_p_tp", 2e4, 30.0),))
    early, late = healthy[:, 0] < 29.9, healthy[:, 0] > 30.1
    assert (faulty[early] == healthy[early]).all()
    assert (faulty[late, 1] - healthy[late, 1]).mean() == pytest.approx(2e4 / 62_500, rel=0.02)
    assert (faulty[:, 2] == healthy[:, 2]).all()


@pytest.mark.parametrize(("size", "volts"), [(1.0, 0.0), (2.0, 5.0)])
@pytest.mark.parametrize(("name", "column"), [("off_p_tp", 1), ("off_p_ap", 2)])
def test_a_sensor_that_is_off_leaves_its_table(run: Run, name: str, column: int, size: float, volts: float) -> None:
    logger = SecondLogger(starts_s=0.0)
    found, _ = rows(run, logger, faults=(Fault(name, size, 30.0),))
    healthy, _ = rows(run, logger)
    late = found[:, 0] > 30.1
    assert set(found[late, column]) == {volts}
    assert (found[~late][:-1] == healthy[~late][:-1]).all()
    assert (found[:, 3 - column] == healthy[:, 3 - column]).all()
    assert not SENSORS["y_p_tp"].volts[0] <= volts <= SENSORS["y_p_tp"].volts[-1]


def test_columns_are_named(run: Run) -> None:
    clocking = SecondLogger().clocking(DURATION, np.random.default_rng(1))
    text = external_csv(run, SENSORS, (), DURATION, clocking, CALM, np.random.default_rng(1), np.random.default_rng(2))
    assert next(csv.reader(text.splitlines())) == ["time_s", "p_tp_V", "p_ap_V"]


def test_a_logger_that_stops_before_it_starts_is_refused() -> None:
    with pytest.raises(RigError, match=r"starts at 150\.0 s and would stop at 60\.5 s"):
        SecondLogger(starts_s=150.0, stops_s=0.5).clocking(DURATION, np.random.default_rng(1))


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("speed=3", "there is no 'speed'; choose one of starts_s, stops_s, drift_ppm, dropped, noise"),
        ("dropped", "'' is no number; write it like drift_ppm=150"),
        ("drift_ppm=900", "drift_ppm 900 of the second logger is not in -500..500"),
        ("starts_s=nan", "starts_s nan of the second logger is not in -150..150"),
    ],
)
def test_wrong_options_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], word: str, said: str) -> None:
    folders = ["--out", str(tmp_path / "out"), "--truth", str(tmp_path / "truth")]
    assert main(["record", "--cycle", "drive", "--logger", word, *folders]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []

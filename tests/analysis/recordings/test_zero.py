"""The zero is calibrated where the pump stands still in a drained system, and nowhere else."""

import numpy as np
import pytest

from faultline.analysis.recordings.bench import setup_of
from faultline.analysis.recordings.zero import ATMOSPHERE, ambient_seen, standstill, zero_error
from faultline.service.core.signals.values import FloatArray

SETUP = setup_of("uds")
T = np.arange(0.0, 60.0, 0.2)


def _until(starts: float, gauge: float = 0.0) -> float:
    return standstill(T, np.where(starts > T, 0.0, 20.0), np.full_like(T, ATMOSPHERE + gauge), SETUP)


def test_the_standstill_ends_a_second_before_the_pump_starts() -> None:
    assert _until(15.0) == pytest.approx(14.0, abs=0.2)


def test_a_pump_that_never_runs_stands_to_the_end() -> None:
    assert _until(1e9) == pytest.approx(T[-1] - 1.0)


@pytest.mark.parametrize(("starts", "gauge"), [(0.0, 0.0), (5.0, 0.0), (15.0, 5e5), (15.0, -0.3e5)])
def test_a_short_or_pressurised_standstill_is_none(starts: float, gauge: float) -> None:
    assert _until(starts, gauge) == 0.0


def _readings(error: float, noise: float, count: int = 140) -> FloatArray:
    return np.asarray(ATMOSPHERE + error + noise * np.random.default_rng(3).standard_normal(count))


def test_the_zero_error_is_given_back_in_spite_of_outliers_and_gaps() -> None:
    readings = _readings(2_500.0, 400.0)
    readings[::20] = 9e5
    readings[5::20] = np.nan
    assert zero_error(readings, SETUP) == pytest.approx(2_500.0, abs=100.0)


@pytest.mark.parametrize(
    "readings",
    [
        _readings(0.9e5, 400.0),  # more than any zero error: a fault
        _readings(0.0, 20_000.0),  # restless: not standing still
        _readings(0.0, 400.0, count=9),  # too few
        np.full(140, np.nan),
    ],
)
def test_what_cannot_be_a_zero_error_is_none(readings: FloatArray) -> None:
    assert zero_error(readings, SETUP) is None


@pytest.mark.parametrize(
    ("tp", "ap", "du", "ambient"),
    [
        (-170e2, -192e2, -168e2, -168e2),  # 845 hPa: all sensors show it, and the difference is their own
        (-120e2, -240e2, -168e2, -168e2),
        (-170e2, -192e2, 2e2, 0.0),  # the controller's own sensor shows 1013 hPa: both added ones are off
        (-2e2, 24e2, -168e2, 0.0),  # only the controller's own sensor is off
        (-170e2, 24e2, -168e2, 0.0),  # one added sensor contradicts
        (-30e2, -35e2, -30e2, 0.0),  # as much as weather does
    ],
)
def test_only_what_all_sensors_share_is_the_ambient_pressure(tp: float, ap: float, du: float, ambient: float) -> None:
    added = [_readings(tp, 400.0), _readings(ap, 800.0)]
    assert ambient_seen(added, _readings(du, 1000.0), SETUP) == pytest.approx(ATMOSPHERE + ambient, abs=200.0)


def test_without_readings_the_ambient_pressure_is_the_standard_one() -> None:
    assert ambient_seen([], _readings(-168e2, 1000.0), SETUP) == ATMOSPHERE
    assert ambient_seen([_readings(-168e2, 400.0)], _readings(-168e2, 1000.0, count=3), SETUP) == ATMOSPHERE

"""The clock is given back from made-up pressures, and doubted where it cannot be known."""

import numpy as np
import pytest
from scipy.signal import lfilter

from faultline.analysis.recordings.bench import setup_of
from faultline.analysis.recordings.clock import Clock, ClockError, synchronise
from faultline.analysis.recordings.steps import shared, steps
from faultline.analysis.recordings.track import Track
from faultline.service.core.signals.values import FloatArray

SETUP = setup_of("uds")
FINE_S = 0.01


def _pressure(target: FloatArray) -> FloatArray:
    """[Pa], every 10 ms: a hose follows `target` [Pa] within a second."""
    keep = float(np.exp(-FINE_S / 0.6))
    value, _ = lfilter([1 - keep], [1, -keep], target, zi=[keep * target[0]])
    return np.asarray(value)


def _drive(duration: float, seed: int = 1) -> FloatArray:
    """A target that steps up and down by about a bar every few seconds."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, duration, FINE_S)
    changes = np.cumsum(rng.uniform(3.0, 15.0, round(duration / 3)))
    return np.asarray(rng.uniform(8.5e5, 10.5e5, len(changes) + 1)[np.searchsorted(changes, t)])


def _periodic(duration: float) -> FloatArray:
    t = np.arange(0.0, duration, FINE_S)
    return np.where(np.mod(t, 20.0) < 10.0, 9e5, 10e5)


def _loggers(target: FloatArray, offset: float, drift: float, noise: float = 1_000.0) -> tuple[Track, Track]:
    """The follower from its logger's start on, and the reference; CAN time = offset + (1 + drift) logger time."""
    rng, fine = np.random.default_rng(2), np.arange(len(target)) * FINE_S
    pressure, end = _pressure(target), len(target) * FINE_S
    logger = np.arange(max(0.0, -offset), (end - offset) / (1 + drift), 0.1)
    logger += rng.uniform(-0.005, 0.005, len(logger))
    can = np.arange(0.0, end, 0.2) + rng.uniform(0.0, 0.02, len(np.arange(0.0, end, 0.2)))
    follower = np.interp(offset + (1 + drift) * logger, fine, pressure) + noise * rng.standard_normal(len(logger))
    return Track(logger, follower), Track(
        can, np.interp(can, fine, 0.98 * pressure) + 1_000.0 * rng.standard_normal(len(can))
    )


def _aligned(follower: Track, reference: Track) -> Clock:
    """Where nothing is dosed."""
    return synchronise(follower, reference, reference._replace(value=np.zeros_like(reference.t)), SETUP, "here")


def _error(clock: Clock, offset: float, drift: float, end: float) -> float:
    """The largest [s] over the logger's time."""
    t = np.array([max(0.0, -offset), end - offset])
    return float(np.abs(clock.can_time(t) - offset - (1 + drift) * t).max())


@pytest.mark.parametrize(("offset", "drift"), [(-118.0, 0.0), (117.3, 200e-6), (0.4, -200e-6)])
def test_offsets_of_two_minutes_and_drifts_of_200_ppm_are_given_back(offset: float, drift: float) -> None:
    clock = _aligned(*_loggers(_drive(400.0), offset, drift, noise=3_000.0))
    assert clock.confident, clock.doubt
    assert _error(clock, offset, drift, 400.0) < 0.03
    assert clock.error_s is not None
    assert clock.error_s < 0.022


def test_a_drift_of_200_ppm_over_an_hour_is_followed() -> None:
    """Regression: the windows were searched within 0.5 s of one lag, the clock went 0.72 s from it."""
    clock = _aligned(*_loggers(_drive(3600.0), 50.0, 200e-6))
    assert clock.confident
    assert clock.drift == pytest.approx(200e-6, abs=3e-6)
    assert _error(clock, 50.0, 200e-6, 3600.0) < 0.02


def test_a_sensor_that_is_off_a_third_of_the_time_costs_nothing_else() -> None:
    """Regression: the straight line over a silence did not correlate, and the recording was refused."""
    follower, reference = _loggers(_drive(600.0), -20.0, 50e-6)
    on = (reference.t % 60.0) > 20.0
    clock = _aligned(follower, Track(reference.t[on], reference.value[on]))
    assert clock.confident, clock.doubt
    assert clock.correlation > 0.9
    assert _error(clock, -20.0, 50e-6, 600.0) < 0.03


def test_a_slow_sensor_is_not_a_late_clock() -> None:
    follower, reference = _loggers(_drive(600.0), 10.0, 0.0)
    fine = np.arange(60_000) * FINE_S
    keep = float(np.exp(-FINE_S / 0.5))
    felt, _ = lfilter([1 - keep], [1, -keep], _pressure(_drive(600.0)), zi=[keep * 8.5e5])
    noise = 1_000.0 * np.random.default_rng(4).standard_normal(len(reference.t))
    clock = _aligned(follower, Track(reference.t, np.interp(reference.t, fine, felt) + noise))
    assert clock.slow_s == pytest.approx(0.5, abs=0.06)
    assert _error(clock, 10.0, 0.0, 600.0) < 0.05


def test_a_cycle_that_repeats_is_doubted() -> None:
    clock = _aligned(*_loggers(_periodic(400.0), -5.0, 0.0))
    assert "as in a cycle that repeats" in clock.doubt


def test_one_step_that_does_not_repeat_decides() -> None:
    target = np.where(np.arange(40_000) * FINE_S < 30.0, 1e5, _periodic(400.0))
    follower, reference = _loggers(target, -5.0, 0.0)
    assert shared(follower, reference, -5.0, SETUP) > 0.9 > 0.8 > shared(follower, reference, 15.0, SETUP)
    clock = _aligned(follower, reference)
    assert clock.confident, clock.doubt
    assert _error(clock, -5.0, 0.0, 400.0) < 0.03


def test_steps_are_found_where_half_of_them_is_done() -> None:
    t = np.arange(0.0, 60.0, 0.1)
    value = 1e5 + 8e5 * np.clip((t - 20.0) / 8.0, 0.0, 1.0) - 1e5 * (t > 45.0)
    first, second = steps(Track(t, value), SETUP)
    assert first.t == pytest.approx(24.0, abs=0.2)
    assert first.change == pytest.approx(8e5, rel=0.05)
    assert second.t == pytest.approx(45.0, abs=0.2)
    assert second.change == pytest.approx(-1e5, rel=0.1)


def test_another_drive_is_no_alignment() -> None:
    follower, _ = _loggers(_drive(400.0), 0.0, 0.0)
    _, reference = _loggers(_drive(400.0, seed=9), 0.0, 0.0)
    try:
        clock = _aligned(follower, reference)
    except ClockError:
        return
    assert clock.doubt


def test_pressures_that_do_not_move_have_no_alignment() -> None:
    follower, reference = _loggers(np.full(20_000, 9e5), 0.0, 0.0)
    try:
        clock = _aligned(follower, reference)
    except ClockError:
        return
    assert clock.doubt

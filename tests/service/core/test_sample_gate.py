"""The gate holds outliers back, alone or in bursts, and lets steps and pulses pass."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from faultline.service.core.manifest import Input
from faultline.service.core.signals.gate import SAMPLES, Gate
from faultline.service.core.signals.values import FloatArray, Mask

OUTLIER = 6.0
"""Of noise with a standard deviation of 1."""


def gated(values: FloatArray, usable: Mask | None = None) -> tuple[FloatArray, Mask]:
    """What passes of a signal (N,), and where it was held back; beside it a command that has no gate."""
    inputs = [
        Input(signal="y", unit="Pa", maximum_age_s=1.0, lower=-1e6, upper=1e6, outlier=OUTLIER),
        Input(signal="u", unit="1", maximum_age_s=1.0, lower=-1e6, upper=1e6),
    ]
    gate, passed, held = Gate(inputs), [], []
    for k, value in enumerate(values):
        good = np.array([True if usable is None else bool(usable[k]), True])
        z = gate.passed(np.array([value, 1e5 * (k % 2)]), good)
        passed.append(z[0])
        held.append(gate.held[0])
        assert (z[1], gate.held[1]) == (1e5 * (k % 2), False)
    return np.array(passed), np.array(held)


def noise(seed: int, count: int = 200) -> FloatArray:
    return np.random.default_rng(seed).normal(size=count)


@given(st.integers(0, 10_000), st.integers(1, 5), st.sampled_from([-1e5, -30.0, 30.0, 1e5]))
def test_a_burst_of_outliers_never_passes_and_the_last_good_sample_stands_for_it(
    seed: int, length: int, off: float
) -> None:
    values = np.clip(noise(seed), -1.5, 1.5)  # so 8 of 13 samples spread by 3 at most, and 6 * 1.4826 * 3 < 30 - 3
    first = 50
    dirty = values.copy()
    dirty[first : first + length] += off
    passed, held = gated(dirty)
    assert held[first : first + length].all()
    assert (passed[first : first + length] == passed[first - 1]).all()
    np.testing.assert_array_equal(passed[~held], dirty[~held])


def test_noise_of_a_healthy_sensor_is_not_held_back() -> None:
    passed, held = gated(noise(1, 20_000))
    assert held.mean() < 1e-4
    assert np.abs(passed).max() > 3.5


def test_a_step_passes_when_the_median_has_followed() -> None:
    values = noise(2)
    values[100:] += 1000.0
    passed, held = gated(values)
    assert np.flatnonzero(held).tolist() == list(range(100, 100 + SAMPLES // 2))
    assert passed[100 + SAMPLES // 2] == values[100 + SAMPLES // 2]


def test_what_lasts_was_a_step_and_what_comes_back_was_none() -> None:
    for length, is_step in ((1, False), (5, False), (100, True)):
        values = noise(8)
        values[50 : 50 + length] += 1000.0
        gate = Gate([Input(signal="y", unit="Pa", maximum_age_s=1.0, lower=-1e6, upper=1e6, outlier=OUTLIER)])
        stepped = []
        for value in values:
            gate.passed(np.array([value]), np.ones(1, dtype=np.bool_))
            stepped.append(bool(gate.stepped[0]))
        assert np.flatnonzero(stepped)[:1].tolist() == ([50 + SAMPLES // 2] if is_step else [])


def test_pulsation_is_the_signals_own() -> None:
    """Of a pump that is sampled: a sine that aliases, far above the noise."""
    values = noise(3, 3000) + 100.0 * np.sin(np.arange(3000) * 2.4)
    _, held = gated(values)
    assert not held.any()


def test_what_is_not_usable_is_no_sample() -> None:
    values, usable = noise(5), np.ones(200, dtype=np.bool_)
    usable[60:160:2] = False
    values[60:160:2] = 1e5
    passed, held = gated(values, usable)
    assert not held[usable].any()
    np.testing.assert_array_equal(passed[usable], values[usable])


def test_the_first_samples_pass_whatever_they_are() -> None:
    passed, held = gated(np.array([0.0, 1e5, -1e5, 3.0]))
    assert passed.tolist() == [0.0, 1e5, -1e5, 3.0]
    assert not held.any()


@pytest.mark.parametrize("share", [0.05, 0.1])
def test_of_many_outliers_hardly_any_passes(share: float) -> None:
    rng = np.random.default_rng(6)
    values = noise(7, 5000)
    dirty = rng.random(5000) < share
    values[dirty] += rng.choice([-1.0, 1.0], dirty.sum()) * rng.uniform(30.0, 1e4, dirty.sum())
    passed, held = gated(values)
    assert held[dirty][10:].mean() > 0.99
    assert np.abs(passed[SAMPLES:]).max() < 30.0

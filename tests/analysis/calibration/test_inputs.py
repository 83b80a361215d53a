"""What is known of an input between its samples, by the samples alone."""

import numpy as np
import numpy.typing as npt
import pytest

from faultline.analysis.calibration.inputs import (
    UNIFORM,
    is_command,
    misread,
    renewed,
    resolution,
    rounded_noise,
    uncertain,
)
from faultline.analysis.recordings.track import Track
from faultline.service.core.time_scale import TimeScale

TIME = TimeScale(0.2, 8.0)


Array = npt.NDArray[np.float64]


def speed(step: float, noise: float, seed: int = 0) -> tuple[Array, Array]:
    """A wandering speed (N,), true and read with a resolution, at 5 Hz."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 400.0, 0.2)
    true = 25.0 + 3.0 * np.sin(t / 17.0) + 1.5 * np.sin(t / 5.3 + 1.0)
    read = true + noise * rng.standard_normal(len(t))
    return true, step * np.round(read / step) if step else read


@pytest.mark.parametrize("step", [0.5, 1.0])
def test_a_coarse_reading_is_no_command(step: float) -> None:
    _, read = speed(step, 0.02)
    assert np.mean(np.diff(read) != 0.0) < 0.5
    assert not is_command(read)
    assert resolution(read) == pytest.approx(step)


def test_doses_and_switches_are_commands() -> None:
    rng = np.random.default_rng(1)
    dose = np.repeat(np.round(rng.uniform(0.0, 1.0, 40) / 0.004) * 0.004, 50)
    switch = np.repeat(rng.integers(0, 2, 40), 50).astype(float)
    assert is_command(dose)
    assert is_command(switch)
    assert is_command(np.full(100, 0.3))


def test_a_coarse_readings_error_is_as_large_as_its_intervals_say() -> None:
    """Over windows from a sample to two settling times the error is one standard deviation, within a factor."""
    true, read = speed(1.0, 0.02)
    t = 0.2 * np.arange(float(len(read)))
    found = uncertain(Track(t, read), t, np.full(len(t), 0.05), TIME)
    inside = np.maximum(np.minimum(t[:, None] + 0.1, found[:, 1]) - np.maximum(t[:, None] - 0.1, found[:, 0]), 0.0)
    errors = found[:, 2] * inside / 0.2
    for width in (1, 5, 20, 80):
        kernel = np.ones(width) / width
        mean = np.convolve(read - true, kernel, "valid")[::width]
        sd = np.sqrt(sum(np.convolve(column, kernel, "valid")[::width] ** 2 for column in errors.T))
        assert 0.3 < np.sqrt(np.mean((mean / sd) ** 2)) < 1.3


def test_a_fine_reading_has_no_such_intervals() -> None:
    for step, noise in ((0.0, 0.05), (0.05, 0.05), (0.1, 0.1)):
        _, read = speed(step, noise)
        t = 0.2 * np.arange(float(len(read)))
        found = uncertain(Track(t, read), t, np.full(len(t), noise), TIME)
        assert len(found) < 0.02 * len(t)  # chance


def test_a_jump_is_an_interval() -> None:
    t = np.arange(0.0, 60.0, 0.2)
    value = np.where(t < 30.1, 20.0, 28.0) + 0.02 * np.random.default_rng(2).standard_normal(len(t))
    found = uncertain(Track(t, value), t, np.full(len(t), 0.05), TIME)
    here = found[(found[:, 0] < 30.1) & (found[:, 1] > 30.1)]
    assert here[0, 2] == pytest.approx(8.0 * UNIFORM, rel=0.05)
    assert len(found) <= 3


def test_a_reading_that_is_sent_twice_is_one_sample() -> None:
    _, read = speed(0.0, 0.05)
    t = 0.2 * np.arange(float(len(read)))
    held = Track(t, np.repeat(read[::2], 2))
    assert not is_command(held.value)
    assert len(renewed(held).t) == len(t) // 2
    assert renewed(Track(t, read)).t is t  # nothing is held
    dose = np.repeat(np.random.default_rng(3).uniform(0.0, 1.0, 40), 50)
    assert renewed(Track(t, dose)).t is t  # a command's stretches are longer


@pytest.mark.parametrize("noise", [0.25, 0.3, 0.4, 0.6, 1.2, 20.0])
def test_the_noise_before_a_reading_was_rounded_is_found(noise: float) -> None:
    rng = np.random.default_rng(2)
    true = 20.0 + np.linspace(0.0, 3.0, 8000) + np.where(np.arange(8000) % 100 < 50, 0.0, 30.0)
    assert rounded_noise(np.round(true + noise * rng.standard_normal(8000))) == pytest.approx(noise, rel=0.15, abs=0.06)


def test_a_reading_that_hardly_moves_has_no_noise_to_speak_of() -> None:
    assert rounded_noise(np.round(np.linspace(0.0, 3.0, 300))) == 0.0


@pytest.mark.parametrize("ratio", [0.15, 0.25, 0.3])
def test_noise_of_a_part_of_the_resolution_leaves_an_error_in_means_of_that_reading(ratio: float) -> None:
    """A quarter of a settling time at each of many levels: the error is as Widrow and Kollar have it, by the level."""
    rng, many, part_s = np.random.default_rng(3), 60, 2.0
    t = 0.002 * np.arange(float(many * 1000))
    true = 20.0 + np.repeat(np.linspace(0.0, 3.0, many, endpoint=False), 1000)
    read = np.round(true + ratio * rng.standard_normal(len(t)))
    found = misread(Track(t, read), 0.001, TIME)
    error = (read - true).reshape(many, -1).mean(axis=1)
    assert len(found) == many
    assert found[:, 1] - found[:, 0] == pytest.approx(part_s)
    assert 0.4 < np.sqrt(np.mean(error**2)) / found[0, 2] < 1.4  # where there is little noise, the whole is taken
    assert found[:, 2] == pytest.approx(found[0, 2])
    for group in np.unique(found[:, 3]):
        same = true.reshape(many, -1)[found[:, 3] == group, 0]
        assert np.ptp(same) < 1.0


def test_noise_that_carries_a_reading_across_its_resolution_leaves_none() -> None:
    t = 0.02 * np.arange(6000.0)
    for ratio, noise in ((0.6, 0.01), (0.25, 10.0)):
        rng = np.random.default_rng(7)
        read = np.round(20.0 + np.sin(t / 9.0) + ratio * rng.standard_normal(len(t)))
        assert len(misread(Track(t, read), noise, TIME)) == 0
    assert len(misread(Track(t, np.full(len(t), 3.0)), 0.01, TIME)) == 0

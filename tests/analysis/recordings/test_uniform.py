"""Uniform data keep phase and slow content, and lose what 5 Hz cannot hold."""

import numpy as np
import pytest

from faultline.analysis.recordings.track import Track
from faultline.analysis.recordings.uniform import PERIOD_S, uniform


def _sine(frequency: float, start: float = 0.0) -> Track:
    t = np.arange(start, 60.0, 0.1) + np.random.default_rng(1).uniform(-0.01, 0.01, len(np.arange(start, 60.0, 0.1)))
    return Track(t, np.sin(2 * np.pi * frequency * t))


def test_slow_content_keeps_amplitude_and_phase() -> None:
    t, signals = uniform({"x": _sine(0.2)})
    middle = (t > 5) & (t < 55)
    assert np.abs(signals["x"] - np.sin(2 * np.pi * 0.2 * t))[middle].max() < 0.03


def test_what_would_alias_is_filtered_out() -> None:
    t, signals = uniform({"x": _sine(4.5)})  # would show at 0.5 Hz
    middle = (t > 5) & (t < 55)
    assert np.sqrt(np.mean(signals["x"][middle] ** 2)) < 0.1  # of 0.7


def test_the_pulses_of_the_dosing_valve_are_filtered_out() -> None:
    t, signals = uniform({"x": _sine(3.3)})
    middle = (t > 5) & (t < 55)
    assert np.sqrt(np.mean(signals["x"][middle] ** 2)) < 0.05  # of 0.7; what is left comes of the uneven sampling


def test_a_silence_is_empty_and_its_neighbours_know_nothing_of_the_other_side() -> None:
    t = np.concatenate([np.arange(0.0, 20.0, 0.1), np.arange(30.0, 60.0, 0.1)])
    at, signals = uniform({"x": Track(t, np.where(t < 25.0, 1.0, 5.0))})
    x = signals["x"]
    assert np.isnan(x[(at > 20.0) & (at < 29.9)]).all()
    assert np.allclose(x[at < 19.85], 1.0)
    assert np.allclose(x[at > 30.05], 5.0)


def test_the_grid_is_what_all_tracks_span() -> None:
    t, signals = uniform({"a": _sine(0.1), "b": _sine(0.1, start=12.35)})
    assert t[0] == pytest.approx(12.4)
    assert np.allclose(np.diff(t), PERIOD_S)
    assert len(signals["a"]) == len(signals["b"]) == len(t)


def test_tracks_without_common_time_give_nothing() -> None:
    early = Track(np.array([0.0, 1.0]), np.array([1.0, 1.0]))
    t, signals = uniform({"a": early, "b": _sine(0.1, start=12.0)})
    assert len(t) == len(signals["a"]) == 0

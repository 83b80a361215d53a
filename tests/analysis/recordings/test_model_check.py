"""Modes, edges, ranges and ages are checked against recordings: what does not fit is told with a line that would."""

from dataclasses import replace

import numpy as np
import pytest

from faultline.analysis.model import Model, load_model
from faultline.analysis.model.model import Known
from faultline.analysis.recordings.check import findings
from faultline.analysis.recordings.track import Track
from faultline.service.core.signals.values import FloatArray

UDS = load_model("uds")
LEVELS = {"y_p_tp": 1e5, "y_p_ap": 1.1e6, "y_p_du": 1.08e6}
T = np.arange(0.0, 600.0, UDS.period_s)


def steps(sizes: list[float], every_s: float, start: float) -> FloatArray:
    """A level that is moved by one size after the other."""
    level = start + np.concatenate([[0.0], np.cumsum(sizes)])
    return np.asarray(level[np.minimum((T // every_s).astype(int), len(sizes))], np.float64)


def drive(**values: FloatArray) -> dict[str, Track]:
    """A drive in all modes, whose pump steps by 8 1/s; `values` are other ones of some signals."""
    rng = np.random.default_rng(3)
    dose = np.array([0.0, 0.5, 1.0, 0.3, 0.0, 0.6])[(T // 100.0).astype(int)]
    pump = 20.0 + np.where(T % 60.0 < 30.0, 8.0, 0.0) + rng.normal(0.0, 0.05, len(T))
    made = {name: level + rng.normal(0.0, UDS.known[name].noise, len(T)) for name, level in LEVELS.items()}
    return {name: Track(T, value) for name, value in {**made, "n_p": pump, "dc_dose": dose, **values}.items()}


def texts(model: Model, *drives: dict[str, Track]) -> list[str]:
    return [each.text for each in findings(model, drives)]


def known(name: str, maximum: float) -> dict[str, Known]:
    return {**UDS.known, name: replace(UDS.known[name], max=maximum)}


def test_what_fits_says_nothing() -> None:
    assert texts(UDS, drive()) == []
    assert texts(UDS, drive(), drive()) == []
    assert findings(UDS, []) == []


def test_steps_that_hardly_reach_the_edge_are_told_with_a_threshold_below_them() -> None:
    rng = np.random.default_rng(1)
    slow = drive(n_p=steps([3.0, -2.5, 2.0, -3.0, 2.5], 97.0, 20.0) + rng.normal(0.0, 0.05, len(T)))
    [text] = texts(UDS, slow)
    assert "of n_p, by 2" in text
    line = text.rpartition("[edges]: ")[2]
    assert line.startswith("steps = { dc_dose = 0.03, n_p = ")
    proposed = float(line.removesuffix(" }").rpartition("= ")[2])
    assert 0.2 < proposed < 2.0
    fitting = replace(UDS, modes=replace(UDS.modes, edges={**UDS.modes.edges, "n_p": proposed}))
    assert texts(fitting, slow) == []


def test_a_threshold_that_noise_exceeds_makes_all_of_it_edge() -> None:
    low = replace(UDS, modes=replace(UDS.modes, edges={"n_p": 0.1}))
    found = texts(low, drive())
    assert "n_p moves by more than 0.1 1/s all the time: 100 % of it is edge" in found[0]
    assert [text for text in found[1:] if "is never visited" in text] == found[1:]


def test_a_signal_that_is_out_of_its_range_for_long_is_told_with_the_range_seen() -> None:
    [text] = texts(replace(UDS, known=known("n_p", 25.0)), drive())
    assert "n_p is above 25 1/s for 47 % of the time: it goes from 19." in text
    assert text.endswith("model.toml, [known.n_p]: max = 29.0")
    starting = drive(y_p_ap=np.where(T < 90.0, 1e5, 1.1e6))
    assert texts(UDS, starting) == []


def test_a_signal_that_comes_seldom_is_told_with_an_age() -> None:
    rare = drive()
    rare["y_p_tp"] = Track(*(each[::15] for each in rare["y_p_tp"]))
    assert texts(UDS, rare) == [
        "y_p_tp comes every 3 s, and is not used when older than 1 s; system.toml, [signal]: y_p_tp.maximum_age_s = 15"
    ]


def test_modes_that_are_not_visited_are_told_with_a_bound_where_the_signal_rests_near_one() -> None:
    dose = np.array([0.1, 0.5, 1.0, 0.3, 0.1, 0.6])[(T // 100.0).astype(int)]
    [text] = texts(UDS, drive(dc_dose=dose))
    assert text.startswith("mode idle is never visited; system.toml, [[mode]] idle: where = { dc_dose = { below = 0.1")
    found = texts(UDS, drive(dc_dose=np.full(len(T), 0.5)))
    told = "is never visited; record it, or take it out of system.toml"
    assert found == [f"mode idle {told}", f"mode maximum {told}"]


@pytest.mark.parametrize("name", ["n_p", "dc_dose"])
def test_signals_that_a_recording_lacks_are_left_out(name: str) -> None:
    some = {other: track for other, track in drive().items() if other != name}
    assert texts(UDS, some) == []
    assert texts(UDS, drive(), {**some, name: Track(np.zeros(0), np.zeros(0))}) == []

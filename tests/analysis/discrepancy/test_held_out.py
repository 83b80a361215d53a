"""The gap is shown on held-out runs: what was there, what is left, and that it is noise."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from made_discovery import discovery

from faultline.analysis.calibration.validate import Agreement
from faultline.analysis.discrepancy.add.held_out import Gap, Shown, shown
from faultline.analysis.discrepancy.add.whiteness import whiteness

ONE = np.zeros(400, dtype=np.int64)
NOISE = np.random.default_rng(3).normal(size=400)


@cache
def runs(gain: float = 0.15) -> Shown:
    found = discovery(gain)
    return shown(found.study, found.baseline, found.outcome.nominal, found.outcome.chosen)


def gap_of(found: Shown, output: str, mode: str) -> Gap:
    return next(gap for gap in found.gaps if (gap.output, gap.mode) == (output, mode))


def gap_with(before: float, after: float, floor: float = 1.0, expected: float = 2.0) -> Gap:
    was, now = (Agreement(100, rms, 0.0, floor, expected, rms / expected) for rms in (before, after))
    return Gap("y", "steady", was, now, None, None)


@pytest.mark.parametrize("mode", ["idle", "partial", "maximum", "steady"])
def test_the_gap_closes_down_to_noise(mode: str) -> None:
    gap = gap_of(runs(), "y_p_du", mode)
    assert gap.before.rms > 8.0 * gap.after.rms
    assert gap.closure == 1.0
    assert gap.white_before is not None
    assert gap.white_after is not None
    assert gap.white_before.probability < 1e-12
    assert gap.white_before.lag1 > 0.8
    assert gap.white_after.probability > 1e-3


def test_a_sensor_that_does_not_see_the_effect_has_no_gap() -> None:
    gap = gap_of(runs(), "y_p_tp", "steady")
    assert gap.closure is None
    assert gap.before.rms == pytest.approx(gap.after.rms, rel=0.02)
    assert runs().widest.output in {"y_p_du", "y_p_ap"}


def test_where_nothing_is_missing_there_is_nothing_to_close() -> None:
    found = runs(0.0)
    assert found.after is found.before
    assert {gap.closure for gap in found.gaps} == {None}


def test_a_held_out_recordings_zero_errors_are_its_own() -> None:
    """Each recording is zeroed anew: an offset of the held-out one alone says nothing about the model."""
    found = discovery()
    section = found.study.held[0]
    samples = dict(section.samples)
    samples["y_p_ap"] = dataclasses.replace(samples["y_p_ap"], value=samples["y_p_ap"].value + 300.0)
    moved = dataclasses.replace(section, samples=samples)
    study = dataclasses.replace(found.study, held=(section, moved))
    both = shown(study, found.baseline, found.outcome.nominal, found.outcome.chosen).after
    first, second = both.zeros
    apart = {name: second[name] - first[name] for name in ("y_p_ap", "y_p_du")}  # the drop between the two tells it
    assert apart["y_p_ap"] - apart["y_p_du"] == pytest.approx(300.0, rel=0.15)
    for output in ("y_p_ap", "y_p_du"):
        told = runs().after.agreement[output]["steady"]
        assert both.agreement[output]["steady"].rms == pytest.approx(told.rms, rel=0.02)
        assert both.agreement[output]["steady"].samples == 2 * told.samples


def test_closure_is_of_what_a_right_model_could_close() -> None:
    assert gap_with(10.0, 6.0).closure == pytest.approx(0.5)
    assert gap_with(10.0, 1.5).closure == 1.0  # below what is expected, it is all closed
    assert gap_with(1.2, 1.1).closure is None
    assert gap_with(10.0, 12.0).closure == pytest.approx(-0.25)  # worse is told
    assert gap_with(10.0, 1.0, np.nan, np.nan).closure is None  # no block was long enough for a floor


def test_the_statistic_is_ljung_and_boxs_where_nothing_is_missing() -> None:
    e = NOISE + 0.4 * np.roll(NOISE, 1)
    n, power = len(e), np.sum(e**2)
    r = np.array([np.sum(e[:-k] * e[k:]) / power for k in range(1, 11)])
    found = whiteness(e, ONE)
    assert found is not None
    assert found.q == pytest.approx(n * (n + 2) * np.sum(r**2 / (n - np.arange(1, 11))))
    assert found.probability < 1e-4


def test_no_pairs_are_made_across_gaps() -> None:
    """Of runs of two only neighbours can be told; that each begins anew is no correlation."""
    pairs = np.repeat(np.arange(200), 2)
    e = np.repeat(NOISE[:200], 2) * np.tile([1.0, -1.0], 200)
    found = whiteness(e, pairs)
    assert found is not None
    assert found.lags == 1
    assert found.lag1 == pytest.approx(-1.0)
    assert whiteness(NOISE[:15], ONE[:15]) is None


def test_noise_is_white_as_often_as_it_should_be() -> None:
    rng = np.random.default_rng(7)
    run = np.repeat(np.arange(20), 15)
    chances = [found.probability for _ in range(400) if (found := whiteness(rng.normal(size=300), run))]
    assert len(chances) == 400
    assert np.mean(np.array(chances) < 0.05) == pytest.approx(0.05, abs=0.03)

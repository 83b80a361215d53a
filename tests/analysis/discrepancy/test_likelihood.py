"""Bins average what belongs together, levels are the noise's, and weights make it unit."""

import dataclasses

import numpy as np
import pytest
from made_study import UDS1, study

from faultline.analysis.calibration.likelihood import BIN, Likelihood, bins_of, blocks, levels_of
from faultline.analysis.calibration.problem import Problem
from faultline.analysis.simulation import system_of

STUDY = study((), {})
[SECTION] = STUDY.training


def test_a_bin_has_one_output_one_mode_and_a_second_at_most() -> None:
    bins = bins_of(SECTION)
    t = np.concatenate([s.t for s in SECTION.samples.values()])
    mode = np.concatenate([s.mode for s in SECTION.samples.values()])
    output = np.repeat(np.arange(3), [len(s.t) for s in SECTION.samples.values()])
    for k in range(bins.number[-1] + 1):
        inside = bins.number == k
        assert len({*output[inside]}) == len({*mode[inside]}) == 1, k
        assert np.ptp(t[inside]) < BIN * 0.2, k
        assert (bins.output[k], bins.mode[k]) == (output[inside][0], mode[inside][0]), k
    assert bins.mean(t) == pytest.approx(bins.t)
    assert bins.mean(np.column_stack([t, 2 * t]))[:, 1] == pytest.approx(2 * bins.t)


def test_a_gap_ends_a_bin() -> None:
    name, s = next(iter(SECTION.samples.items()))
    keep = np.ones(len(s.t), dtype=np.bool_)
    keep[52:54] = False
    cut = dataclasses.replace(s, t=s.t[keep], value=s.value[keep], mode=s.mode[keep])
    bins = bins_of(dataclasses.replace(SECTION, samples={**SECTION.samples, name: cut}))
    t = cut.t
    for k in np.unique(bins.number[: len(t)]):
        assert np.diff(t[bins.number[: len(t)] == k]).max(initial=0.0) < 0.4, k


def test_the_levels_are_those_of_the_noise_though_the_model_is_slowly_wrong() -> None:
    rng = np.random.default_rng(3)
    bins = bins_of(SECTION)
    t = np.concatenate([s.t for s in SECTION.samples.values()])
    noise = rng.normal(0.0, 2000.0, len(t)) + 20e3 * np.sin(t / 40.0)
    found = levels_of(UDS1, [*SECTION.samples], [bins], [bins.mean(noise)])
    full = 2000.0 / np.sqrt(5.0)
    assert found == pytest.approx(full, rel=0.6)  # of a dozen bins each
    assert found.mean() == pytest.approx(full, rel=0.15)


def test_what_a_right_model_leaves_is_unit_noise() -> None:
    problem = Problem(system_of(UDS1, UDS1.calibrated), [SECTION], lagging=True)
    x = np.zeros(problem.unknowns.size)
    bins = [bins_of(SECTION)]
    left = [part.mean(e) for part, e in zip(bins, problem.left(x), strict=True)]
    levels = levels_of(UDS1, [*SECTION.samples], bins, left)
    e = Likelihood(problem, x, levels, bins).left(problem, x)
    assert np.mean(e**2) == pytest.approx(1.0, abs=0.2)


def test_blocks_are_counted_over_all_sections() -> None:
    bins = bins_of(SECTION)
    number = blocks([bins, bins], 10.0)
    assert {*number} == {*range(number.max() + 1)}
    assert number[len(bins.t) :].min() > number[: len(bins.t)].max()

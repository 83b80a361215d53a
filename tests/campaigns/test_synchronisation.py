"""A fixed dozen of the campaign's recordings: all within 50 ms, most of them believed; and the counting itself."""

import dataclasses
import multiprocessing

import pytest
from results_page import wilson
from synchronisation import ALLOWED_S, page, request, run


def test_a_dozen_recordings_are_aligned() -> None:
    asked = [request(1, number) for number in range(12)]
    short = [dataclasses.replace(each, duration=min(each.duration, 800.0), faults=()) for each in asked]
    with multiprocessing.Pool(2) as pool:
        results = pool.map(run, short, chunksize=1)
    outcomes = [result.outcome for result in results]
    assert max(result.error_s for result in results) < ALLOWED_S
    assert outcomes.count("right") >= 10, outcomes  # two short drives are flagged, without need
    text = page(results, 1, 60.0, "abc")
    assert f"Right and believed: {outcomes.count('right')} of 12" in text
    assert "| cycle | drive | 3 |" in text


def test_the_interval_of_a_share_is_wilsons() -> None:
    low, high = wilson(294, 300)
    assert low == pytest.approx(0.957, abs=1e-3)
    assert high == pytest.approx(0.991, abs=1e-3)

"""A fixed dozen of the campaign's recordings: all right or flagged, and the counting itself."""

import dataclasses
import multiprocessing

import pytest
from synchronisation import page, request, run, wilson


def test_a_dozen_recordings_are_right() -> None:
    asked = [request(1, number) for number in range(12)]
    short = [dataclasses.replace(each, duration=min(each.duration, 800.0), faults=()) for each in asked]
    with multiprocessing.Pool(2) as pool:
        results = pool.map(run, short, chunksize=1)
    outcomes = [result.outcome for result in results]
    assert outcomes.count("right") >= 11, [result for result in results if result.outcome != "right"]
    assert "wrong" not in outcomes
    text = page(results, 1, 60.0)
    assert f"Right and confident: {outcomes.count('right')} of 12" in text
    assert "| cycle | drive | 3 |" in text


def test_the_interval_of_a_share_is_wilsons() -> None:
    low, high = wilson(294, 300)
    assert low == pytest.approx(0.957, abs=1e-3)
    assert high == pytest.approx(0.991, abs=1e-3)

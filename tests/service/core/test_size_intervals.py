"""How large a fault is told to be: the interval holds the size that was there, whatever power the shift is of it."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from uds_time import TIME

from faultline.service.core.decision.hypotheses import Hypotheses
from faultline.service.core.decision.size_intervals import SizeIntervals, interval, size_at
from faultline.service.core.decision.window import Window
from faultline.service.core.display import Display
from faultline.service.core.manifest import Evidence, Hypothesis, SizeUnit
from faultline.service.core.records.event import Size
from faultline.service.core.residuals.generators import Residuals

NAMES = ["t1", "t2"]
SIZES = [-0.3, -0.6, -0.8, -0.92]
FILTER = np.array([-1.0, 0.2])
"""What a filter's drop, which grows with the square of the lost area, does to both residuals."""


def drop(size: float) -> float:
    return float((1.0 + size) ** -2 - 1.0)


def evidence(**changed: object) -> Evidence:
    given: dict[str, Any] = {
        "generators": NAMES,
        "offset": [[0.0, 0.0]] * 2,
        "spread": [[0.2, 0.2]] * 2,
        "noise": [[[0.01, 0.0], [0.0, 0.01]]] * 2,
        "visit": [[[1e-4, 0.0], [0.0, 1e-4]]] * 2,
        "allowance": [[0.02, 0.02]] * 2,
        "drifts": [],
        "operation": [[0.0, 0.0]] * 2,
        "followers": [],
        "graph": "faults.onnx",
        "hypotheses": [Hypothesis(fault="fA", size=size) for size in SIZES],
        "sizes": [SizeUnit(fault="fA", display=Display(unit="%", size=0.01, digits=1), of="area of the filter")],
    }
    return Evidence(**(given | changed))


def told(size: float, seed: int, of: Evidence, error: float = 0.0) -> list[Size]:
    """What is told of a fault of a size; each prediction is off by a share of its shift, normal with this spread."""
    rng = np.random.default_rng(seed)
    window = Window(of, NAMES, TIME)
    shift = np.array([drop(each) * FILTER for each in SIZES])
    visit, off = rng.normal(0.0, 0.01, 2), 1.0 + rng.normal(0.0, error, 2)
    for _ in range(60):
        r = drop(size) * FILTER * off + visit + rng.normal(0.0, 0.1, 2)
        window.add(1, Residuals(r, 0.0 * r, r, np.ones(2, dtype=np.bool_), shift))
    look = Hypotheses(of).look(window.means)
    assert look is not None
    return SizeIntervals(of).of("fA", look)


@given(st.floats(0.05, 0.9), st.integers(0, 1000))
def test_the_interval_holds_the_size_between_those_that_are_assumed(lost: float, seed: int) -> None:
    [size] = told(-lost, seed, evidence())
    assert (size.unit, size.of) == ("%", "area of the filter")
    middle, half = (size.low + size.high) / 2.0, (size.high - size.low) / 2.0
    assert abs(middle + 100.0 * lost) < max(2.5 * half, 0.6)
    assert half < 15.0


def test_95_in_100_intervals_hold_it() -> None:
    """With an error of the predictions as it is assumed: a tenth."""
    rng = np.random.default_rng(5)
    holds = []
    for seed in range(300):
        lost = float(rng.uniform(0.1, 0.9))
        [size] = told(-lost, seed, evidence(), error=0.1)
        holds.append(size.low - 0.05 <= -100.0 * lost <= size.high + 0.05)
    assert 0.88 <= np.mean(holds) <= 0.99


def test_of_a_fault_without_a_unit_no_size_is_told() -> None:
    assert told(-0.5, 1, evidence(sizes=[])) == []


def test_an_interval_ends_where_the_misfit_crosses_between_two_sizes_or_at_the_last_one() -> None:
    size, misfit = np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, 3.84 * 2])
    low, high = interval(size, misfit)
    assert low == 1.0
    assert high == pytest.approx(2.0 + (3.84 - 1.0) / (2 * 3.84 - 1.0))


@given(st.floats(0.3, 3.0), st.lists(st.floats(0.01, 1.0), min_size=1, max_size=6, unique=True), st.floats(0.001, 1.0))
def test_a_power_is_met_from_the_first_size_on(power: float, sizes: list[float], at: float) -> None:
    nodes = np.array(sorted(sizes))
    wanted = nodes[0] + at * (nodes[-1] - nodes[0])
    found = size_at(np.array([wanted**power]), nodes**power, nodes)
    if len(nodes) == 1 or np.min(np.diff(np.log(nodes))) > 1e-3:
        np.testing.assert_allclose(found, wanted, rtol=1e-6)


def test_a_fault_that_shifts_nothing_here_has_no_size() -> None:
    assert size_at(np.zeros(2), np.zeros(3), np.array([1.0, 2.0, 3.0])).tolist() == [0.0, 0.0]

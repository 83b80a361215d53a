"""A fault whose size changes while it is looked at, and one that the model describes only nearly."""

from typing import Any

import numpy as np
import pytest
from uds_time import PART_TICKS, TIME

from faultline.service.core.decision.explaining import fitting, nearest
from faultline.service.core.decision.growth import Growth
from faultline.service.core.decision.hypotheses import Hypotheses
from faultline.service.core.decision.look import GROWN, Look
from faultline.service.core.decision.straying import History
from faultline.service.core.decision.window import CHUNK, CHUNKS, Blocks
from faultline.service.core.manifest import Evidence, Hypothesis
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.values import FloatArray

NAMES, BLOCK = ["t1", "t3"], 15
FLAT, RISING = np.ones((3, 2)), np.array([[0.5, 0.5], [1.0, 1.0], [2.0, 2.0]])
SHIFTS = np.array([FLAT, 3.0 * FLAT, 0.5 * RISING, RISING, 3.0 * RISING])
"""(hypothesis, mode, generator): fA shifts all modes alike, fB grows fourfold with the dose."""
SIZES = [("fA", 1.0), ("fA", 3.0), ("fB", 0.5), ("fB", 1.0), ("fB", 3.0)]
ANY = [frozenset({"fA", "fB"})]


def evidence() -> Evidence:
    """Two generators and two faults."""
    given: dict[str, Any] = {
        "generators": NAMES,
        "offset": [[0.0, 0.0]] * 4,
        "spread": [[0.1, 0.1]] * 4,
        "noise": [[[0.01, 0.0], [0.0, 0.01]]] * 4,
        "visit": [[[0.0, 0.0], [0.0, 0.0]]] * 4,
        "allowance": [[0.02, 0.02]] * 4,
        "drifts": [],
        "operation": [[0.0, 0.0]] * 4,
        "followers": [],
        "graph": "faults.onnx",
        "hypotheses": [Hypothesis(fault=fault, size=size) for fault, size in SIZES],
    }
    return Evidence(**given)


def add(window: Blocks, mode: int, r: FloatArray) -> None:
    """A block of ticks in a mode, from 0, with residuals (K,)."""
    one = Residuals(r, 0.0 * r, np.ones(2), np.ones(2, dtype=np.bool_), SHIFTS[:, mode])
    for _ in range(BLOCK):
        window.add(1 + mode, one)
    window.keep()


def look(sizes: list[float], visit: int = 10) -> Look:
    """At a window in which fB has had these sizes, one a block; modes change every `visit` blocks."""
    of = evidence()
    window = Blocks(of, NAMES, TIME)
    for block, size in enumerate(sizes):
        mode = block // visit % 3
        add(window, mode, size * RISING[mode])
    found = Hypotheses(of).look(window.means, None, window.history)
    assert found is not None
    return found


def fits(seen: Look) -> set[tuple[str, ...]]:
    """What is named."""
    return {faults for faults, q in fitting(ANY, seen).items() if seen.fits(faults, q)}


def test_a_fault_that_has_grown_is_named_though_no_single_size_fits() -> None:
    seen = look(np.linspace(0.2, 3.0, 60).tolist(), visit=20)
    assert seen.faults["fB"] > 2.0 * seen.limit, "no size of it fits all modes"
    assert fits(seen) == {("fB",)}


def test_one_that_grew_and_stayed_is_named() -> None:
    seen = look([*np.linspace(0.1, 2.0, 30), *[2.0] * 30], visit=20)
    assert seen.faults["fB"] > seen.limit
    assert fits(seen) == {("fB",)}


def test_a_fault_of_one_size_costs_no_growth() -> None:
    seen = look([1.0] * 60, visit=5)
    assert seen.growing_or_not["fB"] == pytest.approx(seen.faults["fB"])
    assert fits(seen) == {("fB",)}
    assert seen.growing_or_not["fB"] < GROWN, "its course is not what it fits by"


def test_where_none_fits_the_one_that_leaves_little_is_near() -> None:
    """Its size jumps from one mode to the next, which no course does: 30 % off, of a hundred standard deviations."""
    of = evidence()
    window = Blocks(of, NAMES, TIME)
    for mode, size in ((0, 2.0), (1, 1.0), (2, 2.0), (0, 2.0), (1, 1.0), (2, 2.0)):
        for _ in range(10):
            add(window, mode, size * RISING[mode])
    seen = Hypotheses(of).look(window.means, None, window.history)
    assert seen is not None
    assert fits(seen) == set()
    assert nearest(ANY, seen) == [("fB",)]
    assert nearest([frozenset({"fC"})], seen) == [], "a conflict excludes it"


def test_without_a_history_nothing_grows() -> None:
    of = evidence()
    window = Blocks(of, NAMES, TIME)
    add(window, 0, RISING[0])
    seen = Hypotheses(of).look(window.means)
    assert seen is not None
    assert seen.growing_or_not == seen.faults


def test_the_shift_of_a_course_is_the_mean_of_its_sizes() -> None:
    """Two parts of a window, alike: half the size at the first one's age, the whole now, or the whole at both."""
    ticks = np.full((2, 3, 2), 10.0)
    history = History(ticks, np.array([100.0, 0.0]), 10.0 * np.repeat(SHIFTS[None, 2:], 2, axis=0))
    found = Growth(history, np.ones((3, 2), dtype=np.bool_)).shifts(np.arange(3))
    of_idle = set(found[:, 0].round(9).tolist())
    half_then_whole, always = (0.25 + 0.5) / 2.0, 0.5  # of size 1, whose shift is 0.5 at idle
    assert {half_then_whole, always} <= of_idle
    assert max(of_idle) == (0.75 + 1.5) / 2.0, "three quarters of three steps are the size 1.5"


def test_blocks_forget_what_is_older_than_a_part_of_each_mode() -> None:
    window = Blocks(evidence(), NAMES, TIME)
    add(window, 2, np.full(2, 7.0))
    blocks = PART_TICKS // BLOCK + 4 * CHUNK
    for _ in range(blocks):
        add(window, 0, np.zeros(2))
    ticks = window.means.ticks[:, 0]
    assert PART_TICKS <= ticks[0] <= PART_TICKS + 2 * (CHUNK + 2) * BLOCK < blocks * BLOCK
    assert ticks[2] == BLOCK, "a mode not visited since keeps what it showed"
    for k in range(2 * CHUNK * CHUNKS):
        add(window, k % 3, np.zeros(2))
    assert len(window.history.age) <= CHUNKS + 2
    assert (np.diff(window.history.age) <= 0.0).all(), "oldest first"

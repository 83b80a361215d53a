"""The choice of generators: by hand, and against all sets."""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from faultline.analysis.evaluation.measure.selection import Reach, Selection, once, requirements, select

KNOWN = ("fA", "fB")
NAMES = ("t1", "t2", "t3")
SENSITIVE = (("fA",), ("fA", "fB"), ("fB",))


def chosen(**other: Any) -> Selection:
    """t1 sees fA, t2 both, t3 fB, and all reach what they see; nothing is false and each has a state."""
    given: dict[str, Any] = {
        "states": [1, 1, 1],
        "reached": [Reach("fA", ("fA",), [True, True, False]), Reach("fB", ("fB",), [False, True, True])],
        "false_alarms": np.zeros((4, 3), dtype=np.bool_),
        "equal": [0, 1, 2],
        "isolating": [True, True, True],
        **other,
    }
    return select(NAMES, SENSITIVE, known=KNOWN, **given)


def test_what_all_do_is_required() -> None:
    found = chosen()
    assert [(r.case, r.other, r.met_by) for r in found.requirements] == [
        ("fA", None, ["t1", "t2"]),
        ("fA", "fB", ["t1"]),
        ("fB", None, ["t2", "t3"]),
        ("fB", "fA", ["t3"]),
    ]
    assert (found.keep, found.drop, found.cost, found.all_cost) == (["t1", "t3"], ["t2"], 4, 6)


def test_detection_alone_needs_the_test_that_sees_both() -> None:
    found = chosen(required=[("fA", None), ("fB", None)])
    assert (found.keep, found.cost) == (["t2"], 2)


def test_peace_goes_before_cost() -> None:
    false = np.array([[False, True, False]] * 3 + [[False, False, False]])
    found = chosen(required=[("fA", None), ("fB", None)], false_alarms=false)
    assert (found.keep, found.false_blocks, found.all_false_blocks, found.free_blocks) == (["t1", "t3"], 0, 3, 4)


def test_of_equal_peace_the_cheaper_and_all_that_are_as_good() -> None:
    assert chosen(required=[("fA", None)], states=[3, 1, 1]).keep == ["t2"]
    found = chosen(required=[("fA", None)])
    assert (found.keep, found.alternatives) == (["t1"], [["t2"]])


def test_a_second_generator_of_one_signal_adds_no_false_alarm() -> None:
    """Two of one signal that alarm in different blocks alarm together: either costs the same two blocks."""
    false = np.array([[True, False, False], [False, False, True], [False, False, False], [False, False, False]])
    assert chosen(false_alarms=false, equal=[0, 1, 0]).false_blocks == 2
    assert once(false, [0, 1, 0]).tolist() == [[True, False, True], [True, False, True], [False] * 3, [False] * 3]


def test_a_network_detects_and_does_not_isolate() -> None:
    found = chosen(isolating=[False, True, True])
    assert ("fA", "fB") not in [(r.case, r.other) for r in found.requirements]
    assert "t1" in next(r.met_by for r in found.requirements if (r.case, r.other) == ("fA", None))


def test_what_no_generator_reaches_is_not_required() -> None:
    found = chosen(reached=[Reach("fA", ("fA",), [False, False, False])])
    assert (found.requirements, found.keep, found.cost) == ([], [], 0)


def test_what_is_required_and_cannot_be_done_is_said_and_the_rest_is_chosen() -> None:
    blunt = [Reach("fA", ("fA",), [False, True, False])]
    found = chosen(required=[("fA", "fB"), ("fA", None)], reached=blunt)
    assert (found.unmet, found.keep) == (["fA isolated from fB"], ["t2"])
    nothing = chosen(required=[("fC", None)])
    assert (nothing.unmet, nothing.keep, nothing.requirements) == (["fC detected"], [], [])
    assert chosen().unmet == []


@pytest.mark.parametrize("seed", range(20))
def test_no_set_does_better(seed: int) -> None:
    """Against a search through all sets of up to eight generators, written without bits."""
    random = np.random.default_rng(seed)
    T, faults = int(random.integers(3, 9)), ("fA", "fB", "fC", "fD")
    names = [f"t{number}" for number in range(T)]
    sees = [[fault for fault in faults if random.random() < 0.5] for _ in names]
    reached = [Reach(f, (f,), [f in own and random.random() < 0.8 for own in sees]) for f in faults]
    false, states = random.random((30, T)) < 0.1, random.integers(0, 5, T).tolist()
    found = select(names, sees, states, reached, false, list(range(T)), faults, [True] * T)
    wanted = requirements(names, sees, reached, faults, [True] * T)

    def price(of: Sequence[int]) -> tuple[int, int]:
        return int(false[:, of].any(axis=1).sum()), sum(states[row] + 1 for row in of)

    good = [
        of
        for size in range(T + 1)
        for of in combinations(range(T), size)
        if all(any(names[row] in r.met_by for row in of) for r in wanted)
    ]
    best = min(map(price, good))
    assert (found.false_blocks, found.cost) == best, f"seed {seed}"
    as_good = [[names[row] for row in of] for of in good if price(of) == best]
    assert found.keep in as_good, f"seed {seed}"
    assert len(found.alternatives) == min(len(as_good) - 1, 10), f"seed {seed}"

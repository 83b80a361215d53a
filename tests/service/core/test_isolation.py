"""Conflicts to diagnoses, and their ranks."""

from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.core.decision import CONFIRMED, ranked
from service.core.hypotheses import MINIMUM_TICKS, Hypotheses, Means, Weighed, Window
from service.core.isolation import UNKNOWN, diagnoses
from service.core.manifest import Evidence, Hypothesis
from service.core.modes import EDGE

FAULTS = ["fA", "fB", "fC", "fD"]
CONFLICTS = st.lists(st.frozensets(st.sampled_from(FAULTS), min_size=1), max_size=6)


@given(CONFLICTS)
def test_every_diagnosis_hits_every_conflict_and_none_smaller_does(conflicts: list[frozenset[str]]) -> None:
    found = diagnoses(conflicts)
    if not conflicts:
        assert found == []
        return
    if found == [UNKNOWN]:
        assert not any(all(c & set(pair) for c in conflicts) for pair in combinations(FAULTS, 2))
        return
    size = len(found[0])
    every = [set(chosen) for chosen in combinations(FAULTS, size) if all(c & set(chosen) for c in conflicts)]
    assert sorted(map(sorted, every)) == sorted(map(list, found))
    assert not any(all(c & set(few) for c in conflicts) for few in combinations(FAULTS, size - 1))


def test_three_disjoint_conflicts_are_not_forced_on_two_faults() -> None:
    assert diagnoses([frozenset({"fA"}), frozenset({"fB"}), frozenset({"fC"})]) == [UNKNOWN]


def _evidence(**changed: object) -> Evidence:
    """Two generators; fA shifts both alike at any dose, fB grows fourfold from idle to maximum dose, fC is t3's own."""
    flat = [[1.0, 1.0]] * 4
    growing = [[0.5, 0.5], [1.0, 1.0], [2.0, 2.0], [0.0, 0.0]]
    own = [[0.0, 1.0]] * 4
    given: dict[str, Any] = {
        "generators": ["t1", "t3"],
        "offset": [[0.0, 0.0]] * 4,
        "noise": [[[0.04, 0.0], [0.0, 0.04]]] * 4,
        "visit": [[[0.0, 0.0], [0.0, 0.0]]] * 4,
        "allowance": [[0.05, 0.05]] * 4,
        "drifts": [],
        "hypotheses": [
            Hypothesis(fault="fA", size=-1.0, shift=(-np.array(flat)).tolist()),
            Hypothesis(fault="fA", size=1.0, shift=flat),
            Hypothesis(fault="fB", size=0.5, shift=(0.5 * np.array(growing)).tolist()),
            Hypothesis(fault="fB", size=1.0, shift=growing),
            Hypothesis(fault="fC", size=1.0, shift=own),
        ],
    }
    return Evidence(**(given | changed))


def _means(residuals: dict[int, tuple[float, float]], evidence: Evidence, visits: int = 1) -> Means:
    window = Window(evidence, ["t1", "t2", "t3"])
    for mode, (first, third) in residuals.items():
        for _ in range(visits):
            for _ in range(MINIMUM_TICKS):
                window.add(mode, np.array([first, 99.0, third]), np.array([True, False, True]))
            window.add(EDGE, np.zeros(3), np.ones(3, dtype=np.bool_))
    return window.means


def _weighed(residuals: dict[int, tuple[float, float]], visits: int = 1, **changed: object) -> Weighed:
    evidence = _evidence(**changed)
    found = Hypotheses(evidence).weigh(_means(residuals, evidence, visits))
    assert found is not None
    return found


BOTH: list[tuple[str, ...]] = [("fA",), ("fB",)]


def test_one_mode_cannot_tell_a_bias_from_a_restriction() -> None:
    assert [rank for _, rank in ranked(BOTH, _weighed({0: (0.5, 0.5)}).faults)] == [1, 1]


def test_the_pattern_over_modes_ranks_the_restriction_first() -> None:
    assert ranked(BOTH, _weighed({0: (0.4, 0.4), 2: (1.6, 1.6)}).faults) == [(("fB",), 1), (("fA",), 2)]


def test_a_constant_shift_ranks_the_bias_first() -> None:
    assert ranked(BOTH, _weighed({0: (1.0, 1.0), 2: (1.0, 1.0)}).faults) == [(("fA",), 1), (("fB",), 2)]


def test_any_size_between_the_grid_fits_as_well_as_those_on_it() -> None:
    sizes = [_weighed({0: (0.5 * s, 0.5 * s), 2: (2.0 * s, 2.0 * s)}).faults["fB"] for s in (0.01, 0.3, 0.5, 0.77)]
    assert sizes == pytest.approx([0.0] * 4, abs=1e-9)


def test_no_fault_fits_what_is_usual() -> None:
    assert _weighed({0: (0.03, -0.05), 2: (-0.04, 0.0)}).gain < CONFIRMED


def test_a_drift_makes_what_it_looks_like_uncertain_and_nothing_else() -> None:
    drift = [(0.5 * np.ones((4, 2))).tolist()]  # as fA does
    for shift, usual in ({0: (0.5, 0.5), 2: (0.5, 0.5)}, True), ({0: (0.0, 0.5), 2: (0.0, 0.5)}, False):
        assert _weighed(shift).nothing > CONFIRMED
        assert (_weighed(shift, drifts=drift).nothing < CONFIRMED) is usual


def test_visits_make_surer_and_a_long_one_does_not() -> None:
    visit = [[[0.09, 0.0], [0.0, 0.09]]] * 4
    one, many = (_weighed({0: (0.5, 0.5)}, visits, visit=visit).nothing for visits in (1, 9))
    assert many > 4.0 * one
    assert one < CONFIRMED


def test_short_stays_beside_a_long_one_do_not_make_it_surer() -> None:
    evidence = _evidence(visit=[[[0.09, 0.0], [0.0, 0.09]]] * 4)
    gains = []
    for stays in ([200], [200, *[1] * 9]):
        window = Window(evidence, ["t1", "t2", "t3"])
        for ticks in stays:
            for _ in range(ticks):
                window.add(0, np.array([0.5, 0.0, 0.5]), np.ones(3, dtype=np.bool_))
            window.leave()
        weighed = Hypotheses(evidence).weigh(window.means)
        assert weighed is not None
        gains.append(weighed.gain)
    assert gains[1] < 1.2 * gains[0]


def test_edges_and_few_ticks_are_no_evidence() -> None:
    window = Window(_evidence(), ["t1", "t2", "t3"])
    for _ in range(100):
        window.add(3, np.ones(3), np.ones(3, dtype=np.bool_))
    for _ in range(MINIMUM_TICKS - 1):
        window.add(0, np.ones(3), np.ones(3, dtype=np.bool_))
    assert Hypotheses(_evidence()).weigh(window.means) is None
    assert not Hypotheses(_evidence()).deviating(window.means, 5.0).any()


def test_a_generator_that_cannot_tell_is_left_out_and_silences_no_other() -> None:
    window = Window(_evidence(), ["t1", "t2", "t3"])
    for mode, level in ((0, 0.4), (2, 1.6)):
        for _ in range(MINIMUM_TICKS):
            window.add(mode, np.array([level, np.nan, np.nan]), np.array([True, False, False]))
    weighed = Hypotheses(_evidence()).weigh(window.means)
    assert weighed is not None
    assert weighed.gain > CONFIRMED
    assert ranked(BOTH, weighed.faults) == [(("fB",), 1), (("fA",), 2)]


def test_without_hypotheses_there_is_no_gain() -> None:
    weighed = _weighed({0: (0.5, 0.5)}, hypotheses=[])
    assert weighed.faults == {}
    assert weighed.gain == 0.0
    assert weighed.nothing > CONFIRMED


def test_a_generator_that_deviates_in_the_window_is_a_conflict() -> None:
    evidence = _evidence()
    found = Hypotheses(evidence).deviating(_means({0: (0.1, 1.0)}, evidence), 5.0)
    assert found.tolist() == [False, True]

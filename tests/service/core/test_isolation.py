"""Conflicts to diagnoses, and their ranks."""

from itertools import combinations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from service.core.isolation import UNKNOWN, diagnoses
from service.core.manifest import Evidence, Hypothesis
from service.core.ranking import MINIMUM_TICKS, EvidenceWindow, ranked

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


def _evidence() -> Evidence:
    """Two generators; fA shifts both alike at any dose, fB grows fourfold from idle to maximum dose."""
    flat = [[1.0, 1.0]] * 4
    growing = [[0.5, 0.5], [1.0, 1.0], [2.0, 2.0], [0.0, 0.0]]
    return Evidence(
        generators=["t1", "t3"],
        offset=[[0.0, 0.0]] * 4,
        noise=[[[0.04, 0.0], [0.0, 0.04]]] * 4,
        allowance=[[0.05, 0.05]] * 4,
        hypotheses=[
            Hypothesis(fault="fA", size=-1.0, shift=(-np.array(flat)).tolist()),
            Hypothesis(fault="fA", size=1.0, shift=flat),
            Hypothesis(fault="fB", size=0.5, shift=(0.5 * np.array(growing)).tolist()),
            Hypothesis(fault="fB", size=1.0, shift=growing),
        ],
    )


def _window(residuals: dict[int, float]) -> EvidenceWindow:
    window = EvidenceWindow(_evidence(), ["t1", "t2", "t3"])
    for mode, level in residuals.items():
        for _ in range(MINIMUM_TICKS):
            window.add(mode, np.array([level, 99.0, level]), np.array([True, False, True]))
    return window


def test_one_mode_cannot_tell_a_bias_from_a_restriction() -> None:
    misfits = _window({0: 0.5}).misfits()
    assert [rank for _, rank in ranked([("fA",), ("fB",)], misfits)] == [1, 1]


def test_the_pattern_over_modes_ranks_the_restriction_first() -> None:
    misfits = _window({0: 0.4, 2: 1.6}).misfits()
    assert ranked([("fA",), ("fB",)], misfits) == [(("fB",), 1), (("fA",), 2)]


def test_a_constant_shift_ranks_the_bias_first() -> None:
    misfits = _window({0: 1.0, 2: 1.0}).misfits()
    assert ranked([("fA",), ("fB",)], misfits) == [(("fA",), 1), (("fB",), 2)]


def test_edges_blind_ticks_and_few_ticks_are_no_evidence() -> None:
    window = EvidenceWindow(_evidence(), ["t1", "t2", "t3"])
    for _ in range(100):
        window.add(3, np.ones(3), np.ones(3, dtype=np.bool_))
        window.add(0, np.ones(3), np.array([True, True, False]))
    for _ in range(MINIMUM_TICKS - 1):
        window.add(0, np.ones(3), np.ones(3, dtype=np.bool_))
    assert window.misfits() == {}


def test_without_evidence_and_for_several_faults_all_candidates_are_equal() -> None:
    assert ranked([("fA",), ("fB",)], {}) == [(("fA",), 1), (("fB",), 1)]
    assert ranked([("fA", "fC"), ("fB", "fC")], {"fA": 1.0, "fB": 50.0, "fC": 1.0})[1] == (("fB", "fC"), 1)

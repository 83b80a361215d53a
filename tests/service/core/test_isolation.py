"""Conflicts to diagnoses, and their ranks."""

from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from uds_time import PART_TICKS, TIME

from faultline.service.core.decision.decision import CONFIRMED
from faultline.service.core.decision.explaining import ranked
from faultline.service.core.decision.hypotheses import Hypotheses, confined
from faultline.service.core.decision.isolation import UNKNOWN, diagnoses
from faultline.service.core.decision.look import UNMOVED, Look
from faultline.service.core.decision.straying import MINIMUM_TICKS, Means
from faultline.service.core.decision.window import Window
from faultline.service.core.manifest import Bounds, Consequence, Evidence, Hypothesis
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.signals.values import FloatArray

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


FLAT, OWN = np.ones((4, 2)), np.tile([0.0, 1.0], (4, 1))
GROWING = np.array([[0.5, 0.5], [1.0, 1.0], [2.0, 2.0], [0.0, 0.0]])
SIZES = [("fA", -1.0), ("fA", 1.0), ("fB", 0.5), ("fB", 1.0), ("fC", 1.0)]
SHIFTS = np.array([-FLAT, FLAT, 0.5 * GROWING, GROWING, OWN])
"""(hypothesis, mode, generator): fA shifts both alike at any dose, fB grows fourfold with it, fC is t3's own."""


def _evidence(**changed: object) -> Evidence:
    """Two generators."""
    given: dict[str, Any] = {
        "generators": ["t1", "t3"],
        "offset": [[0.0, 0.0]] * 4,
        "spread": [[0.2, 0.2]] * 4,
        "noise": [[[0.04, 0.0], [0.0, 0.04]]] * 4,
        "visit": [[[0.0, 0.0], [0.0, 0.0]]] * 4,
        "allowance": [[0.05, 0.05]] * 4,
        "drifts": [],
        "operation": [[0.0, 0.0]] * 4,
        "followers": [],
        "graph": "faults.onnx",
        "hypotheses": [Hypothesis(fault=fault, size=size) for fault, size in SIZES],
    }
    return Evidence(**(given | changed))


def _window(evidence: Evidence) -> Window:
    return Window(evidence, ["t1", "t2", "t3"], TIME)


def _tick(r: tuple[float, float], shift: FloatArray, told: tuple[bool, bool] = (True, True)) -> Residuals:
    """Residuals of t1 and t3; t2 is no evidence."""
    all_three = np.array([r[0], 99.0, r[1]])
    return Residuals(all_three, 0.0 * all_three, all_three, np.array([told[0], False, told[1]]), shift)


def _add(
    window: Window, mode: int, r: tuple[float, float], *, ticks: int = 1, told: tuple[bool, bool] = (True, True)
) -> None:
    """Ticks with these residuals of t1 and t3 in a steady mode, from 0; t2 is no evidence."""
    for _ in range(ticks):
        window.add(1 + mode, _tick(r, SHIFTS[:, mode], told))


def _at_edge(window: Window, r: tuple[float, float], ticks: int = 1) -> None:
    for _ in range(ticks):
        window.add(EDGE, _tick(r, SHIFTS[:, 3]))


def _means(residuals: dict[int, tuple[float, float]], evidence: Evidence, visits: int = 1) -> Means:
    window = _window(evidence)
    for mode, r in residuals.items():
        for _ in range(visits):
            _add(window, mode, r, ticks=MINIMUM_TICKS)
            _at_edge(window, (0.0, 0.0))
    return window.means


def _look(residuals: dict[int, tuple[float, float]], visits: int = 1, **changed: object) -> Look:
    evidence = _evidence(**changed)
    found = Hypotheses(evidence).look(_means(residuals, evidence, visits))
    assert found is not None
    return found


def _ranked(residuals: dict[int, tuple[float, float]]) -> list[tuple[tuple[str, ...], int]]:
    return ranked(BOTH, {(fault,): q for fault, q in _look(residuals).faults.items()})


BOTH: list[tuple[str, ...]] = [("fA",), ("fB",)]


def test_one_mode_cannot_tell_a_bias_from_a_restriction() -> None:
    assert [rank for _, rank in _ranked({0: (0.5, 0.5)})] == [1, 1]


def test_the_pattern_over_modes_ranks_the_restriction_first() -> None:
    assert _ranked({0: (0.4, 0.4), 2: (1.6, 1.6)}) == [(("fB",), 1), (("fA",), 2)]


def test_a_constant_shift_ranks_the_bias_first() -> None:
    assert _ranked({0: (1.0, 1.0), 2: (1.0, 1.0)}) == [(("fA",), 1), (("fB",), 2)]


def test_any_size_between_the_grid_fits_as_well_as_those_on_it() -> None:
    sizes = [_look({0: (0.5 * s, 0.5 * s), 2: (2.0 * s, 2.0 * s)}).faults["fB"] for s in (0.01, 0.3, 0.5, 0.77)]
    assert sizes == pytest.approx([0.0] * 4, abs=1e-9)


def test_two_forms_of_a_fault_are_chains_of_their_own_and_one_fault() -> None:
    """Between a size of one form and one of the other there is nothing; the better one counts."""
    forms = [Hypothesis(fault="fA", size=-1.0), Hypothesis(fault="fA", size=-0.5, share_of="k")]
    evidence = _evidence(hypotheses=forms)
    window = _window(evidence)
    for mode, r in ((0, (0.5, 0.5)), (2, (2.0, 2.0))):  # as the second form does
        for _ in range(MINIMUM_TICKS):
            window.add(1 + mode, _tick(r, np.stack([FLAT[mode], GROWING[mode]])))
    look = Hypotheses(evidence).look(window.means)
    assert look is not None
    assert list(look.faults) == ["fA"]
    assert look.faults["fA"] < 1.0


BROUGHT = np.array([[0.0, 0.5]] * 4)
"""What fC does to t3 at each dose where fA brings it."""


def _look_with_consequence(shows: bool, brought: tuple[float, float]) -> Look:
    """fA of size 2 in modes 0 and 2; it brings so much of fC in each, where that `shows`."""
    simple = [Hypothesis(fault="fA", size=1.0), Hypothesis(fault="fA", size=3.0), Hypothesis(fault="fC", size=1.0)]
    with_it = [Hypothesis(fault="fA", size=size, brought=1.0) for size in (1.0, 3.0)]
    consequence = Consequence(fault="fA", brings="fC", where={"y": Bounds(above=1.0)})
    evidence = _evidence(hypotheses=simple + with_it, consequences=[consequence])
    window = _window(evidence)
    for mode, part in zip((0, 2), brought, strict=True):
        own, other = FLAT[mode], BROUGHT[mode]
        shift = np.array([own, 3.0 * own, other, own + other, 3.0 * own + other])
        for _ in range(MINIMUM_TICKS):
            r = tuple((2.0 * own + part * other).tolist())
            window.add(1 + mode, _tick(r, shift)._replace(brought=np.array([shows])))
    look = Hypotheses(evidence).look(window.means)
    assert look is not None
    return look


def test_a_fault_and_its_consequence_are_one_fault_however_much_comes_in_each_mode() -> None:
    """Of its own part a fault has one size in all modes, of the consequence one in each."""
    look = _look_with_consequence(shows=True, brought=(0.8, 0.1))
    assert look.faults["fA"] < 0.1 < look.limit < look.faults["fC"]
    best = look.fitted["fA"]
    assert list(look.brought) == ["fA"]
    assert best.part == pytest.approx(0.5)


def test_a_consequence_that_does_not_show_explains_nothing() -> None:
    shown = _look_with_consequence(shows=True, brought=(0.8, 0.1))
    hidden = _look_with_consequence(shows=False, brought=(0.8, 0.1))
    assert not hidden.brought
    assert hidden.faults["fA"] > shown.faults["fA"] + 1.0
    assert _look_with_consequence(shows=True, brought=(0.0, 0.0)).faults["fA"] < 0.1  # nor need any come


def test_away_from_the_usual_operation_the_models_own_error_counts() -> None:
    """Predicted is 0; usual is 10: what a model predicts there may be off by a twentieth of that."""
    shift = {0: (0.5, 0.5), 2: (0.5, 0.5)}
    usual, away = (_look(shift, operation=[[level, level]] * 4).nothing for level in (0.0, 10.0))
    assert usual > CONFIRMED
    assert away < usual / 3.0


def test_no_fault_fits_what_is_usual() -> None:
    assert _look({0: (0.03, -0.05), 2: (-0.04, 0.0)}).gain < CONFIRMED


def test_a_drift_makes_what_it_looks_like_uncertain_and_nothing_else() -> None:
    drift = [(0.5 * np.ones((4, 2))).tolist()]  # as fA does
    for shift, usual in ({0: (0.7, 0.7), 2: (0.7, 0.7)}, True), ({0: (0.0, 0.7), 2: (0.0, 0.7)}, False):
        assert _look(shift).nothing > CONFIRMED
        assert (_look(shift, drifts=drift).nothing < CONFIRMED) is usual


def test_visits_make_surer_and_a_long_one_does_not() -> None:
    visit = [[[0.09, 0.0], [0.0, 0.09]]] * 4
    one, many = (_look({0: (0.5, 0.5)}, visits, visit=visit).nothing for visits in (1, 9))
    assert many > 4.0 * one
    assert one < CONFIRMED


def test_short_stays_beside_a_long_one_do_not_make_it_surer() -> None:
    evidence = _evidence(visit=[[[0.09, 0.0], [0.0, 0.09]]] * 4)
    gains = []
    for stays in ([200], [200, *[1] * 9]):
        window = _window(evidence)
        for ticks in stays:
            _add(window, 0, (0.5, 0.5), ticks=ticks)
            _at_edge(window, (0.0, 0.0))
        look = Hypotheses(evidence).look(window.means)
        assert look is not None
        gains.append(look.gain)
    assert gains[1] < 1.2 * gains[0]


def test_edges_and_few_ticks_are_no_evidence() -> None:
    window = _window(_evidence())
    _at_edge(window, (1.0, 1.0), ticks=100)
    _add(window, 0, (1.0, 1.0), ticks=MINIMUM_TICKS - 1)
    assert Hypotheses(_evidence()).look(window.means) is None


def test_a_generator_that_cannot_tell_is_left_out_and_silences_no_other() -> None:
    window = _window(_evidence())
    for mode, level in ((0, 0.4), (2, 1.6)):
        _add(window, mode, (level, np.nan), ticks=MINIMUM_TICKS, told=(True, False))
    look = Hypotheses(_evidence()).look(window.means)
    assert look is not None
    assert look.gain > CONFIRMED
    assert ranked(BOTH, {(fault,): q for fault, q in look.faults.items()}) == [(("fB",), 1), (("fA",), 2)]


def test_without_hypotheses_there_is_no_gain() -> None:
    evidence = _evidence(hypotheses=[], graph=None)
    window = _window(evidence)
    for _ in range(MINIMUM_TICKS):
        window.add(1, _tick((0.5, 0.5), np.zeros((0, 0))))
    look = Hypotheses(evidence).look(window.means)
    assert look is not None
    assert (look.faults, look.pairs, look.gain) == ({}, {}, 0.0)
    assert look.nothing > CONFIRMED


def test_a_mean_that_deviates_is_found_with_its_mode() -> None:
    far = _look({0: (0.1, 1.0)}).sigmas
    assert (far > 5.0).tolist() == [[False, True], [False, False], [False, False]]


def test_two_faults_fit_where_no_single_one_does() -> None:
    """fA of size 0.6 and fC of 0.8: at any dose t1 has 0.6 and t3 1.4."""
    look = _look({0: (0.6, 1.4), 2: (0.6, 1.4)})
    assert min(look.faults.values()) > look.limit
    assert look.pairs["fA", "fC"] == pytest.approx(0.0, abs=1e-9)
    assert min(look.pairs, key=look.pairs.__getitem__) == ("fA", "fC")


@given(st.floats(0.05, 0.95), st.floats(0.05, 0.95))
def test_the_sizes_of_both_faults_are_found_wherever_they_lie(first: float, second: float) -> None:
    """Both grow together in idle and partial dose, so that fitting one after the other alone would take long."""
    modes = {mode: tuple(first * FLAT[mode] + second * GROWING[mode]) for mode in (0, 1, 2)}
    assert _look(modes).pairs["fA", "fB"] == pytest.approx(0.0, abs=1e-6)


def test_what_nothing_explains_fits_neither_one_nor_two() -> None:
    look = _look({0: (1.5, -1.5), 2: (-1.5, 1.5)})
    assert min(look.faults.values()) > look.limit
    assert min(look.pairs.values()) > look.limit


def test_pairs_that_miss_a_conflict_are_out() -> None:
    pairs: dict[tuple[str, ...], float] = {("fA", "fB"): 1.0, ("fA", "fC"): 2.0}
    assert confined([frozenset({"fC"})], pairs) == {("fA", "fC"): 2.0}


def test_the_limit_is_the_quantile_of_chi_square() -> None:
    """Of 1e-4 above it, for 2 and 6 means (tables; Wilson and Hilferty are within 5 and 2 %)."""
    assert _look({0: (0.0, 0.0)}).limit == pytest.approx(18.42, rel=0.05)
    assert _look(dict.fromkeys((0, 1, 2), (0.0, 0.0))).limit == pytest.approx(27.86, rel=0.02)


def test_a_fault_that_was_another_is_seen_as_it_is_now() -> None:
    """After twice its part the window has forgotten what was; a mode that was not visited since keeps it."""
    window = _window(_evidence())
    _add(window, 0, (1.0, 1.0), ticks=3 * PART_TICKS)
    _add(window, 2, (2.0, 2.0), ticks=PART_TICKS)
    _add(window, 0, (0.0, 0.0), ticks=2 * PART_TICKS)
    ticks, _, total, _, shift, *_ = window.means
    assert total[0].tolist() == [0.0, 0.0]
    assert PART_TICKS <= ticks[0, 0] <= 2 * PART_TICKS
    assert (total[2] / ticks[2]).tolist() == [2.0, 2.0]
    np.testing.assert_allclose(shift / np.maximum(ticks, 1.0), SHIFTS[:, :3] * (ticks > 0))


def test_a_fault_that_shifts_nothing_here_is_no_help_to_another() -> None:
    evidence = _evidence()
    window = _window(evidence)
    for mode in (0, 2):
        for _ in range(MINIMUM_TICKS):
            r, shift = (
                GROWING[mode],
                np.where(np.array([name == "fB" for name, _ in SIZES])[:, None], SHIFTS[:, mode], 0.0),
            )
            window.add(1 + mode, _tick(r, shift))
    look = Hypotheses(evidence).look(window.means)
    assert look is not None
    assert look.pairs["fA", "fC"] == pytest.approx(look.nothing)
    assert look.pairs["fA", "fB"] == pytest.approx(look.faults["fB"], abs=1e-9)


def test_a_stay_is_one_visit_however_it_is_interrupted() -> None:
    """By lost samples, and by what the window forgets."""
    window = _window(_evidence())
    for _ in range(40):
        _add(window, 0, (0.5, 0.5), ticks=20)
        _add(window, 0, (0.5, 0.5), told=(False, False))
    assert (window.means.ticks[0] ** 2 / window.means.squares[0]).tolist() == [1.0, 1.0]
    _add(window, 0, (0.5, 0.5), ticks=3 * PART_TICKS)
    assert (window.means.ticks[0] ** 2 / window.means.squares[0]).tolist() == [1.0, 1.0]


def test_a_size_fits_best_by_what_its_prediction_is_worth() -> None:
    """One mean is 40 deviations off and predicted to a tenth of that: it must not decide the size for all others."""
    look = _look({0: (0.5, 0.5), 1: (1.0, 1.0), 2: (2.6, 2.0)}, allowance=[[0.01, 0.01]] * 4)
    sizes = np.linspace(0.0, 1.0, 2001)
    d, S = look._d, look._S
    shifts = sizes[:, None] * GROWING[:3].ravel()
    by_hand = [(d - mu) @ np.linalg.solve(S + np.diag((0.1 * mu) ** 2), d - mu) for mu in shifts]
    assert look.faults["fB"] == pytest.approx(min(by_hand), rel=0.02)


def _with_free_shifts(residuals: dict[int, tuple[float, float]], sensitive: dict[str, dict[str, str]]) -> Look:
    evidence = _evidence()
    found = Hypotheses(evidence, (), sensitive).look(_means(residuals, evidence))
    assert found is not None
    return found


def test_a_free_shift_that_nothing_seen_is_sensitive_to_explains_nothing() -> None:
    """Its generators may all be blind."""
    look = _with_free_shifts({0: (1.0, 1.0)}, {"fC": {"t2": "y"}})
    assert look.faults["fC"] == look.nothing


def test_a_free_shift_costs_less_where_generators_predict_one_signal() -> None:
    deviating = {0: (3.0, 3.0), 1: (3.0, 3.0)}
    one, two = (_with_free_shifts(deviating, {"fC": {"t1": "y", "t3": other}}).faults["fC"] for other in ("y", "z"))
    assert 4.0 < one < two


def test_a_fault_need_not_shift_all_that_is_sensitive_to_it() -> None:
    """It costs little more than where the other signal means nothing."""
    deviating = {0: (3.0, 0.0), 1: (3.0, 0.0)}
    either, one = (_with_free_shifts(deviating, {"fC": of}) for of in ({"t1": "y", "t3": "z"}, {"t1": "y"}))
    assert either.faults["fC"] == pytest.approx(one.faults["fC"] - 2.0 * np.log(UNMOVED))


def test_beside_free_shifts_a_size_has_its_price() -> None:
    """Else a sensor's bias would be preferred to any fault that it looks like."""
    deviating = {0: (1.0, 1.0)}
    alone, beside = _look(deviating).faults, _with_free_shifts(deviating, {"fC": {"t1": "y", "t3": "y"}}).faults
    assert beside["fA"] - alone["fA"] == pytest.approx(1.0 + np.log(_look(deviating).nothing), rel=0.05)
    assert beside["fC"] == pytest.approx(beside["fA"], abs=0.5)

"""Rivals on made series: sums by definition, limits that leave as many alarms as allowed, names of what was learnt."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_judged import Judged
from rival_methods import SMOOTH, Components, Forest, ThesisCusum, Variance
from rival_series import Series, episodes, false_alarms, first_alarm, limit_for
from rivals import Outcome, Way, allowed, better, faultline, folds, main, page, tried

MATRIX = [frozenset({"fA_t", "fq_pump"}), frozenset({"fA_du", "fq_pump"})]
ONSET_S = 100.0


def series(vehicle: int, fault: str | None, seed: int, seconds: float = 400.0, noise: float = 1.0) -> Series:
    """Two residuals of noise 1; a fault moves those that know it by 4 from the onset on, and one signal of two."""
    rng = np.random.default_rng([vehicle, seed])
    t = np.arange(0.0, seconds, 0.2)
    r = noise * rng.standard_normal((len(t), 2))
    onset = seconds if fault is None else ONSET_S
    there = (t >= onset)[:, None]
    r += 4.0 * there * [fault in row for row in MATRIX]
    z = rng.standard_normal((len(t), 3)) + 6.0 * there * [0.0, fault == "fA_t", 0.0]
    told: dict[str, Any] = {"standing": {}, "delay_s": None, "excited_s": None, "changes": True, "cannot_tell": 0.0}
    one = Judged(
        vehicle=vehicle,
        kind="single" if fault else "free",
        label="large" if fault else "",
        faults=(fault,) if fault else (),
        free_s=onset,
        false=[],
        alarms=[],
        **told,
    )
    usable, mode = np.ones(r.shape, dtype=np.bool_), 1 + (np.arange(len(t)) // 100) % 3
    return Series(one, t, z.astype(np.float32), r.astype(np.float32), usable, mode, np.ones(len(t), dtype=np.bool_))


@pytest.fixture(scope="module")
def fleet() -> list[Series]:
    faults = [None, None, "fA_t", "fA_du", "fq_pump"]
    return [series(number, fault, k) for number in (1, 2, 3, 4) for k, fault in enumerate(faults)]


def test_episodes_and_the_first_new_alarm() -> None:
    t = np.arange(0.0, 300.0, 1.0)
    alarm = ((t >= 10) & (t < 15)) | ((t >= 40) & (t < 45)) | (t >= 200)
    assert episodes(alarm, t).tolist() == [10.0, 200.0]
    s = series(1, "fA_t", 0)
    standing = np.where((s.t > 90) & (s.t < 130) | (s.t > 150), 1.0, 0.0)
    assert first_alarm(standing, 0.5, s) == pytest.approx(150.2)
    assert first_alarm(np.zeros(len(s.t)), 0.5, s) is None


def test_the_thesis_sum_is_the_recursion(fleet: list[Series]) -> None:
    method = ThesisCusum(MATRIX, exact=True)
    method.fit(fleet)
    s = fleet[2]
    g, expected = np.zeros(2), []
    for row in s.r.astype(np.float64):
        g = np.maximum(0.0, g + np.abs(row) - method._nu)
        expected.append((g / method._J).max())
    assert method.score(s) == pytest.approx(np.array(expected))


def test_a_limit_leaves_as_many_false_alarms_as_allowed(fleet: list[Series]) -> None:
    free = [s for s in fleet if s.judged.kind == "free"]
    scores = [(np.abs(s.r).max(axis=1).astype(np.float64), s) for s in free]
    for most in (0, 3):
        limit = limit_for(scores, most)
        assert false_alarms(scores, limit) <= most
        assert false_alarms(scores, limit * 0.95) > most
    assert limit_for(scores, 3) < limit_for(scores, 0)


@pytest.mark.parametrize("exact", [True, False])
def test_each_names_what_was_there(fleet: list[Series], exact: bool) -> None:
    outcome = tried(lambda: ThesisCusum(MATRIX, exact=exact), fleet, 0.0, "one")
    assert outcome.tried["large"] == len(outcome.delays["large"]) == 12
    assert outcome.hours == pytest.approx((8 * 400 + 12 * 100) / 3600)
    assert outcome.held["large"] == (12 if exact else 8 + 4)
    assert sum(outcome.sizes["large"]) == (12 if exact else 12 + 8)  # each conflict has two faults, both have one


def test_the_forest_learns_from_other_vehicles(fleet: list[Series]) -> None:
    method = Forest()
    method.fit([s for s in fleet if s.vehicle != 1])
    for s in (s for s in fleet if s.vehicle == 1):
        score = method.score(s)
        assert score[s.free].max() < 0.5
        if s.judged.faults:
            assert score[-1] > 0.8
            assert method.names(s, 200.0, 0.5) == [*s.judged.faults]


def test_components_detect_and_name_nothing(fleet: list[Series]) -> None:
    method = Components()
    method.fit([s for s in fleet if s.vehicle != 1])
    s = next(s for s in fleet if s.vehicle == 1 and s.judged.faults == ("fA_t",))
    score = method.score(s)
    assert score[s.t > ONSET_S + 0.2 * SMOOTH].min() > 1.5 * score[s.free].max()
    assert method.names(s, 200.0, 1.0) is None


def test_the_variance_sees_what_gets_quieter() -> None:
    free, other, s = (series(1, None, k) for k in range(3))
    s.usable[200:230] = False
    quiet = s.t >= ONSET_S
    s.r[quiet] *= 0.3
    method = Variance()
    method.fit([free, other])
    score = method.score(s)
    assert score[quiet & (s.t > ONSET_S + 30.0)].min() > 1.3 > score[~quiet].max()


def test_the_page_says_where_faultline_is_not_better(fleet: list[Series]) -> None:
    own = faultline([s.judged for s in fleet])  # which told nothing here
    outcomes = {"faultline": own, "thesis": tried(lambda: ThesisCusum(MATRIX, exact=True), fleet, 0.0)}
    assert "thesis detects more of the large faults, names the true one" in better(outcomes)[0]
    assert "thesis detects more of the large faults" in page(outcomes)
    assert better({"faultline": own}) == []
    louder = Outcome(5, 10.0, tried=own.tried, delays={"small": [], "large": [1.0]})
    assert better({"faultline": own, "louder": louder}) == [
        "louder (at 0.5 against 0 false alarms an hour) detects more of the large faults"
    ]


def test_what_has_healed_has_no_size() -> None:
    outcome = Outcome(hours=1.0, tried={"small": 2, "large": 0}, delays={"small": [1.0, 1.0], "large": []})
    outcome.name("fA_t", "small", [])
    outcome.name("fA_t", "small", ["fA_t", "fA_du"])
    assert (outcome.sizes["small"], outcome.healed["small"], outcome.held["small"]) == ([2], 1, 1)
    assert "| 1 of 2, 50.0 % (1.3 to 98.7 %) | 2.00, 1 healed | 0 |" in page({"faultline": outcome})


def test_a_rival_is_given_at_least_the_rate_of_faultline() -> None:
    assert allowed(0.1, 25.0) == 3
    assert allowed(3 / 7.0, 7.0) == 3
    assert allowed(0.0, 25.0) == 0


def test_own_drives_set_what_is_tried_on_the_others() -> None:
    """With one vehicle three times as noisy, a limit by another's sums is slow; by own ones it is not."""
    ways: tuple[Way, Way] = ("own", "one")
    rows = [(k, fault) for k, fault in enumerate([None, None, None, "fA_t"])]
    noisy = [series(n, fault, k, noise=3.0 if n == 4 else 1.0) for n in (1, 2, 3, 4) for k, fault in rows]
    own, one = (tried(lambda: ThesisCusum(MATRIX, exact=True), noisy, 0.0, way) for way in ways)
    assert own.hours == pytest.approx(4 * (400 + 100) / 3600)  # two of three drives made the method
    assert one.hours == pytest.approx(4 * (3 * 400 + 100) / 3600)
    assert own.false < one.false
    assert len(own.delays["large"]) == 4
    assert max(own.delays["large"]) < 10.0 < min(one.delays["large"])
    with pytest.raises(ValueError, match="has no fault-free drive to make a method from"):
        tried(lambda: ThesisCusum(MATRIX, exact=True), [s for s in noisy if s.judged.faults], 0.0, "own")


def test_without_records_there_is_nothing_to_compare(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="run make campaign-diagnosis first"):
        main(["--results", str(tmp_path)])


def test_too_few_vehicles_are_refused() -> None:
    with pytest.raises(ValueError, match="run the campaign on 3 at least"):
        folds([1, 2])
    assert folds([1, 2, 3]) == [{1}, {2}, {3}]


def test_vehicles_with_a_curve_are_spread_over_the_folds() -> None:
    curved = {401, 406, 411, 416}
    given = folds(range(401, 421), curved)
    assert [len(fold) for fold in given] == [4] * 5
    assert max(len(fold & curved) for fold in given) == math.ceil(len(curved) / len(given))
    assert set().union(*given) == set(range(401, 421))

"""What is known of a day, what is taken off for it, and what is unlike it: two generators whose straying is known."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from uds_time import (
    FROZEN_TICKS,
    GUARD_TICKS,
    IDLE,
    MAXIMUM,
    PARTIAL,
    RANKING_PERIOD,
    REMEMBERED_TICKS,
    TIME,
)

from faultline.service.core.decision.day import TAU, WANDER, WIDENED, Day
from faultline.service.core.decision.hypotheses import Hypotheses
from faultline.service.core.decision.straying import Means, Straying
from faultline.service.core.decision.unlike import Unlike
from faultline.service.core.manifest import Evidence, Follower, Hypothesis
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.modes import EDGE

Array = npt.NDArray[np.float64]

STRAY = 100.0  # of both together, in every mode alike
NOISE, OWN = 10.0, 5.0
NAMES = ["ta", "tb"]
BOTH = np.ones(2, dtype=np.bool_)
FAULT = np.array([[[60.0, -60.0]] * 4])  # (hypothesis, mode, generator): no day moves one up and the other down


def evidence(**changed: Any) -> Evidence:
    given: dict[str, Any] = {
        "generators": NAMES,
        "offset": [[1000.0, 2000.0]] * 4,
        "spread": [[NOISE, NOISE]] * 4,
        "noise": [[[NOISE**2, 0.0], [0.0, NOISE**2]]] * 4,
        "visit": [[[0.0, 0.0], [0.0, 0.0]]] * 4,
        "allowance": [[OWN, OWN]] * 4,
        "drifts": [[[STRAY, STRAY]] * 4],
        "followers": [],
        "graph": "faults.onnx",
        "hypotheses": [Hypothesis(fault="fA", size=1.0)],
    }
    return Evidence(**(given | changed))


def at(day: float, fault: float = 0.0, mode: int = IDLE) -> Array:
    return np.asarray(np.array([1000.0, 2000.0]) + day + fault * FAULT[0, mode])


def learnt(day: float, mode: int = IDLE, ticks: int = 10 * GUARD_TICKS) -> Day:
    made = Day(evidence(), TIME)
    for _ in range(ticks):
        made.add(mode, at(day), BOTH)
    return made


def test_a_day_is_known_half_a_minute_late_and_moves_the_modes_that_were_not_visited() -> None:
    """Known of one mode: all modes stray together, but for what each strays by itself."""
    assert learnt(80.0, ticks=2 * GUARD_TICKS - 1).level.mean.tolist() == [[0.0, 0.0]] * 3
    level = learnt(80.0).level
    np.testing.assert_allclose(level.mean, 80.0, rtol=0.01)
    sd = np.sqrt(level.variance)
    assert sd[IDLE - 1] == pytest.approx(WANDER * np.hypot(STRAY, OWN), rel=0.1)
    assert (sd[[PARTIAL - 1, MAXIMUM - 1]] > sd[IDLE - 1]).all()
    assert (sd[[PARTIAL - 1, MAXIMUM - 1]] < 0.2 * STRAY).all()


def test_what_no_day_does_is_not_taken_for_one() -> None:
    """One generator up and the other down: but for each mean's own straying it stays."""
    made = Day(evidence(), TIME)
    for _ in range(10 * GUARD_TICKS):
        made.add(IDLE, at(0.0, fault=1.0), BOTH)
    assert np.abs(made.level.mean).max() < 60.0
    assert np.ptp(made.level.mean[PARTIAL - 1]) < 1.0


def test_what_was_seen_of_late_is_discarded_where_something_is_suspected() -> None:
    made = learnt(50.0)
    before = made.level.mean.copy()
    for _ in range(GUARD_TICKS - 1):
        made.add(IDLE, at(-300.0), BOTH)
    made.discard()
    for _ in range(10 * GUARD_TICKS):
        made.add(IDLE, at(50.0), BOTH)
    np.testing.assert_allclose(made.level.mean, before, atol=0.1)


def test_a_day_of_which_nothing_is_learnt_comes_back_to_the_usual_one() -> None:
    made = learnt(80.0)
    known = made.level
    for _ in range(round(TIME.ticks(TAU))):
        made.wait()
    assert made.level.mean == pytest.approx(known.mean / math.e, rel=0.01)
    grown = made.level.variance / Straying(evidence()).unknown.variance
    assert grown == pytest.approx(1.0 - np.exp(-2.0), abs=0.03)
    for _ in range(4 * GUARD_TICKS):  # and what is learnt then is not outweighed by what was known hours ago
        made.add(IDLE, at(-80.0), BOTH)
    assert made.level.mean[IDLE - 1] == pytest.approx(-80.0, abs=2.0)


def test_a_day_moves_on() -> None:
    made = learnt(0.0, ticks=3 * REMEMBERED_TICKS)
    for _ in range(3 * REMEMBERED_TICKS):
        made.add(IDLE, at(50.0), BOTH)
    assert made.level.mean[IDLE - 1] == pytest.approx(50.0, abs=8.0)


def test_detectors_see_the_day_as_far_as_it_is_unknown_as_their_own_spread() -> None:
    """A day of two of its standard deviations is below one spread before it is known, and gone after."""
    fresh = Day(evidence(), TIME)
    seen = (fresh.taken_off(IDLE, at(2.0 * STRAY)) - at(0.0)) / NOISE
    assert (np.abs(seen) < 1.0).all()
    known = learnt(2.0 * STRAY)
    assert np.abs(known.taken_off(IDLE, at(2.0 * STRAY)) - at(0.0)).max() < 0.2 * NOISE
    assert np.abs(known.taken_off(EDGE, at(2.0 * STRAY)) - at(0.0)).max() < 2.0 * NOISE


def test_a_follower_has_the_day_that_the_evidence_shows_taken_off_too() -> None:
    """It moves three times as far as they do, the other way; it is told of only by them."""
    drifts = [[-3.0 * STRAY] * 4]
    follower = Follower(generator="tc", offset=[500.0] * 4, spread=[NOISE] * 4, drifts=drifts)
    made, far = Day(evidence(followers=[follower]), TIME), np.append(at(80.0), 500.0 - 240.0)
    deaf = made.taken_off(IDLE, far)
    assert abs(deaf[2] - 500.0) < NOISE  # nothing is known of the day: it is far, in parts of what days do
    for _ in range(10 * GUARD_TICKS):
        made.add(IDLE, at(80.0), BOTH)
    left = made.taken_off(PARTIAL, far)
    assert left[2] == pytest.approx(500.0, abs=0.5 * NOISE)
    faulty = made.taken_off(PARTIAL, np.append(at(80.0), 500.0 - 240.0 + 300.0))
    unknown = WIDENED * 3.0 * WANDER * STRAY  # of a day that is known
    assert faulty[2] - left[2] == pytest.approx(300.0 * NOISE / np.hypot(NOISE, unknown), rel=0.1)


def test_a_generator_that_cannot_tell_says_nothing_of_the_day() -> None:
    made = Day(evidence(), TIME)
    for _ in range(10 * GUARD_TICKS):
        made.add(IDLE, np.array([np.nan, 2080.0]), np.array([False, True]))
    np.testing.assert_allclose(made.level.mean, 80.0, rtol=0.01)  # the other one says it


def test_the_expected_level_is_that_of_conditional_gaussians() -> None:
    """Against the textbook's formula for one seen mean of six."""
    straying = Straying(evidence())
    means = Means(np.zeros((3, 2)), np.zeros((3, 2)), np.zeros((3, 2)), np.zeros((0, 3, 2)))
    means.ticks[PARTIAL - 1, 1], means.squares[PARTIAL - 1, 1], means.total[PARTIAL - 1, 1] = 100.0, 1e4, 100 * 2040.0
    level = straying.known(means, straying.unknown)
    S = STRAY**2 + OWN**2 + NOISE**2 / 100.0
    assert level.mean[PARTIAL - 1, 1] == pytest.approx(40.0 * (STRAY**2 + OWN**2) / S)
    assert level.mean[IDLE - 1, 0] == pytest.approx(40.0 * STRAY**2 / S)
    assert level.variance[IDLE - 1, 0] == pytest.approx(STRAY**2 + OWN**2 - STRAY**4 / S)
    assert straying.known(means._replace(ticks=np.zeros((3, 2))), straying.unknown) is straying.unknown


class Watch:
    """Unlike, looked at as the decision does. State: the tick."""

    def __init__(self) -> None:
        made = evidence()
        self.unlike, self.tick = Unlike(made, NAMES, Hypotheses(made), TIME), 0

    def drive(
        self, ticks: int, day: float, fault: float = 0.0, *, suspected: bool = False, usable: bool = True
    ) -> list[bool]:
        """The alarm at every tick."""
        rng = np.random.default_rng(ticks)
        seen = []
        for _ in range(ticks):
            r = at(day, fault) + NOISE * rng.standard_normal(2)
            self.unlike.add(IDLE, Residuals(r, r, r, BOTH & usable, FAULT[:, IDLE]), suspected=suspected)
            if self.tick % RANKING_PERIOD == 0:
                self.unlike.look()
            self.tick += 1
            seen.append(self.unlike.alarm)
        return seen


def test_a_change_within_a_drive_is_suspected_until_it_is_over() -> None:
    watch = Watch()
    assert not any(watch.drive(4 * GUARD_TICKS, 150.0))
    assert watch.drive(60, 150.0, fault=0.6)[-1]
    watch.unlike.suspect()
    assert all(watch.drive(4 * GUARD_TICKS, 150.0, fault=0.6, suspected=True))  # its own evidence is not lost
    assert not watch.drive(3 * GUARD_TICKS, 150.0, suspected=True)[-1]


def test_a_change_that_a_day_makes_is_not_suspected() -> None:
    watch = Watch()
    watch.drive(4 * GUARD_TICKS, 0.0)
    assert not any(watch.drive(50, WANDER * STRAY))


def test_what_no_day_does_is_suspected_from_the_start_and_until_it_is_judged() -> None:
    watch = Watch()
    assert watch.drive(60, -120.0, fault=0.6)[-1]
    watch.unlike.suspect()
    assert all(watch.drive(4 * GUARD_TICKS, -120.0, suspected=True))
    watch.unlike.rest()
    assert not any(watch.drive(4 * GUARD_TICKS, -120.0))


def test_a_day_that_is_unlike_any_is_forgotten() -> None:
    watch = Watch()
    watch.drive(4 * GUARD_TICKS, -120.0)
    assert watch.unlike.day.mean == pytest.approx(-120.0, abs=3.0)
    for _ in range(40):
        watch.drive(RANKING_PERIOD, -120.0, fault=1.0)
        if not watch.unlike.day.mean.any():
            return
    pytest.fail("it is known still")


def test_evidence_that_went_blind_keeps_nothing_suspected_nor_the_day_for_ever() -> None:
    """While it was blind the tank may have been filled."""
    watch = Watch()
    watch.drive(4 * GUARD_TICKS, 150.0)
    assert watch.drive(60, 150.0, fault=1.0)[-1]
    watch.drive(FROZEN_TICKS + 1, 0.0, suspected=True, usable=False)
    assert not watch.unlike.alarm
    assert not any(watch.drive(4 * GUARD_TICKS, -150.0))

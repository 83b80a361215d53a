"""CUSUM and operating modes."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from uds_time import IDLE, MAXIMUM, PARTIAL, TIME

from faultline.service.core.detectors.bank import detector
from faultline.service.core.detectors.cusum import Cusum
from faultline.service.core.detectors.threshold import Threshold
from faultline.service.core.manifest import Bounds, CusumDetector, Input, Mode, Modes, Side
from faultline.service.core.signals.modes import EDGE, ModeTracker


@given(st.lists(st.floats(-5, 5), max_size=200), st.floats(0.1, 2), st.floats(1, 50))
def test_follows_the_definition_of_the_two_sums(samples: list[float], nu: float, J: float) -> None:
    cusum, above, below = Cusum(nu, J), 0.0, 0.0
    for tick, s in enumerate(samples):
        cusum.update(tick, s)
        above = min(2 * J, max(0.0, above + s - nu))
        below = min(2 * J, max(0.0, below - s - nu))
        assert cusum.value == max(above, below) / J
        if max(above, below) >= J:
            assert cusum.alarm
        if cusum.value == 0:
            assert not cusum.alarm


def test_a_fault_that_ends_heals_in_bounded_time() -> None:
    cusum = Cusum(nu=0.5, J=10.0)
    for tick in range(10_000):
        cusum.update(tick, 5.0)
    ticks = 0
    while cusum.alarm:
        cusum.update(10_000 + ticks, 0.0)
        ticks += 1
    assert ticks <= 2 * 10.0 / 0.5


def test_sign_tells_the_direction() -> None:
    for direction in (1, -1):
        cusum = Cusum(nu=0.5, J=3.0)
        for tick in range(20):
            cusum.update(tick, 2.0 * direction)
        assert cusum.alarm
        assert cusum.sign == direction


def test_a_sum_that_is_exactly_the_threshold_alarms() -> None:
    cusum = Cusum(nu=1.0, J=4.0)
    cusum.update(0, 3.0)
    assert not cusum.alarm
    cusum.update(1, 3.0)
    assert (cusum.alarm, cusum.value) == (True, 1.0)


@pytest.mark.parametrize(("side", "heard"), [("above", 1), ("below", -1)])
def test_one_side_is_deaf_to_the_other(side: Side, heard: int) -> None:
    """As the manifest says, through the bank."""
    for direction in (1, -1):
        level, one = [0.0] * 4, [1.0] * 4
        made = detector(
            CusumDetector(generator="t02.ode", offset=level, scale=one, nu=0.5, J=3.0, side=side), TIME.period_s
        )
        for tick in range(20):
            made.update(tick, 2.0 * direction)
        assert made.alarm == (direction == heard)


def test_a_threshold_alarms_from_its_value_on_with_the_residuals_sign() -> None:
    for s, alarm, sign in ((4.0, True, 1), (-4.0, True, -1), (3.999, False, 1), (0.5, False, 1), (-0.5, False, -1)):
        threshold = Threshold(J=4.0, hold_ticks=2)
        threshold.update(7, s)
        assert (threshold.alarm, threshold.sign) == (alarm, sign)
    threshold = Threshold(J=4.0, hold_ticks=2)
    threshold.update(7, 0.0)
    assert threshold.sign == 0
    threshold.update(8, 2.0)
    assert threshold.since is None, "half of J is not above half of J"
    threshold.update(9, 2.1)
    assert threshold.since == 9


INPUTS = [Input(signal=name, unit="1", maximum_age_s=1.0, lower=0.0, upper=100.0) for name in ("dc_dose", "n_p")]
MODES = Modes(
    steady=[
        Mode(name="idle", where={"dc_dose": Bounds(below=0.02)}),
        Mode(name="partial"),
        Mode(name="maximum", where={"dc_dose": Bounds(above=0.98)}),
    ],
    edges={"dc_dose": 0.03},
    settle_s=0.6,
)
USABLE = np.ones(2, dtype=np.bool_)


@pytest.mark.parametrize(("dose", "mode"), [(0.0, IDLE), (0.5, PARTIAL), (1.0, MAXIMUM)])
def test_a_steady_dose_has_its_mode_after_the_edge(dose: float, mode: int) -> None:
    tracker = ModeTracker(MODES, INPUTS, TIME.period_s)
    seen = [tracker.update(np.array([dose, 20.0]), USABLE) for _ in range(5)]
    assert seen == [EDGE, EDGE, mode, mode, mode]


def test_a_step_is_an_edge_and_an_unwatched_input_is_not() -> None:
    tracker = ModeTracker(MODES, INPUTS, TIME.period_s)
    for _ in range(5):
        tracker.update(np.array([0.0, 20.0]), USABLE)
    assert tracker.update(np.array([0.0, 90.0]), USABLE) == IDLE
    assert [tracker.update(np.array([0.5, 90.0]), USABLE) for _ in range(4)] == [EDGE, EDGE, EDGE, PARTIAL]


@pytest.mark.parametrize(("per_tick", "steps"), [(0.02, True), (0.005, False)])
def test_what_moves_fast_is_an_edge_as_long_as_it_moves(per_tick: float, *, steps: bool) -> None:
    """A signal that moves by the limit within a quarter of the time that it takes to settle, four ticks here."""
    modes = Modes(steady=MODES.steady, edges={"n_p": 4.0}, settle_s=16 * TIME.period_s)
    tracker = ModeTracker(modes, INPUTS, TIME.period_s)
    speed = [20.0] * 20 + [20.0 + 90.0 * per_tick * k for k in range(30)] + [20.0 + 90.0 * per_tick * 29] * 30
    seen = [tracker.update(np.array([0.0, n]), USABLE) for n in speed]
    assert seen[16:20] == [IDLE] * 4
    moving = [k for k, mode in enumerate(seen) if k >= 16 and mode == EDGE]
    assert moving == ([*range(23, 63)] if steps else [])


def test_a_speed_that_comes_back_is_no_edge_and_one_that_stays_is() -> None:
    inputs = [*INPUTS[:1], msgspec.structs.replace(INPUTS[1], outlier=0.3)]
    for length in (1, 5, 20):
        tracker = ModeTracker(Modes(steady=MODES.steady, edges={"n_p": 4.0}, settle_s=0.6), inputs, TIME.period_s)
        speed = np.full(60, 20.0)
        speed[30 : 30 + length] += 10.0
        seen = [tracker.update(np.array([0.0, n]), USABLE) for n in speed]
        assert (EDGE in seen[20:]) == (length == 20)


def test_without_the_mode_signal_nothing_is_steady() -> None:
    tracker = ModeTracker(MODES, INPUTS, TIME.period_s)
    for _ in range(5):
        tracker.update(np.array([0.0, 20.0]), USABLE)
    assert tracker.update(np.array([0.0, 20.0]), np.array([False, True])) == EDGE


def test_bounds_are_exclusive_and_the_first_mode_that_holds_counts() -> None:
    """Of two signals, in the order of the list; the one without bounds is last wherever it stands."""
    steady = [
        Mode(name="rest"),
        Mode(name="slow", where={"n_p": Bounds(below=10.0)}),
        Mode(name="dosing", where={"dc_dose": Bounds(above=0.1, below=0.9), "n_p": Bounds(below=50.0)}),
    ]
    tracker = ModeTracker(Modes(steady=steady, edges={}, settle_s=0.0), INPUTS, TIME.period_s)
    cases = {(0.5, 5.0): 2, (0.5, 10.0): 3, (0.1, 20.0): 1, (0.9, 20.0): 1, (0.5, 50.0): 1, (0.0, 9.9): 2}
    assert [tracker.update(np.array(z), USABLE) for z in cases] == [*cases.values()]
    assert tracker.update(np.array([0.5, 5.0]), np.array([True, False])) == EDGE
    assert tracker.update(np.array([0.5, 5.0]), USABLE) == 2


def test_a_system_without_modes_has_one_whatever_is_lost() -> None:
    tracker = ModeTracker(Modes(steady=[Mode(name="operation")], edges={}, settle_s=0.0), INPUTS, TIME.period_s)
    assert tracker.update(np.array([np.nan, np.nan]), np.zeros(2, dtype=np.bool_)) == 1

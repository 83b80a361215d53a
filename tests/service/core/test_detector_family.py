"""What every detector must do, whatever its kind; the shared suite, then what each kind is for."""

import math
import pickle
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from uds_time import FROZEN_TICKS, TIME

from faultline.service.core.detectors.adaptive import Adaptive
from faultline.service.core.detectors.bank import DetectorBank, detector
from faultline.service.core.detectors.cusum import Cusum
from faultline.service.core.detectors.low_pass import LowPass
from faultline.service.core.detectors.protocol import Detector
from faultline.service.core.detectors.spread import Spread
from faultline.service.core.detectors.standard import Standard
from faultline.service.core.detectors.threshold import Threshold
from faultline.service.core.manifest import (
    AdaptiveDetector,
    CusumDetector,
    LowPassDetector,
    SpreadDetector,
    ThresholdDetector,
)
from faultline.service.core.manifest import Detector as Settings
from faultline.service.core.residuals.generators import Residuals

Array = npt.NDArray[np.float64]

EVERY_MODE = [0.0] * 4, [1.0] * 4
HELD = 10
HELD_S = HELD * TIME.period_s


def kinds(generator: str = "ta.ode") -> dict[str, Settings]:
    zero, one = EVERY_MODE
    level: dict[str, Any] = {"generator": generator, "offset": zero, "scale": one}
    return {
        "cusum": CusumDetector(**level, nu=0.5, J=12.0),
        "above": CusumDetector(**level, nu=0.5, J=12.0, side="above"),
        "below": CusumDetector(**level, nu=0.5, J=12.0, side="below"),
        "threshold": ThresholdDetector(**level, J=6.0, hold_s=HELD_S),
        "low-pass": LowPassDetector(**level, J=1.5, hold_s=HELD_S, time_s=5.0),
        "adaptive": AdaptiveDetector(**level, J=6.0, hold_s=HELD_S, usual=one),
        "spread": SpreadDetector(**level, J=5.0, hold_s=HELD_S, memory_s=120.0),
    }


KINDS = kinds()
SIDES = [(name, sign) for name in KINDS for sign in (1, -1) if name != {1: "below", -1: "above"}[sign]]
QUIET = np.random.default_rng(1).standard_normal(4000)


def fault(name: str, sign: int, count: int) -> Array:
    """What this kind is to see: another level, or another variance."""
    noise = np.random.default_rng(2).standard_normal(count)
    if name == "spread":
        return 3.0 * noise if sign > 0 else 0.3 * noise
    return noise + 8.0 * sign


def fed(each: Detector, samples: Iterable[float], first: int = 0) -> Detector:
    for tick, s in enumerate(samples, first):
        each.update(tick, float(s))
    return each


def state(each: Detector) -> bytes:
    return pickle.dumps(each)


@pytest.mark.parametrize("name", KINDS)
def test_fresh_it_says_nothing_and_without_a_fault_neither(name: str) -> None:
    each = detector(KINDS[name], TIME.period_s)
    assert (each.alarm, each.since, each.value, each.sign) == (False, None, 0.0, 0)
    for tick, s in enumerate(QUIET):
        each.update(tick, float(s))
        assert not each.alarm, tick


@pytest.mark.parametrize(("name", "sign"), SIDES)
def test_it_alarms_on_what_it_is_for_with_sign_and_onset(name: str, sign: int) -> None:
    each = fed(detector(KINDS[name], TIME.period_s), QUIET[:1000])
    for tick, s in enumerate(fault(name, sign, 300), 1000):
        each.update(tick, float(s))
        if each.alarm:
            break
    assert each.alarm
    assert each.value >= 1.0
    assert each.sign == sign
    assert each.since is not None
    assert 985 <= each.since <= tick  # a sum may have stood a little above zero when the fault came
    assert tick < 1150
    onset = each.since
    fed(each, fault(name, sign, 50), tick + 1)
    assert (each.since, each.sign) == (onset, sign)


@pytest.mark.parametrize(("name", "sign"), SIDES)
def test_it_is_bounded_and_ends_in_bounded_time(name: str, sign: int) -> None:
    """However long and large the fault was."""
    before, longest = (QUIET, 650) if name == "spread" else (QUIET[:0], 300)  # a spread forgets what it looks at whole
    each = fed(detector(KINDS[name], TIME.period_s), before)
    samples = 1e9 * fault(name, sign, 20_000) if (name, sign) != ("spread", -1) else np.zeros(20_000)
    for tick, s in enumerate(samples, len(before)):
        each.update(tick, float(s))
        assert 0.0 <= each.value <= 2.0
    alarmed = [each.alarm]
    assert alarmed[0]
    for tick, s in enumerate(QUIET[:1000], len(before) + 20_000):
        each.update(tick, float(s))
        alarmed.append(each.alarm)
    assert not alarmed[-1]
    assert sum(alarmed) < longest
    assert fed(detector(KINDS[name], TIME.period_s), QUIET[:1000]).alarm == each.alarm


@pytest.mark.parametrize("name", KINDS)
def test_two_of_them_share_nothing_so_that_a_restart_is_fresh(name: str) -> None:
    used = fed(detector(KINDS[name], TIME.period_s), fault(name, -1 if name == "below" else 1, 200))
    after, alone = detector(KINDS[name], TIME.period_s), pickle.loads(state(detector(KINDS[name], TIME.period_s)))  # noqa: S301
    assert state(after) == state(alone)
    for tick, s in enumerate(QUIET[:200]):
        used.update(200 + tick, 50.0)
        after.update(tick, float(s))
        alone.update(tick, float(s))
    assert (after.value, after.sign, after.alarm, after.since) == (alone.value, alone.sign, alone.alarm, alone.since)


@pytest.mark.parametrize("name", KINDS)
def test_its_memory_does_not_grow(name: str) -> None:
    each = fed(detector(KINDS[name], TIME.period_s), QUIET)
    early = len(state(each))
    assert len(state(fed(each, np.tile(QUIET, 5), len(QUIET)))) <= early + 16  # larger numbers need more digits


@pytest.mark.parametrize("name", KINDS)
@given(samples=st.lists(st.floats(-1e12, 1e12), max_size=60))
def test_whatever_finite_comes_what_it_says_is_consistent(name: str, samples: list[float]) -> None:
    each = detector(KINDS[name], TIME.period_s)
    for tick, s in enumerate(samples):
        each.update(tick, s)
        assert 0.0 <= each.value <= 2.0
        assert each.sign in {-1, 0, 1}
        assert each.alarm or each.value < 1.0
        assert not each.alarm or (each.since is not None and each.since <= tick and each.sign != 0)


def residuals(r: float, usable: bool, sigma: float = 1.0) -> Residuals:
    """Of two generators; the second never tells."""
    return Residuals(np.array([r, np.nan]), np.zeros(2), np.array([sigma, np.nan]), np.array([usable, False]))


@pytest.mark.parametrize("name", KINDS)
def test_it_is_frozen_while_its_generator_cannot_tell_and_never_sees_a_number_that_is_none(name: str) -> None:
    settings = [KINDS[name], kinds("tb.ode")[name]]
    bank, each = DetectorBank(settings, ["ta.ode", "tb.ode"], TIME), detector(KINDS[name], TIME.period_s)
    sign = -1 if name == "below" else 1
    before = QUIET[:1000] if name == "spread" else QUIET[:0]
    last = len(before) + 200
    for tick, s in enumerate(np.concatenate([before, fault(name, sign, 200)])):
        each.update(tick, float(s))
        bank.update(tick, 1, residuals(float(s), usable=True))
    alarmed, sums = bank.alarmed, bank.sums
    assert bank.firing
    for tick in range(last, last + FROZEN_TICKS):
        bank.update(tick, 1, residuals(np.nan, usable=False, sigma=np.nan))
        assert (bank.alarmed, bool(bank.firing), bank.since) == (alarmed, True, each.since)
    np.testing.assert_array_equal(bank.sums, sums)
    bank.update(last + FROZEN_TICKS, 1, residuals(np.nan, usable=False, sigma=np.nan))
    assert (bank.alarmed, bool(bank.firing)) == (frozenset(), False)


def test_a_spread_raises_suspicion_and_is_no_conflict() -> None:
    """Its generator's row of the fault signature matrix is that of the level."""
    bank = DetectorBank([KINDS["cusum"], KINDS["spread"]], ["ta.ode"], TIME)
    for tick, s in enumerate(np.concatenate([QUIET[:1000], 0.2 * QUIET[1000:1500]])):
        bank.update(tick, 1, Residuals(np.array([s]), np.zeros(1), np.ones(1), np.ones(1, np.bool_)))
    assert bank.firing
    assert bank.alarmed == frozenset()
    assert bank.since is not None
    assert abs(bank.sums[0]) < 1.0


def test_a_generator_may_have_several() -> None:
    bank = DetectorBank([KINDS["above"], KINDS["below"]], ["ta.ode"], TIME)
    for tick in range(40):
        bank.update(tick, 1, Residuals(np.array([-2.0]), np.zeros(1), np.ones(1), np.ones(1, np.bool_)))
    assert bank.alarmed == {0}
    assert bank.sums[0] <= -1.0


@pytest.mark.parametrize("sigma", [0.5, 1.0, 4.0])
def test_the_adaptive_threshold_follows_mode_and_sigma(sigma: float) -> None:
    """Mode 2: spread 3 where sigma is 2; the threshold of six spreads lies at 18 sigma / 2."""
    settings = AdaptiveDetector(
        generator="ta.rnn",
        offset=[0.0, 0.0, 1.0, 0.0],
        scale=[1.0, 1.0, 3.0, 1.0],
        usual=[1.0, 1.0, 2.0, 1.0],
        J=6.0,
        hold_s=0.0,
    )
    at = 1.0 + 18.0 * sigma / 2.0
    for r, alarms in ((0.99 * at, False), (1.01 * at, True)):
        bank = DetectorBank([settings], ["ta.rnn"], TIME)
        bank.update(0, 2, Residuals(np.array([r]), np.zeros(1), np.array([sigma]), np.ones(1, np.bool_)))
        assert bool(bank.firing) is alarms


@pytest.mark.parametrize("make", [lambda: Threshold(3.0, HELD), lambda: Adaptive(3.0, HELD)])
def test_an_alarm_is_held_over_a_lull_and_no_longer(make: Callable[[], Threshold]) -> None:
    each = fed(make(), [4.0, *[0.0] * HELD])
    assert each.alarm
    assert each.sign == 1
    each.update(HELD + 1, 0.0)
    assert (each.alarm, each.since) == (False, None)


def test_the_low_pass_reaches_a_level_as_its_time_constant_says() -> None:
    """1 - (1 - 1/tau)^n of a step after n ticks."""
    each = fed(LowPass(J=10.0, hold_ticks=0, time_ticks=20.0), [5.0] * 20)
    assert each.value * 10.0 == pytest.approx(5.0 * (1.0 - 0.95**20))


def test_one_side_is_deaf_on_the_other() -> None:
    assert not fed(Cusum(0.5, 5.0, "above"), [-4.0] * 50).alarm
    assert not fed(Cusum(0.5, 5.0, "below"), [4.0] * 50).alarm


def test_the_spread_does_not_see_a_level_and_measures_a_variance_ratio() -> None:
    """Of 600 ticks to the 2000 before, for differences that are correlated; ln F has nearly the same z."""
    level = fed(Spread(5.0, HELD, 600.0), np.concatenate([QUIET[:2000], QUIET[2000:2600] + 100.0]))
    assert not level.alarm
    halved = Spread(100.0, HELD, 600.0)
    fed(halved, np.concatenate([QUIET[:2000], 0.5 * QUIET[2000:2600]]))
    a, b, root = 2.0 / (9.0 * 2000.0 * 2.0 / 3.0), 2.0 / (9.0 * 600.0 * 2.0 / 3.0), 0.25 ** (1.0 / 3.0)
    expected = ((1.0 - a) * root - (1.0 - b)) / math.sqrt(a * root**2 + b)
    assert halved.value * halved.sign * 100.0 == pytest.approx(expected, rel=0.2)
    assert expected == pytest.approx(2.0 * math.log(0.5) / math.sqrt(3.0 / 600.0 + 3.0 / 2000.0), rel=0.35)


def test_a_variance_ratio_is_once_in_many_hours_beyond_five_without_a_fault() -> None:
    """Of white noise, 55 hours at 5 Hz."""
    each = Spread(5.0, HELD, 600.0)
    for tick, s in enumerate(np.random.default_rng(7).standard_normal(1_000_000)):
        each.update(tick, float(s))
        assert not each.alarm, tick


def test_what_is_there_while_it_alarms_does_not_become_usual() -> None:
    each = fed(Spread(5.0, HELD, 600.0), np.concatenate([QUIET[:2000], 0.5 * np.tile(QUIET, 20)]))
    assert each.alarm


def test_what_was_there_from_the_start_is_usual() -> None:
    assert not fed(Spread(5.0, HELD, 600.0), 0.5 * QUIET).alarm


def test_over_a_gap_the_spread_takes_no_difference() -> None:
    each = Spread(1.0, HELD, 10.0)
    for tick in range(0, 400, 2):
        each.update(tick, 100.0 * (-1) ** (tick // 2))
    assert each.value == 0.0


def ticks_until(each: Detector, values: Iterable[float], begin: int) -> int:
    """How many values it takes until it is below its threshold."""
    for count, s in enumerate(values, start=1):
        each.update(begin + count, s)
        if each.value < 1.0:
            return count
    raise AssertionError("never")


def test_a_large_fault_that_has_ended_is_over_as_soon_as_a_small_one() -> None:
    """The filtered residual is at 2 J at most, and 0.95^n of it after n ticks of nothing."""
    each = fed(LowPass(J=10.0, hold_ticks=0, time_ticks=20.0), [1e6] * 500)
    assert ticks_until(each, [0.0] * 100, 500) == math.ceil(math.log(0.5) / math.log(0.95))


@pytest.mark.parametrize("factor", [0.0, 1e3])
def test_a_variance_that_is_usual_again_is_over_when_the_windows_have_passed(factor: float) -> None:
    each = fed(Spread(5.0, 0, 600.0), np.concatenate([QUIET[:2000], factor * QUIET]))
    assert each.value == 2.0
    assert ticks_until(each, QUIET[:700].tolist(), 5999) <= 610


def test_levels_are_seen_without_the_day_and_variances_with_it() -> None:
    settings = [kinds()["cusum"], kinds()["spread"]]
    one = np.ones(1)
    residuals = Residuals(5.0 * one, one, one, one > 0, level=3.0 * one)
    assert Standard(settings, [0, 0])(0, residuals).tolist() == [3.0, 5.0]
    assert Standard(settings, [0, 0])(0, residuals._replace(level=None)).tolist() == [5.0, 5.0]


def test_a_bank_may_have_no_detector() -> None:
    one = np.ones(2)
    bank = DetectorBank([], ["ta.ode", "tb.ode"], TIME)
    bank.update(0, 0, Residuals(one, one, one, one > 0))
    assert not bank.firing

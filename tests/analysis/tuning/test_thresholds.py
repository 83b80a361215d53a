"""Detectors from made residuals whose centre, spread and lasting bias are known."""

import dataclasses
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from faultline.analysis.tuning.kinds import ALLOWANCE, LASTING, MINIMUM_J, Run, described_by, reached
from faultline.analysis.tuning.statistics import visits
from faultline.analysis.tuning.thresholds import MARGIN, MINIMUM_TICKS, TOLD_TICKS, Seen, seen, standard
from faultline.analysis.tuning.thresholds import tune_detectors as tune_all
from faultline.service.core.detectors.cusum import Cusum
from faultline.service.core.detectors.kinds import kind_of
from faultline.service.core.detectors.spread import Spread
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import CusumDetector, Side
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.residuals.observer import Tick
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.signals.values import Quality
from faultline.service.core.time_scale import TimeScale

IDLE, PARTIAL, MAXIMUM = 1, 2, 3  # indices of the dosing system's modes, behind the edge
MODES, TIME = ("edge", "idle", "partial", "maximum"), TimeScale(0.2, 20.0)  # of the dosing system
OWN = (0, 1, 2, 3)  # every mode is described by its own ticks
LASTING_TICKS = TIME.ticks(LASTING)


Array = npt.NDArray[np.float64]

CENTRE = np.array([0.0, 100.0, -300.0, 50.0])  # Pa, by mode
SPREAD = np.array([2000.0, 200.0, 900.0, 400.0])
FLOOR = np.array([100.0, 1.0])
NAMES = ["ta.ode", "tb.ode"]


def made(seed: int, ticks: int = 4000) -> Seen:
    """White residuals of two generators in 100-tick holds of every mode; the second is twice the first."""
    rng = np.random.default_rng(seed)
    mode = np.tile(np.repeat([EDGE, IDLE, PARTIAL, MAXIMUM], 100), ticks // 400)
    r = CENTRE[mode] + SPREAD[mode] * rng.standard_normal(ticks)
    return Seen(
        f"made-{seed}",
        np.zeros((ticks, 5)),
        np.column_stack([r, 2 * r]),
        np.ones((ticks, 2), np.bool_),
        mode,
        MODES,
        TIME,
    )


def replaced(run: Seen, r: Array | None = None, usable: npt.NDArray[np.bool_] | None = None) -> Seen:
    return dataclasses.replace(run, r=run.r if r is None else r, usable=run.usable if usable is None else usable)


def tune_detectors(
    names: Sequence[str], recordings: Sequence[Seen], floor: Array, stand_ins: Sequence[int] = OWN
) -> list[CusumDetector]:
    """The usual kind."""
    detectors = tune_all(names, recordings, floor, stand_ins)
    cusums = [detector for detector in detectors if isinstance(detector, CusumDetector)]
    assert cusums == detectors
    return cusums


def sums(detector: CusumDetector, run: Seen, row: int = 0) -> Array:
    """The detector's larger sum at every tick of a recording, by the vehicle's own CUSUM."""
    cusum, reached = Cusum(detector.nu, detector.J), []
    offset, scale = np.array(detector.offset), np.array(detector.scale)
    for tick, value in enumerate((run.r[:, row] - offset[run.mode]) / scale[run.mode]):
        cusum.update(tick, float(value))
        reached.append(cusum.value * detector.J)
    return np.array(reached)


RECORDINGS = [made(1), made(2)]
DETECTORS = tune_detectors(NAMES, RECORDINGS, FLOOR)


def test_centre_and_spread_of_every_mode_are_found() -> None:
    assert [detector.generator for detector in DETECTORS] == NAMES
    np.testing.assert_allclose(DETECTORS[0].scale, SPREAD, rtol=0.1)
    assert (np.abs(np.array(DETECTORS[0].offset) - CENTRE) < 0.1 * SPREAD).all()
    np.testing.assert_allclose(DETECTORS[1].scale, 2 * np.array(DETECTORS[0].scale))
    np.testing.assert_allclose(DETECTORS[1].offset, 2 * np.array(DETECTORS[0].offset))


def test_the_unit_of_a_residual_does_not_matter_to_its_thresholds() -> None:
    first, second = DETECTORS
    assert (second.nu, second.J) == pytest.approx((first.nu, first.J), rel=1e-12)


@pytest.mark.parametrize("row", [0, 1])
def test_the_tuning_data_reach_no_more_than_half_of_the_threshold(row: int) -> None:
    detector = DETECTORS[row]
    largest = max(sums(detector, run, row).max() for run in RECORDINGS)
    assert 0 < largest <= detector.J / MARGIN + 1e-9
    assert detector.J >= MINIMUM_J
    assert detector.nu > ALLOWANCE


@pytest.mark.parametrize("sign", [1, -1])
def test_a_shift_of_several_spreads_alarms_soon_and_a_small_one_never(sign: int) -> None:
    fresh, detector = made(3), DETECTORS[0]
    shift = np.zeros_like(fresh.r)
    shift[2000:, 0] = sign * np.array(detector.scale)[fresh.mode[2000:]]
    reached = sums(detector, replaced(fresh, r=fresh.r + 4 * shift))
    alarm = int(np.argmax(reached >= detector.J))
    assert 2000 < alarm < 2000 + 2 * detector.J / (4 - detector.nu)
    assert sums(detector, replaced(fresh, r=fresh.r + ALLOWANCE / 2 * shift)).max() < detector.J


def test_what_lasts_goes_into_the_drift() -> None:
    """A bias of three spreads for 15 s in one tuning recording is no fault: nu covers it with the allowance on top."""
    biased = made(4)
    r = biased.r.copy()
    r[1130 : 1130 + LASTING_TICKS, 0] -= 3 * SPREAD[IDLE]
    hold = biased.mode[1130 : 1130 + LASTING_TICKS]
    detector = tune_detectors(NAMES, [*RECORDINGS, replaced(biased, r=r)], FLOOR)[0]
    standard = np.abs(np.mean((r[1130 : 1130 + LASTING_TICKS, 0] - CENTRE[hold]) / SPREAD[hold]))
    assert detector.nu == pytest.approx(ALLOWANCE + standard, rel=0.2)
    assert detector.nu > DETECTORS[0].nu + 0.5
    assert sums(detector, replaced(biased, r=r)).max() <= detector.J / MARGIN + 1e-9


def test_a_burst_too_short_to_last_goes_into_the_threshold() -> None:
    """Three seconds at eight spreads in a tuning recording: J is twice the sum that they reach."""
    bursting = made(4)
    r = bursting.r.copy()
    r[1130:1145, 0] += 8 * SPREAD[bursting.mode[1130:1145]]
    burst = replaced(bursting, r=r)
    detector = tune_detectors(NAMES, [*RECORDINGS, burst], FLOOR)[0]
    assert detector.nu < 3.0
    np.testing.assert_allclose(detector.J, MARGIN * sums(detector, burst).max())
    assert detector.J > 3 * MINIMUM_J


def test_residuals_quieter_than_the_sensor_have_the_sensors_spread() -> None:
    still = replaced(made(1), r=np.zeros((4000, 2)))
    [detector, _] = tune_detectors(NAMES, [still], np.array([80.0, 80.0]))
    assert detector.scale == [40.0] * len(MODES)
    assert (detector.offset, detector.nu, detector.J) == ([0.0] * len(MODES), ALLOWANCE, MINIMUM_J)


def test_an_outlier_moves_neither_centre_nor_spread() -> None:
    wild = made(1)
    r = wild.r.copy()
    r[::400] = 1e7
    ours = tune_detectors(NAMES, [replaced(wild, r=r)], FLOOR)[0]
    theirs = tune_detectors(NAMES, [wild], FLOOR)[0]
    np.testing.assert_allclose(ours.scale, theirs.scale, rtol=0.1)


def test_what_is_not_usable_is_not_looked_at() -> None:
    run = made(1)
    usable, r = run.usable.copy(), run.r.copy()
    usable[500:600, 0] = False
    r[500:600, 0] = np.nan
    first, second = tune_detectors(NAMES, [replaced(run, r=r, usable=usable)], FLOOR)
    assert np.isfinite([*first.offset, *first.scale, first.nu, first.J]).all()
    assert second == tune_detectors(NAMES, [run], FLOOR)[1]


@pytest.mark.parametrize("mode", range(len(MODES)))
def test_a_missing_mode_is_refused_by_name(mode: int) -> None:
    run = made(1)
    visited = np.flatnonzero(run.mode == mode)
    for kept in (0, MINIMUM_TICKS - 1):
        usable = run.usable.copy()
        usable[visited[kept:], 1] = False
        with pytest.raises(
            InputError,
            match=rf"tuning data \(made-1\): tb.ode saw mode '{MODES[mode]}' for {kept} ticks only; add a .*"
            + (r"with more steps of the inputs, or lower those of \[edges\]$" if mode == EDGE else "that stays in it$"),
        ):
            tune_detectors(NAMES, [replaced(run, usable=usable)], FLOOR)


def test_a_mode_that_the_system_has_not_is_described_by_its_stand_in() -> None:
    """Without a stand-in the same recording is refused; with it only what it stands for must have been seen."""
    run = made(1)
    inside = replaced(run, usable=np.repeat(((run.mode == PARTIAL) | (run.mode == EDGE))[:, None], 2, axis=1))
    with pytest.raises(InputError, match="saw mode 'idle' for 0 ticks only"):
        tune_detectors(NAMES, [inside], FLOOR)
    for detector in tune_detectors(NAMES, [inside], FLOOR, [EDGE, PARTIAL, PARTIAL, PARTIAL]):
        for values in (detector.offset, detector.scale):
            assert values[IDLE] == values[MAXIMUM] == values[PARTIAL] != values[EDGE]


def test_a_mode_may_be_spread_over_recordings() -> None:
    first, second = made(1), made(2)
    halves = []
    for run, mode in ((first, IDLE), (second, MAXIMUM)):
        halves.append(replaced(run, usable=np.repeat((run.mode != mode)[:, None], 2, axis=1)))
    assert len(tune_detectors(NAMES, halves, FLOOR)) == 2


SIGNALS = ["p_before", "p_after", "p_end", "speed", "dose"]


def test_a_recording_of_which_some_test_saw_too_little_is_refused() -> None:
    """Such as one cut off in its warm-up: what would last 15 s, it cannot show."""
    residuals = Residuals(np.zeros(2), np.zeros(2), np.ones(2), np.ones(2, np.bool_))
    blind = residuals._replace(usable=np.array([True, False]))
    nothing, good = np.zeros(5), np.zeros(5, np.int8)
    ticks = [Tick(k, 0.2 * k, nothing, good, IDLE, residuals, nothing) for k in range(TOLD_TICKS - 1)]
    with pytest.raises(InputError, match=f"cut-off: some test could tell for {TOLD_TICKS - 1} ticks only"):
        seen("cut-off", [*ticks, ticks[0]._replace(residuals=blind)], SIGNALS, MODES, TIME)
    assert len(seen("whole", [*ticks, ticks[0]], SIGNALS, MODES, TIME).r) == TOLD_TICKS


def test_a_recording_without_a_usable_tick_is_refused() -> None:
    """Such as a log without the added sensors."""
    with pytest.raises(InputError, match="production: some test could tell for 0 ticks only"):
        seen("production", [], SIGNALS, MODES, TIME)


def test_what_hinders_most_of_a_recording_is_reported() -> None:
    """Such as a message that comes twice as often as its DBC says."""
    residuals = Residuals(np.zeros(2), np.zeros(2), np.ones(2), np.ones(2, np.bool_))
    quality = np.zeros(5, np.int8)
    quality[2] = Quality.DOUBTED
    ticks = [Tick(k, 0.2 * k, np.zeros(5), quality, IDLE, residuals, np.zeros(5)) for k in range(TOLD_TICKS)]
    with pytest.raises(InputError, match=f"for 100 % of it {SIGNALS[2]} is sent by two, or more often than its DBC's"):
        seen("fast", ticks, SIGNALS, MODES, TIME)


def test_ticks_on_both_sides_of_a_gap_are_no_neighbours() -> None:
    """A dropout that is cut out: a difference over it is none, and a stay goes on as another visit."""
    whole = made(3)
    kept = np.flatnonzero((np.arange(len(whole.r)) % 100 < 40) | (np.arange(len(whole.r)) % 100 > 60))
    cut = replace(
        whole, z=whole.z[kept], r=whole.r[kept], usable=whole.usable[kept], mode=whole.mode[kept], number=kept
    )
    [detector] = [d for d in tune_all(NAMES[:1], [cut], FLOOR, OWN, ("cusum", "spread")) if kind_of(d) == "spread"]
    run = standard(cut, 0, described_by(detector), "spread")
    np.testing.assert_array_equal(run.tick, kept)
    before, after = np.flatnonzero(np.diff(kept) > 1)[0], np.flatnonzero(np.diff(kept) > 1)[0] + 1
    seen_there = Spread(1.0, 0, 30.0)
    for index in (before, after):
        seen_there.update(int(run.tick[index]), float(run.s[index]))
    assert seen_there.value == 0.0
    assert len([*visits([cut], IDLE)]) == 2 * len([*visits([whole], IDLE)])


@pytest.mark.parametrize("side", ["both", "above", "below"])
def test_the_sums_of_a_run_are_those_of_the_detector(side: Side) -> None:
    s = np.random.default_rng(7).normal(0.3, 2.0, 3000)
    settings = CusumDetector(generator="ta.ode", offset=[0.0], scale=[1.0], nu=0.5, J=1e9, side=side)
    cusum, expected = Cusum(0.5, 1e9, side), []
    for tick, each in enumerate(s.tolist()):
        cusum.update(tick, each)
        expected.append(cusum.value * 1e9)
    values = reached(settings, Run(np.arange(len(s)), s), 0.2)
    np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-9)
    assert values.max() > 10.0

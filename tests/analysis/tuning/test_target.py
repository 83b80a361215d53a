"""Targets, folds and claims on made drives, whose rate of alarms is known."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from faultline.analysis.graph.runnable import Runnable
from faultline.analysis.tuning.claim import claim, folds, rate_of, thresholds
from faultline.analysis.tuning.kinds import LEAST, LEVEL_KINDS, Kind
from faultline.analysis.tuning.plausible import doubts
from faultline.analysis.tuning.target import Rule, Trace, factor_for, levels
from faultline.analysis.tuning.thresholds import MARGIN, Seen, tune_detectors
from faultline.analysis.tuning.vehicles import Drive, Vehicle, hardly_seen, left_out_offset, moved, offsets, pooled
from faultline.service.bundle.load import load_bundle
from faultline.service.core.decision.offsets import shifted as of_left_out
from faultline.service.core.detectors.bank import DetectorBank
from faultline.service.core.detectors.kinds import kind_of
from faultline.service.core.manifest import Detector, Evidence
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.residuals.observer import Tick
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.time_scale import TimeScale

IDLE, PARTIAL, MAXIMUM = 1, 2, 3  # indices of the dosing system's modes, behind the edge
MODES, TIME = ("edge", "idle", "partial", "maximum"), TimeScale(0.2, 20.0)  # of the dosing system
OWN = (0, 1, 2, 3)
APART = 75


Array = npt.NDArray[np.float64]

SPREAD = np.array([2000.0, 200.0, 900.0, 400.0])
NAMES = ["ta.ode", "tb.ode"]
FLOOR = np.array([100.0, 100.0])
NOBODY = cast("Runnable", None)  # a vehicle's model is asked for nothing here
HOUR = 18_000


def drive(seed: int, offset: float = 0.0, ticks: int = 4000, without: Sequence[int] = ()) -> Drive:
    """White residuals of two generators in 100-tick holds of every mode."""
    rng = np.random.default_rng(seed)
    mode = np.tile(np.repeat([EDGE, IDLE, PARTIAL, MAXIMUM], 100), ticks // 400)
    r = offset + SPREAD[mode][:, None] * rng.standard_normal((ticks, 2))
    usable = np.repeat(~np.isin(mode, [*without])[:, None], 2, axis=1)
    sigma = np.full((ticks, 2), 50.0)
    seen = Seen(f"made-{seed}", np.zeros((ticks, 5)), r, usable, mode, MODES, TIME, sigma)
    nothing, good = np.zeros(5), np.zeros(5, np.int8)
    residuals = [Residuals(*each) for each in zip(r, r, sigma, usable, strict=True)]
    told = [Tick(k, 0.2 * k, nothing, good, int(mode[k]), residuals[k], nothing) for k in range(ticks)]
    return Drive(f"{seed:064d}", told, seen, [])


def vehicle(*drives: Drive) -> Vehicle:
    return Vehicle(NOBODY, drives)


def rule(kind: Kind = "cusum") -> Rule:
    return Rule(NAMES, FLOOR, OWN, (kind,), no_days)


def no_days(_: Sequence[Vehicle], to: Array) -> tuple[Evidence, list[float]]:
    """Evidence of the first generator, which does not stray from one day to the next."""
    [*noise] = ([[float(s**2)]] for s in SPREAD)
    evidence = Evidence(
        generators=NAMES[:1],
        offset=to[:1].T.tolist(),
        spread=[[float(s)] for s in SPREAD],
        noise=noise,
        visit=[[[0.0]]] * len(MODES),
        allowance=[[0.0]] * len(MODES),
        drifts=[],
        operation=[[0.0]] * len(MODES),
        followers=[],
        graph=None,
        hypotheses=[],
    )
    return evidence, []


def suspected(detectors: Sequence[Detector], s: Drive) -> int:
    bank, before, count = DetectorBank(detectors, NAMES, TIME), False, 0
    for tick in s.ticks:
        bank.update(tick.number, tick.mode, tick.residuals)
        count += bool(bank.firing) and not before
        before = bool(bank.firing)
    return count


THREE = [vehicle(drive(10 * v, 500.0 * v), drive(10 * v + 1, 500.0 * v)) for v in (1, 2, 3)]


def test_vehicles_are_centred_each_on_its_own_offsets() -> None:
    to = offsets(THREE[0].drives, OWN)
    assert abs(to[:, IDLE] - 500.0).max() < 50.0
    for s in pooled(THREE, to, OWN):
        assert abs(np.median(s.r[s.mode == IDLE], axis=0) - 500.0).max() < 50.0
    again = pooled(THREE[:1], to, OWN)
    np.testing.assert_array_equal(again[0].r, THREE[0].drives[0].seen.r)


def test_a_drive_left_out_is_centred_by_the_others_of_its_vehicle() -> None:
    strange = vehicle(drive(1, 100.0), drive(2, 900.0))
    usual = np.zeros((2, len(MODES)))
    assert left_out_offset(strange, 1, OWN, usual)[0, IDLE] == pytest.approx(100.0, abs=60.0)
    np.testing.assert_array_equal(left_out_offset(strange.only(0), 0, OWN, usual), usual)


def test_a_mode_that_the_rest_does_not_show_leaves_nothing_out() -> None:
    pair = vehicle(drive(1), drive(2, without=[MAXIMUM]))
    assert hardly_seen(pair.drives[1:], OWN) == (0, MAXIMUM, 0)
    assert [fold.test[0][0] for fold in folds([pair], OWN)] == [pair.drives[1]]
    assert folds([pair.only(0)], OWN) == []


def test_of_several_vehicles_whole_ones_are_left_out() -> None:
    found = folds(THREE, OWN)
    assert [[d for d, _ in fold.test] for fold in found] == [list(each.drives) for each in THREE]
    for index, fold in enumerate(found):
        assert THREE[index] not in fold.train
        assert fold.hours == pytest.approx(2 * 4000 / HOUR)


def shifted(s: Drive, by: float, ticks: slice) -> Drive:
    """The drive with its first residual further off under partial dose, in some of its ticks."""
    r, there = s.seen.r.copy(), np.zeros(len(s.seen.r), dtype=np.bool_)
    there[ticks] = True
    r[there & (s.seen.mode == PARTIAL), 0] += by
    return replace(s, seen=replace(s.seen, r=r))


def doubted(*drives: Drive, days: float = 500.0) -> list[str]:
    """What is said of drives of a vehicle whose means stray by `days` from day to day."""
    found, to = folds([vehicle(*drives)], OWN), np.zeros((2, len(MODES)))
    evidence = msgspec.structs.replace(no_days([], to)[0], allowance=[[days]] * len(MODES))
    return [doubt for fold in found for doubt in doubts(fold, evidence, NAMES, OWN)]


def test_a_drive_far_from_the_others_is_doubted_and_only_that() -> None:
    sound = [drive(seed) for seed in (1, 2, 3)]
    assert doubted(*sound) == []
    [said] = doubted(*sound, shifted(drive(4), 3000.0, slice(None)))
    assert re.fullmatch(
        r"made-4: ta.ode lies 4\.\d standard deviations from the other drives in mode 'partial' \(4 are plausible\): "
        r"is there a fault in it\? Leave it out, or know why",
        said,
    )
    assert doubted(*sound, shifted(drive(4), 1500.0, slice(None))) == []  # a day


def test_a_step_within_a_drive_is_doubted_though_it_is_a_days_size() -> None:
    """White noise of 900 in 500 ticks of each half: a standard deviation of 57."""
    [said] = doubted(drive(1), shifted(drive(2), 1000.0, slice(2000, None)))
    assert re.match(r"made-2: ta.ode lies 6\.\d standard deviations apart in the drive's two halves in mode 'p", said)


def test_of_a_single_drive_nothing_is_known() -> None:
    assert doubted(shifted(drive(1), 3000.0, slice(2000, None))) == []


@pytest.mark.parametrize("kind", LEVEL_KINDS)
def test_every_kind_is_tuned_quiet_and_sees_a_large_shift(kind: Kind) -> None:
    one = vehicle(drive(1), drive(2), drive(3))
    detectors = tune_detectors(NAMES, [d.seen for d in one.drives], FLOOR, OWN, (kind, "spread"))
    assert [d.generator for d in detectors[:2]] == NAMES
    assert [kind_of(d) for d in detectors[-2:]] == ["spread", "spread"]
    level = detectors[:-2]
    assert suspected(detectors, one.drives[0]) == 0
    fresh = drive(4)
    far = np.array([40.0 * SPREAD, np.zeros(len(MODES))])
    ticks = [
        t._replace(residuals=t.residuals._replace(r=t.residuals.r + far[:, t.mode] * (t.number > 2000)))
        for t in fresh.ticks
    ]
    assert suspected(level, Drive(fresh.sha256, ticks, fresh.seen, [])) >= 1
    assert suspected(level, fresh) == 0


def test_a_quieter_residual_is_seen_by_the_spread_alone() -> None:
    one = vehicle(drive(1), drive(2), drive(3))
    detectors = tune_detectors(NAMES, [d.seen for d in one.drives], FLOOR, OWN, ("cusum", "spread"))
    loud = drive(4)
    ticks = [
        t._replace(residuals=t.residuals._replace(r=(0.2 if t.number > 2000 else 1.0) * t.residuals.r))
        for t in loud.ticks
    ]
    quiet = Drive(loud.sha256, ticks, loud.seen, [])
    assert suspected(detectors[2:], quiet) == 1
    assert suspected([*detectors[:2]], quiet) == 0


def poisson(seed: int, hours: float, rate: float) -> Trace:
    """Exponential peaks of mean 1 above 0, `rate` of them an hour above 5."""
    rng = np.random.default_rng(seed)
    x = np.zeros(round(hours * HOUR))
    at = rng.choice(len(x) // 100, rng.poisson(hours * rate * np.exp(5.0)), replace=True) * 100
    np.maximum.at(x, at, rng.exponential(1.0, len(at)))
    return Trace(x, hours, APART)


def test_with_hours_enough_the_factor_is_counted_and_right() -> None:
    """1 an hour lies at 5."""
    blocks = [[poisson(seed, 10.0, 1.0)] for seed in range(6)]
    factor = factor_for(1.0, blocks)
    assert not factor.extrapolated
    assert factor.value == pytest.approx(5.0, abs=0.4)
    assert sum(len(t.peaks(factor.value)) for [t] in blocks) <= 60


def test_with_too_few_hours_the_tail_is_drawn_on_and_holds() -> None:
    """0.02 an hour lies at 5 + ln 50 = 8.9; from two hours the upper bound is beyond that, and not absurdly."""
    blocks = [[poisson(seed, 0.5, 1.0)] for seed in range(4)]
    factor = factor_for(0.02, blocks)
    assert factor.extrapolated
    assert 8.9 <= factor.value < 25.0


def test_traces_that_never_leave_zero_have_a_factor() -> None:
    """Of all drives, or of those that resampling draws alone."""
    still = [Trace(np.zeros(HOUR // 2), 0.5, APART)]
    assert factor_for(0.02, [still, still]).value == 0.0
    peaked = poisson(1, 0.5, 1.0)
    assert factor_for(0.02, [still, still, [peaked]]).value > float(peaked.x.max())


@pytest.mark.parametrize("target", [5.0, 0.5])
def test_thresholds_for_a_target_keep_it_on_other_drives(target: float) -> None:
    """Counted on hours that nothing was tuned on, within what chance makes of it (99.9 %)."""
    to = offsets(THREE[0].drives, OWN)
    found = thresholds(THREE, folds(THREE, OWN), rule(), target, to)
    assert found.extrapolated is (target * sum(f.hours for f in folds(THREE, OWN)) < 1.0)
    assert len(found.of_folds) == 3
    fresh = [drive(seed, 500.0, ticks=20_000) for seed in (91, 92)]
    hours = sum(each.hours for each in fresh)
    assert sum(suspected(found.whole.detectors, each) for each in fresh) <= 3 + 3 * target * hours
    assert all(LEAST["cusum"] <= d.J for d in found.whole.detectors)


def test_a_single_drive_has_thresholds_and_no_claim() -> None:
    one = [vehicle(drive(1))]
    to = offsets(one[0].drives, OWN)
    found = thresholds(one, [], rule(), 0.1, to)
    assert found.extrapolated
    made = claim(one, [], np.zeros((0, 2)), 0.1, extrapolated=True)
    assert (made.suspicions.upper, made.result, made.left_out) == (None, None, 0)
    assert "nothing is known of their rate" in made.said
    assert "target 0.1 suspicions per hour: cannot be told" in made.said


def test_levels_are_the_mean_of_what_drives_reach_and_never_below_the_least() -> None:
    to = offsets(THREE[0].drives, OWN)
    usual = levels(THREE, rule(), to, no_days(THREE, to)[0])
    assert {d.J for d in usual} == {LEAST["cusum"] / MARGIN}
    strange = vehicle(*THREE[0].drives, drive(7, 900.0))  # a drive whose level differs: nu must cover it
    covering = levels([strange], rule(), to, no_days([strange], to)[0])
    assert covering[0].nu > usual[0].nu + 0.5  # type: ignore[union-attr]


def test_the_claim_counts_bounds_and_says_what_was_left_out() -> None:
    counts = np.array([[2.0, 0.0], [0.0, 0.0], [1.0, 0.0]])
    left_out = folds(THREE, OWN)
    made = claim(THREE, left_out, counts, 10.0, extrapolated=False)
    hours = 6 * 4000 / HOUR
    assert (made.vehicles, made.drives, made.left_out) == (3, 6, 6)
    assert made.suspicions.count == 3
    assert made.suspicions.hours == pytest.approx(hours)
    assert made.suspicions.upper == pytest.approx(7.754 / hours, rel=1e-3)  # Poisson: 3 events, 95 %
    assert made.diagnoses.upper == pytest.approx(2.996 / hours, rel=1e-3)
    assert made.suspicions.low == 0.0
    assert made.suspicions.high == pytest.approx(2.0 / (2 * 4000 / HOUR))  # the worst vehicle three times
    assert made.result == "shown"
    assert "6 fault-free drives of 3 vehicles, 6 left out of tuning in turn, 1.33 h: 3 suspicions" in made.said
    assert claim(THREE, left_out, counts, 3.0, extrapolated=False).result == "kept"
    missed = claim(THREE, left_out, counts, 0.01, extrapolated=True)
    assert missed.result == "missed"
    assert "to show it needs 300 h without one, there are 1.33 h" in missed.said
    assert "exponential tail" in missed.said


def test_one_drive_left_out_is_not_resampled() -> None:
    pair = [vehicle(drive(1), drive(2, without=[MAXIMUM]))]
    made = claim(pair, folds(pair, OWN), np.array([[6.0, 0.0]]), None, extrapolated=False)
    assert made.left_out == 1
    assert re.search(
        r"6 suspicions, \d+ per hour \(95 %: at most \d+; one drive cannot be resampled\); 0 conf", made.said
    )
    counts = np.array([[6.0, 0.0], [0.0, 0.0]])
    both = [vehicle(drive(1), drive(2))]
    assert "; resampling drives: 0 to " in claim(both, folds(both, OWN), counts, None, extrapolated=False).said


def test_resampling_whole_vehicles_shows_that_they_differ() -> None:
    """The same count of one bad vehicle and of all alike: the exact bound is the same, the spread is not."""
    hours = np.ones(6)
    bad, alike = rate_of(np.array([6.0, 0, 0, 0, 0, 0]), hours), rate_of(np.ones(6), hours)
    assert bad.upper == alike.upper
    assert (alike.low, alike.high) == (1.0, 1.0)
    assert bad.high >= 2.0


def test_moving_a_recording_moves_each_mode_by_its_own() -> None:
    s = THREE[0].drives[0].seen
    by = np.arange(8.0).reshape(2, 4)
    np.testing.assert_allclose(
        (moved(s, by).r - s.r)[s.mode == PARTIAL], [[2.0, 6.0]] * int((s.mode == PARTIAL).sum()), atol=1e-9
    )


def test_a_left_out_vehicles_offsets_are_those_of_all_its_tests() -> None:
    """Detectors, evidence and what follows from its day are moved together: else a test alarms from the start."""
    manifest = load_bundle(Path(__file__).parents[2] / "golden" / "bundle").manifest
    names = [generator.name for generator in manifest.generators]
    by = np.arange(float(len(names) * len(MODES))).reshape(len(names), len(MODES))
    other = of_left_out(manifest, by)
    assert manifest.evidence.followers
    assert {*manifest.evidence.generators} | {f.generator for f in manifest.evidence.followers} == {*names}
    for was, now in (
        *zip(manifest.detectors, other.detectors, strict=True),
        *zip(manifest.evidence.followers, other.evidence.followers, strict=True),
    ):
        assert np.array(now.offset) - was.offset == pytest.approx(by[names.index(was.generator)])
    rows = [names.index(name) for name in manifest.evidence.generators]
    assert np.array(other.evidence.offset) - manifest.evidence.offset == pytest.approx(by[rows].T)

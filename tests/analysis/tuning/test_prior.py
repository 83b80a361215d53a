"""What vehicles show of variances is found again; another one is known neither too surely nor too vaguely."""

from collections.abc import Sequence

import msgspec
import numpy as np
import numpy.typing as npt
import pytest
from scipy.stats import chi2

from faultline.analysis.tuning.file import SCHEMA, Tuning
from faultline.analysis.tuning.prior import FREEDOM, Prior, no_lower, pooled, posterior
from faultline.analysis.tuning.statistics import OfDrive, OfMode
from faultline.analysis.tuning.straying import SUPPOSED, as_seen, doubted
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import CusumDetector, Evidence, Modes
from faultline.service.core.time_scale import TimeScale

Array = npt.NDArray[np.float64]

SEED = 4711
MODES, TIME = Modes(steady=[], edges={}, settle_s=5.0), TimeScale(0.2, 20.0)
C, T, TICKS = 3, 4, 1000
BETWEEN, WITHIN, DRIFT, SPREAD, VISIT = 3.0, 1.0, 2.0, 10.0, 0.5
NAMED = np.array([[1.0, 1.0, 0.0, -1.0]] * C)[None]
"""The drift that the model names moves all modes alike."""


def drive(rng: np.random.Generator, level: Array, loud: float = 1.0, hardly: Sequence[int] = ()) -> OfDrive:
    """The statistics of a drive of a vehicle around its level (C, T)."""
    mean = level + WITHIN * rng.normal(size=(C, T)) + DRIFT * rng.normal() * NAMED[0]

    def of(mode: int) -> OfMode:
        steps, visits = (loud * size * rng.normal(size=(40, T)) for size in (SPREAD, VISIT))
        return OfMode(
            ticks=3 if mode in hardly else TICKS,
            mean=(0.0 * mean[mode] if mode in hardly else mean[mode]).tolist(),
            spread=[loud * SPREAD] * T,
            differences=40,
            noise=(steps.T @ steps).tolist(),
            freedom=10,
            between=(visits[:10].T @ visits[:10]).tolist(),
        )

    return OfDrive("made", 0.1, [of(mode) for mode in range(C)])


def vehicle(rng: np.random.Generator, drives: int, loud: float = 1.0) -> list[OfDrive]:
    level = BETWEEN * rng.normal(size=(C, T)) * np.ones((C, T))
    return [drive(rng, level, loud) for _ in range(drives)]


def tuning(drives: list[OfDrive], J: float = 15.0) -> Tuning:
    names = [f"r{k}" for k in range(T)]
    zeros = [[0.0] * T] * C
    evidence = Evidence(
        generators=names,
        offset=zeros,
        spread=zeros,
        noise=[],
        visit=[],
        allowance=zeros,
        drifts=NAMED.tolist(),
        operation=zeros,
        followers=[],
        graph=None,
        hypotheses=[],
    )
    detectors = [CusumDetector(generator=name, offset=[0.0] * C, scale=[1.0] * C, nu=0.5, J=J) for name in names]
    return Tuning(
        schema=SCHEMA,
        model_sha256="",
        recordings=[],
        calibrated=[],
        modes=MODES,
        period_s=0.2,
        start_within_s=1.0,
        detectors=[*detectors],
        evidence=evidence,
        inputs=[],
        golden_z=[],
        zero=[[0.0] * C] * T,
        drift_sizes=[1.0],
        statistics=drives,
    )


def fleet(rng: np.random.Generator, vehicles: int = 60, drives: int = 5) -> Prior:
    return pooled({f"v{k}": tuning(vehicle(rng, drives), 15.0 + k) for k in range(vehicles)}, TIME)


def test_variances_between_and_within_vehicles_are_found_again() -> None:
    prior = fleet(np.random.default_rng(SEED))
    bounds = prior.within.times(1.0 / doubted(60 * 4.0)), prior.between.times(1.0 / doubted(60 - 1.0))
    assert bounds[0].sizes == pytest.approx([DRIFT], rel=0.1)
    within, between = (of.covariance(NAMED) for of in bounds)
    truth = np.diag(np.full(C * T, WITHIN**2)) + DRIFT**2 * np.outer(NAMED, NAMED)
    steady = slice(T, None)  # at the edge a mean is not looked at
    np.testing.assert_allclose(within[steady, steady], truth[steady, steady], atol=0.8)
    np.testing.assert_allclose(between.diagonal()[steady], BETWEEN**2, rtol=0.6)
    np.testing.assert_allclose(np.array(prior.noise.covariance)[1].diagonal(), SPREAD**2, rtol=0.1)
    np.testing.assert_allclose(np.array(prior.visit.covariance)[1].diagonal(), VISIT**2, rtol=0.2)
    assert prior.noise.freedom == FREEDOM[1], "all vehicles are equally loud"
    assert prior.visit.freedom == SUPPOSED, "but one may have effects of visits that no other has"


def test_vehicles_that_differ_in_loudness_leave_their_own_more_to_say() -> None:
    rng = np.random.default_rng(SEED)
    louder = {f"v{k}": tuning(vehicle(rng, 5, float(rng.uniform(0.4, 2.5)))) for k in range(60)}
    assert pooled(louder, TIME).noise.freedom < 15.0


@pytest.mark.parametrize(("vehicles", "of_each", "seen"), [(8, 4, 1), (14, 4, 1), (60, 5, 1), (60, 5, 3)])
def test_the_next_drive_lies_where_it_is_said_to(vehicles: int, of_each: int, seen: int) -> None:
    """Of other vehicles, by fleets of few and of many: the means of the next drive are chi-square, or closer."""
    rng = np.random.default_rng(SEED)
    found, steady = [], slice(T, None)
    for _ in range(20):
        prior = fleet(rng, vehicles, of_each)
        for _ in range(20):
            *shown, after = vehicle(rng, seen + 1)
            known = posterior(prior, shown, NAMED)
            drifts = known.drifts.reshape(len(known.drifts), -1)[:, steady]
            said = np.diag(known.own.ravel()[steady] ** 2) + drifts.T @ drifts
            away = (np.array([m.mean for m in after.modes]) - known.offset).ravel()[steady]
            found.append(away @ np.linalg.solve(said, away))
    means = (C - 1) * T
    assert np.mean(np.array(found) > chi2.ppf(0.99, means)) < 0.02
    assert 0.6 < np.mean(found) / means < 1.0


def test_a_mode_that_a_drive_hardly_showed_stays_as_open_as_the_fleet_leaves_it() -> None:
    rng = np.random.default_rng(SEED)
    prior = fleet(rng)
    level = np.zeros((C, T))
    one, cut = posterior(prior, [drive(rng, level)], NAMED), posterior(prior, [drive(rng, level, hardly=[2])], NAMED)
    variance = [np.square(known.own[2]) + np.square(known.drifts[:, 2]).sum(axis=0) for known in (one, cut)]
    assert (variance[1] > 1.5 * variance[0]).all()
    assert (cut.far[2] == 0.0).all()


def test_a_vehicle_with_a_fault_lies_far_from_the_fleet() -> None:
    rng = np.random.default_rng(SEED)
    prior = fleet(rng)
    level = np.zeros((C, T))
    sound = posterior(prior, [drive(rng, level)], NAMED).far
    level[:, 1] = 40.0
    assert sound.max() < 4.0 < posterior(prior, [drive(rng, level)], NAMED).far[1:, 1].min()


def test_thresholds_are_not_below_the_median_vehicles() -> None:
    prior = fleet(np.random.default_rng(SEED), vehicles=5, drives=2)
    own = [msgspec.structs.replace(d, J=J) for d, J in zip(tuning([]).detectors, (1.0, 100.0, 16.0, 18.0), strict=True)]
    assert [d.J for d in no_lower(own, prior)] == [17.0, 100.0, 17.0, 18.0]


def test_few_vehicles_or_others_make_no_fleet() -> None:
    rng = np.random.default_rng(SEED)
    one, several = tuning(vehicle(rng, 1)), tuning(vehicle(rng, 2))
    with pytest.raises(InputError, match="3 vehicles have two drives or more; a fleet needs 4"):
        pooled({"a": one, "b": several, "c": several, "d": several}, TIME)
    with pytest.raises(InputError, match="d: its tests, modes or period"):
        pooled({"a": one, "d": msgspec.structs.replace(several, period_s=1.0)}, TIME)
    with pytest.raises(InputError, match="d: its tuning has no statistics of drives"):
        pooled({"a": one, "d": tuning([])}, TIME)


@pytest.mark.parametrize("together", [0.0, 3.0])
def test_the_next_drive_of_a_vehicle_with_drives_of_its_own(together: float) -> None:
    """Of 300 vehicles with ten drives, whose means stray together in a way that no model names, or do not."""
    rng = np.random.default_rng(SEED)
    direction, found = rng.normal(size=(C, T)), []
    for _ in range(300):
        means = np.array([WITHIN * rng.normal(size=(C, T)) + DRIFT * rng.normal() * NAMED[0] for _ in range(11)])
        means += together * rng.normal(size=(11, 1, 1)) * direction
        apart = (means[:10] - means[:10].mean(axis=0)) * 10 / 9  # each beside the mean of the others
        own, drifts, _ = as_seen(apart, np.full((C, T), SPREAD), NAMED, T)
        along = drifts[:, 1:].reshape(len(drifts), -1)
        said = doubted(9.0) ** 2 * (np.diag(own[1:].ravel() ** 2) + along.T @ along)
        away = (means[10] - means[:10].mean(axis=0))[1:].ravel()
        found.append(away @ np.linalg.solve(said, away))
    assert np.mean(np.array(found) > chi2.ppf(0.99, away.size)) < 0.03
    assert 0.5 < np.mean(found) / away.size < 1.0

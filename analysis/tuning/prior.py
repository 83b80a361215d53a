"""What a fleet teaches of a vehicle before it is seen: empirical Bayes over vehicles of one kind.

The mean residuals y of drive d of vehicle v, over all modes and generators, are

    y_vd = mu + b_v + w_vd,    b_v ~ N(0, B),  w_vd ~ N(0, W)

B and W are made of the drifts that the model names (times a size), of directions in which means stray together, and of
what each strays by itself. Covariances of ticks and visits differ from vehicle to vehicle as scaled inverse chi-square
variables do. All of that is found from sufficient statistics of drives (`analysis.tuning.statistics`), by moments and
expectation maximisation (Efron, Morris, JASA 1975; Gelman et al., Bayesian Data Analysis, 3rd ed., 5.4 and 11.6). A few
vehicles show B and W badly, and what is not seen there would be a fault: upper bounds are taken.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from faultline.analysis.tuning.file import Tuning
from faultline.analysis.tuning.statistics import OfDrive, noise_of, visits_of
from faultline.analysis.tuning.straying import SUPPOSED, VISIT, Supposed, as_seen, doubted
from faultline.service.core.decision.straying import MINIMUM_TICKS
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import CusumDetector, Detector, Modes
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.time_scale import TimeScale

Array = npt.NDArray[np.float64]

SCHEMA = "faultline.fleet/1"
VEHICLES = 4
"""Vehicles with two drives or more from which the variances of vehicles are seen, at least."""
FREEDOM = (5.0, 200.0)
"""Degrees of freedom within which a variance's distribution over vehicles is kept: few vehicles say it badly."""
FEW = 3
"""Squares from which a vehicle's variance is compared with the others'."""
LEFT = 0.01
"""Of a mean's variance: a direction with less in every mean is what each strays by itself."""


class Scatter(msgspec.Struct, frozen=True):
    """A covariance of means: `own` (modes, T) standard deviations, and `drifts` (n, modes, T) of all together.

    The drifts that the model names come besides, `sizes` times as large as it says. All of that is an upper bound: one
    fleet in ten strays further (`analysis.tuning.straying.doubted`).
    """

    own: list[list[float]]
    drifts: list[list[list[float]]]
    sizes: list[float]

    def covariance(self, named: Array) -> Array:
        """Return it (modes T, modes T); `named` (n, modes, T) are the drifts as a vehicle's own model says."""
        D = named[0].size if len(named) else np.size(self.own)
        along = np.array(self.sizes)[:, None] * named.reshape(-1, D)
        others = np.array(self.drifts).reshape(-1, D)
        return np.asarray(np.diag(np.ravel(self.own) ** 2) + along.T @ along + others.T @ others)

    def times(self, factor: float) -> "Scatter":
        """Return it with so many times the standard deviations."""
        return Scatter(*((factor * np.array(each)).tolist() for each in (self.own, self.drifts, self.sizes)))


class Usual(msgspec.Struct, frozen=True):
    """Covariances (modes, T, T) [unit of r squared]; each vehicle's own differ from them as of `freedom` degrees."""

    covariance: list[list[list[float]]]
    freedom: float

    def at_most(self, freedom: float) -> "Usual":
        """Return it with vehicles no more alike than as of so many degrees."""
        return Usual(self.covariance, min(self.freedom, freedom))

    def supposed(self, rows: Sequence[int], modes: set[int]) -> Supposed:
        """Return what is supposed of these generators."""
        of = np.array(self.covariance)
        return Supposed({mode: of[mode][np.ix_(rows, rows)] for mode in modes}, self.freedom)


class Prior(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is known of a vehicle of a fleet: `mean` (modes, T) of its residuals [unit of r], and how that varies.

    `between` vehicles and `within` a vehicle from drive to drive; `noise` of a tick and effect of a `visit` are those
    of vehicles. `detectors` have the median vehicle's thresholds. `recordings` (SHA-256) are those that have made it.
    """

    schema: str
    generators: list[str]
    modes: Modes
    period_s: float
    vehicles: int
    drives: int
    hours: float
    recordings: list[str]
    mean: list[list[float]]
    between: Scatter
    within: Scatter
    noise: Usual
    visit: Usual
    detectors: list[Detector]


class Posterior(NamedTuple):
    """What is known of a vehicle's next drive: it lies around `offset` (modes, T), and strays.

    By itself each mean strays by `own` (modes, T), all together along `drifts` (n, modes, T), of which the first are
    named by the model and have `sizes` (n,). `far` (modes, T) is how far the vehicle's means lie from the fleet's, in
    standard deviations, zero where it showed none.
    """

    offset: Array
    own: Array
    drifts: Array
    sizes: Array
    far: Array


class Known(NamedTuple):
    """What a fleet teaches of a vehicle, and the drifts (n, modes, T) as large as the vehicle's own model says."""

    prior: Prior
    named: Array
    posterior: Posterior

    def of(self, drives: Sequence[OfDrive]) -> "Known":
        """Return what is known by these drives of the vehicle."""
        return self._replace(posterior=posterior(self.prior, drives, self.named))


def pooled(tunings: Mapping[str, Tuning], time: TimeScale) -> Prior:
    """Return what the tunings of a fleet, by vehicle, say of another vehicle.

    Raises:
        InputError: the tunings are of different tests or modes, or hold too few drives.
    """
    first, *_ = tunings.values()
    for name, each in tunings.items():
        _check_alike(name, first, each)
    fleet = [each.statistics for each in tunings.values()]
    if (several := sum(len(drives) > 1 for drives in fleet)) < VEHICLES:
        raise InputError(f"{several} vehicles have two drives or more; a fleet needs {VEHICLES}: give more recordings")
    generators = [d.generator for d in first.detectors[: len(first.zero)]]
    named = np.mean([_named(each, generators) for each in tunings.values()], axis=0)  # (n, modes, T)
    spread = _usual_spread(fleet)
    means, away = _levels(fleet)
    mean, count = _mean(means), len(means)
    within = _scatter(away, spread, named)
    total = _scatter(np.nan_to_num(means - mean) * np.sqrt(count / (count - 1.0)), spread, named)
    between = _less(total, within, float(np.mean([1.0 / len(drives) for drives in fleet])))
    noise = _usual(fleet, noise_of, [np.diag(each**2) for each in spread], float(len(generators)))
    levels = [each / time.ticks(VISIT) for each in np.array(noise.covariance)]
    return Prior(
        schema=SCHEMA,
        generators=generators,
        modes=first.modes,
        period_s=first.period_s,
        vehicles=count,
        drives=sum(map(len, fleet)),
        hours=sum(drive.hours for drives in fleet for drive in drives),
        recordings=[sha256 for each in tunings.values() for sha256 in (*each.recordings, *each.calibrated)],
        mean=mean.tolist(),
        between=between.times(doubted(count - 1.0)),
        within=within.times(doubted(float(sum(map(len, fleet)) - count))),
        noise=noise,
        # one vehicle has what none of the others has (a worn sensor's backlash): its own visits are soon to say more
        visit=_usual(fleet, visits_of, levels, SUPPOSED).at_most(SUPPOSED),
        detectors=_median([each.detectors for each in tunings.values()]),
    )


def posterior(prior: Prior, drives: Sequence[OfDrive], named: Array) -> Posterior:
    """Return what drives say of their vehicle; `named` (n, modes, T) are the drifts by its own model.

    The mean of R drives lies around the vehicle's with W / R; a mode that a drive did not show is missing there.
    """
    y = _means(drives)
    _, C, T = y.shape
    shown = np.isfinite(y[..., 0])
    drives_of = np.maximum(shown.sum(axis=0), 1)
    together = np.kron(shown.T.astype(float) @ shown / np.outer(drives_of, drives_of), np.ones((T, T)))
    mean, B, W = np.array(prior.mean).ravel(), prior.between.covariance(named), prior.within.covariance(named)
    there = np.repeat(shown.any(axis=0), T)
    scale = np.sqrt(np.maximum(B + W, 0.0).diagonal())
    level = np.where(shown[..., None], np.nan_to_num(y), 0.0).sum(axis=0).ravel() / np.repeat(drives_of, T)
    unit = 1.0 / np.outer(scale, scale)
    seen = ((B + together * W) * unit)[np.ix_(there, there)]
    gain = np.linalg.solve(seen, (B * unit)[there]).T  # (D, seen)
    apart = ((level - mean) / scale)[there]
    left = B * unit - gain @ (B * unit)[there]
    more, own = _along(left)
    sizes = np.array(prior.within.sizes)
    far = np.zeros(C * T)
    far[there] = np.abs(apart) / np.sqrt(seen.diagonal())
    of_model = sizes[:, None, None] * named
    others = np.array(prior.within.drifts).reshape(-1, C, T)
    return Posterior(
        offset=(mean + scale * (gain @ apart)).reshape(C, T),
        own=np.hypot(np.array(prior.within.own), (scale * own).reshape(C, T)),
        drifts=np.concatenate([of_model, others, (more * scale).reshape(-1, C, T)]),
        sizes=sizes,
        far=far.reshape(C, T),
    )


def no_lower(detectors: Sequence[Detector], prior: Prior) -> list[Detector]:
    """Return the detectors, none with a threshold below the median vehicle's: a few drives show few extremes."""
    usual = {(d.generator, type(d)): d for d in prior.detectors}
    found: list[Detector] = []
    for d in detectors:
        of = usual.get((d.generator, type(d)))
        if isinstance(d, CusumDetector) and isinstance(of, CusumDetector):
            found.append(msgspec.structs.replace(d, nu=max(d.nu, of.nu), J=max(d.J, of.J)))
        else:
            found.append(d if of is None else msgspec.structs.replace(d, J=max(d.J, of.J)))
    return found


def load_prior(path: Path) -> Prior:
    """Return the fleet in a file.

    Raises:
        InputError: the file is absent, or no fleet of this version.
    """
    if not path.is_file():
        raise InputError(f"{path}: not found; `faultline fleet tune` writes it")
    try:
        prior = msgspec.json.decode(path.read_bytes(), type=Prior)
    except msgspec.DecodeError as error:
        raise InputError(f"{path}: not a fleet's file: {error}; run `faultline fleet tune` again") from error
    if prior.schema != SCHEMA:
        raise InputError(f"{path}: schema: this is {prior.schema!r}, wanted is {SCHEMA!r}; run `faultline fleet tune`")
    return prior


def _check_alike(name: str, first: Tuning, other: Tuning) -> None:
    tests, others = ([d.generator for d in each.detectors] for each in (first, other))
    if (tests, first.modes, first.period_s) != (others, other.modes, other.period_s):
        raise InputError(
            f"{name}: its tests, modes or period are not those of the others; give vehicles calibrated from one model"
        )
    if other.networks_sha256 is not None:
        raise InputError(f"{name}: has networks, which are of one vehicle only; tune the fleet without networks")
    if not other.statistics:
        raise InputError(f"{name}: its tuning has no statistics of drives; run `faultline tune` for it again")


def _named(tuning: Tuning, generators: Sequence[str]) -> Array:
    """The drifts (n, modes, T) that a vehicle's model names, as large as it says."""
    evidence, sizes = tuning.evidence, np.array(tuning.drift_sizes or [])
    modes = len(evidence.offset)
    found = np.zeros((len(sizes), modes, len(generators)))
    columns = [generators.index(name) for name in evidence.generators]
    found[..., columns] = np.array(evidence.drifts).reshape(-1, modes, len(columns))[: len(sizes)]
    for follower in evidence.followers:
        own = np.array(follower.drifts).reshape(-1, modes)[: len(sizes)]
        found[..., generators.index(follower.generator)] = own
    return np.asarray(found / np.maximum(sizes, 1e-9)[:, None, None])


def _means(drives: Sequence[OfDrive]) -> Array:
    """The means (R, modes, T) of drives, NaN where a mode was hardly seen."""
    return np.array(
        [[m.mean if m.ticks >= MINIMUM_TICKS else [np.nan] * len(m.mean) for m in drive.modes] for drive in drives]
    )


def _levels(fleet: Sequence[Sequence[OfDrive]]) -> tuple[Array, Array]:
    """The means (V, modes, T) of vehicles, and how far (R, modes, T) their drives lie from what these stand for.

    Deviations from a mean of n are smaller by sqrt((n - 1) / n). What was not seen is zero, and the rest that much
    larger (`analysis.tuning.straying.strays`).
    """
    means, away = [], []
    for drives in fleet:
        y = _means(drives)
        n = np.isfinite(y).sum(axis=0)
        mean = np.where(n > 0, np.nansum(y, axis=0) / np.maximum(n, 1), np.nan)
        means.append(mean)
        away.append(np.where(n > 1, (y - mean) * np.sqrt(n / np.maximum(n - 1, 1)), np.nan))
    every = np.concatenate(away)
    shown = np.isfinite(every)
    return np.array(means), np.where(shown, every, 0.0) * np.sqrt(len(every) / np.maximum(shown.sum(axis=0), 1))


def _mean(values: Array) -> Array:
    """The mean over the first axis of what is there, zero of nothing."""
    there = np.isfinite(values).sum(axis=0)
    return np.asarray(np.nan_to_num(values).sum(axis=0) / np.maximum(there, 1))


def _usual_spread(fleet: Sequence[Sequence[OfDrive]]) -> Array:
    """The mean spread (modes, T) of ticks, over drives that show it."""
    every = np.array([[m.spread for m in drive.modes] for drives in fleet for drive in drives])
    shown = (every > 0.0).sum(axis=0)
    return np.asarray(np.where(shown > 0, every.sum(axis=0) / np.maximum(shown, 1), 1.0))


def _scatter(away: Array, spread: Array, named: Array) -> Scatter:
    own, drifts, sizes = as_seen(away, spread, named, away.shape[-1])
    own[EDGE] = np.sqrt((away[:, EDGE] ** 2).mean(axis=0))  # of many drives the largest is no scale
    return Scatter(own.tolist(), drifts[len(sizes) :].tolist(), sizes.tolist())


def _less(total: Scatter, within: Scatter, part: float) -> Scatter:
    """What of the means' scatter is the vehicles', and not that of their few drives."""
    own, sizes = (
        np.sqrt(np.maximum(np.square(getattr(total, of)) - part * np.square(getattr(within, of)), 0.0)).tolist()
        for of in ("own", "sizes")
    )
    return Scatter(own, total.drifts, sizes)


def _usual(
    fleet: Sequence[Sequence[OfDrive]],
    squares: Callable[[Sequence[OfDrive], int], tuple[Array, int]],
    supposed: Sequence[Array],
    surely: float,
) -> Usual:
    """The covariance that vehicles have on average, and how alike they are.

    `supposed` (modes, T, T) counts as `surely` many squares do. Of vehicles' variances s^2, of n squares each, the
    squared coefficient of variation is that of sampling, 2 / n, and 2 / (freedom - 4) of their distribution.
    """
    covariance, varied = [], list[float]()
    for mode, before in enumerate(supposed):
        every = [squares(drives, mode) for drives in fleet]
        total, count = np.sum([total for total, _ in every], axis=0), sum(n for _, n in every)
        mean = (surely * before + total) / (surely + count)
        covariance.append(mean.tolist())
        enough = [(total.diagonal() / n / mean.diagonal(), n) for total, n in every if n >= FEW]
        if mode != EDGE and len(enough) >= VEHICLES:
            ratios, counts = np.array([ratio for ratio, _ in enough]), np.array([n for _, n in enough])
            varied += (ratios.var(axis=0, ddof=1) / ratios.mean(axis=0) ** 2 - np.mean(2.0 / counts)).tolist()
    cv2 = max(float(np.median(varied)) if varied else 1.0, 1e-3)
    return Usual(covariance, float(np.clip(4.0 + 2.0 / cv2, *FREEDOM)))


def _median(every: Sequence[Sequence[Detector]]) -> list[Detector]:
    """The first vehicle's detectors with the thresholds of the median vehicle."""
    found: list[Detector] = []
    for of in zip(*every, strict=True):
        d = msgspec.structs.replace(of[0], J=float(np.median([each.J for each in of])))
        if isinstance(d, CusumDetector):
            d = msgspec.structs.replace(
                d, nu=float(np.median([each.nu for each in of if isinstance(each, CusumDetector)]))
            )
        found.append(d)
    return found


def _along(V: Array) -> tuple[Array, Array]:
    """A covariance (D, D) as directions (n, D), and what is left of each variance, as a standard deviation (D,)."""
    size, direction = np.linalg.eigh((V + V.T) / 2.0)
    drifts = direction.T * np.sqrt(np.maximum(size, 0.0))[:, None]
    kept = (drifts**2).max(axis=1) > LEFT
    return drifts[kept], np.sqrt((drifts[~kept] ** 2).sum(axis=0))

"""How far ticks, visits and drives without a fault stray: covariances from what was seen and what was supposed."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from faultline.analysis.tuning.statistics import OfDrive, noise_of, visits_of
from faultline.analysis.tuning.thresholds import Seen
from faultline.service.core.decision.straying import MINIMUM_TICKS
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.time_scale import Span, TimeScale

Array = npt.NDArray[np.float64]

VISIT, SUPPOSED = Span(settlings=0.5, periods=50), 5.0
"""Before any visit is seen, its effect is supposed to be as large as the noise of a mean over `VISIT`, as surely as
from so many visits: pulses of an actuator and the sampling beat, at a level that tuning has not seen."""
LARGER = 0.01
"""One vehicle in so many has larger effects of a visit than is supposed after a few of them."""
PER_DIRECTION = 3  # recordings, at least
DOUBTED = 0.1
"""One vehicle in so many, or one fleet, strays further from drive to drive than is said of it."""
STEPS = 100  # of expectation maximisation
LEAST_OWN = 0.01  # of the spread: what each mean strays by itself, so that there is something to divide by


class Supposed(NamedTuple):
    """A covariance (K, K) by mode that is supposed before anything is seen, as surely as from `freedom` of it."""

    of_mode: dict[int, Array]
    freedom: float


def noise(drives: Sequence[OfDrive], mode: int, rows: Sequence[int], supposed: Supposed) -> Array:
    """Return the covariance (K, K) of the noise, per tick: what makes a visit's successive blocks differ.

    What is slower is the visit's effect. Without a fleet, the spread of single ticks is supposed as surely as from K
    differences, so that the covariance is of full rank however few there are.
    """
    total, differences = noise_of(drives, mode)
    found = supposed.freedom * supposed.of_mode[mode] + total[np.ix_(rows, rows)]
    return np.asarray(found / (supposed.freedom + differences))


def supposed_visits(
    drives: Sequence[OfDrive], modes: set[int], rows: Sequence[int], noise: Array, time: TimeScale
) -> Supposed:
    """Return what is supposed of a visit's effect where no fleet says it.

    Nor is a mode supposed to be quieter than the quietest of the others: backlash of a sensor, which a few short visits
    may not show, is the same in all of them.
    """
    seen = {mode: visits_of(drives, mode) for mode in modes}
    usual = {mode: noise[mode] / time.ticks(VISIT) for mode in modes}
    mean = {
        mode: (SUPPOSED * usual[mode] + total[np.ix_(rows, rows)]) / (SUPPOSED + count)
        for mode, (total, count) in seen.items()
    }
    supposed = dict(usual)
    for mode in modes:
        if others := [mean[other] for other in modes if other not in (mode, EDGE)]:
            supposed[mode] = usual[mode] + positive(min(others, key=np.trace) - usual[mode])
    return Supposed(supposed, SUPPOSED)


def visit_effect(drives: Sequence[OfDrive], mode: int, rows: Sequence[int], supposed: Supposed) -> Array:
    """Return the covariance (K, K) of a visit's effect in a mode: how visits' means differ within a drive.

    It is a posterior mean of what was supposed and what was seen, times what makes it an upper bound: a few visits show
    variances badly, and what was not seen in them would be a fault. The noise of the means is in it, which is little.
    """
    total, count = visits_of(drives, mode)
    found = total[np.ix_(rows, rows)] + supposed.freedom * supposed.of_mode[mode]
    # where each drive is one visit, its effect is the drive's
    return np.asarray(found / chdtri(supposed.freedom + count, 1.0 - LARGER) if count else found / supposed.freedom)


def as_seen(means: Array, spread: Array, drifts: Array, K: int) -> tuple[Array, Array, Array]:
    """What each mean strays by itself (modes, K), the drifts (n, modes, T), as large as R drives show them, and sizes.

    `means` are the deviations of the drives (R, modes, T), `drifts` those that the model names, at the sizes that it
    gives. First their sizes are found, by expectation maximisation: x of a drive is normal with the sizes' variances,

        mean = sum_k x_k drift_k + own,

    then the directions in which what is left strays together. The edge, which is no evidence, is left as it is. Sizes
    and directions are those of the first K generators, and say how far the others move with them. They may be
    larger by `doubted`.
    """
    R, T, C = len(means), means.shape[2], means.shape[1] - 1
    all_y, all_W = (means / spread)[:, 1:], (drifts / spread)[:, 1:]
    y, W = all_y[..., :K].reshape(R, -1), all_W[..., :K].reshape(len(drifts), C * K)
    size, own = np.ones(len(W)), np.maximum(np.sqrt((y**2).mean(axis=0)), LEAST_OWN)
    x = np.zeros((R, len(W)))
    for _ in range(STEPS):
        gain = (size**2 * W.T).T @ np.linalg.inv((size**2 * W.T) @ W + np.diag(own**2))  # (drifts, means)
        x = y @ gain.T
        V = positive(np.diag(size**2) - gain @ (size**2 * W.T))
        size = np.sqrt((x**2).mean(axis=0) + V.diagonal())
        own = np.sqrt(((y - x @ W) ** 2).mean(axis=0) + np.einsum("kd,kl,ld->d", W, V, W))
        own = np.maximum(own, LEAST_OWN)
    rest = y - x @ W
    u = _directions(rest)
    left = ((rest - u @ (u.T @ rest)) ** 2).sum(axis=0) / (R - u.shape[1])
    alone = np.abs(means[..., :K]).max(axis=0) / spread[:, :K]
    alone[1:] = np.sqrt(np.maximum(left + own**2 - (rest**2).mean(axis=0), 0.0)).reshape(C, K)
    more = np.tensordot(u.T, all_y - np.tensordot(x, all_W, axes=1), axes=1) / np.sqrt(R)  # (n, modes, T)
    found = np.zeros((len(W) + len(more), len(means[0]), T))
    found[:, 1:] = np.concatenate([size[:, None, None] * all_W, more])
    found[: len(W), EDGE] = size[:, None] * (drifts / spread)[:, EDGE]
    return alone * spread[:, :K], found * spread, size


def doubted(freedom: float) -> float:
    """Return how many times a standard deviation that so many degrees of freedom show may be as large."""
    return float(np.sqrt(freedom / chdtri(freedom, 1.0 - DOUBTED)))


def _directions(y: Array) -> Array:
    """How much each drive has of n directions in which deviations (R, means) stray together: unit vectors (R, n).

    Those are the directions whose eigenvalue of the correlation matrix is larger than R drives would show one if what
    the larger ones leave did not stray together: than the edge of Marchenko and Pastur's distribution, after the
    parallel analysis of Horn (Psychometrika 1965).
    """
    R, D = y.shape
    drives, size, _ = np.linalg.svd(y / np.sqrt((y**2).mean(axis=0) + 1e-300), full_matrices=False)
    eigenvalues = size**2 / R
    together = 0
    while together < R // PER_DIRECTION and together < D:
        left = D - together
        if eigenvalues[together] <= eigenvalues[together:].sum() / left * (1.0 + np.sqrt(left / R)) ** 2:
            break
        together += 1
    return np.asarray(drives[:, :together])


def supposed_drifts(strays: Array, spread: Array) -> Array:
    """Return how far (T, modes, T) the means of each test stray together, where no model says what makes them stray.

    `strays` (R, modes, T) are those of R drives, `spread` (modes, T) is that of their ticks. Before any drive is seen,
    a test's means are supposed to stray from drive to drive as far as its residual does within one, as surely as from
    so many drives as `SUPPOSED` says; a few show a variance badly, so that it is an upper bound.
    """
    R, T = len(strays), spread.shape[1]
    seen = (strays.mean(axis=1) ** 2).sum(axis=0)  # (T,)
    size = np.sqrt((SUPPOSED * np.median(spread, axis=0) ** 2 + seen) / chdtri(SUPPOSED + R - 1, 1.0 - LARGER))
    return np.asarray(np.eye(T)[:, None] * np.ones((len(spread), 1)) * size)


def positive(V: Array) -> Array:
    """The part of a symmetric matrix that has no negative eigenvalue."""
    size, direction = np.linalg.eigh(V)
    return np.asarray((direction * np.maximum(size, 0.0)) @ direction.T)


def strays(recordings: Sequence[Seen], rows: list[int], offset: Array) -> Array:
    """How far the mean of every recording lies from the offset (R, modes, rows).

    One that hardly shows a mode says nothing of it: the others' deviations are that much larger, so that the mean
    square over all R is the one over those that do.
    """
    modes = range(len(recordings[0].modes))
    means = np.array([[_mean(s, mode, rows) for mode in modes] for s in recordings]) - offset
    shown = np.isfinite(means)
    return np.asarray(np.where(shown, means, 0.0) * np.sqrt(len(means) / np.maximum(shown.sum(axis=0), 1)))


def _mean(s: Seen, mode: int, rows: list[int]) -> Array:
    inside = s.usable.all(axis=1) & (s.mode == mode)
    return s.r[inside][:, rows].mean(axis=0) if inside.sum() >= MINIMUM_TICKS else np.full(len(rows), np.nan)

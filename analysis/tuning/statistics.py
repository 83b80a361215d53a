"""The sufficient statistics of a fault-free drive: where its means lie, and how far ticks and visits stray in it.

Those of many drives are added, so that a fleet is tuned without holding its logs (`analysis.tuning.prior`).
"""

from collections.abc import Iterator, Sequence

import msgspec
import numpy as np
import numpy.typing as npt

from faultline.analysis.tuning.thresholds import Seen
from faultline.service.core.decision.blocks import BLOCK
from faultline.service.core.decision.straying import MINIMUM_TICKS

Array = npt.NDArray[np.float64]


class OfMode(msgspec.Struct, frozen=True):
    """What a drive shows of T generators in a mode, at the ticks at which all of them could tell.

    `mean` (T,) and `spread` (T,), the robust one around the median [unit of r], are of `ticks`; zeros where these are
    fewer than `MINIMUM_TICKS`. `noise` (T, T) is half the sum of squares of `differences` between successive blocks of
    a visit, times the ticks of a block: over their number it is the covariance of a tick. `between` (T, T) is the sum
    of the squares of visits' means around the drive's, of `freedom` degrees of freedom.
    """

    ticks: int
    mean: list[float]
    spread: list[float]
    differences: int
    noise: list[list[float]]
    freedom: int
    between: list[list[float]]


class OfDrive(msgspec.Struct, frozen=True):
    """What a drive shows, by mode; `hours` that some test could tell."""

    name: str
    hours: float
    modes: list[OfMode]


def of_drive(s: Seen) -> OfDrive:
    """Return the statistics of a drive."""
    hours = float(s.usable.any(axis=1).sum()) * s.time.period_s / 3600.0
    return OfDrive(s.name, hours, [of_mode(s, mode) for mode in range(len(s.modes))])


def of_mode(s: Seen, mode: int) -> OfMode:
    """Return the statistics of a drive's mode."""
    block, T = s.time.ticks(BLOCK), s.r.shape[1]
    noise, between = np.zeros((2, T, T))
    differences, means = 0, list[Array]()
    for r in visits([s], mode):
        blocks = len(r) // block
        if blocks > 1:
            steps = np.diff(r[: blocks * block].reshape(blocks, block, T).mean(axis=1), axis=0)
            noise += block * steps.T @ steps / 2.0
            differences += len(steps)
        if len(r) >= MINIMUM_TICKS:
            means.append(r.mean(axis=0))
    if len(means) > 1:
        away = np.array(means) - np.mean(means, axis=0)
        between += away.T @ away
    inside = s.r[s.usable.all(axis=1) & (s.mode == mode)]
    mean, spread = np.zeros((2, T))
    if len(inside) >= MINIMUM_TICKS:
        mean = inside.mean(axis=0)
        spread = 1.4826 * np.median(np.abs(inside - np.median(inside, axis=0)), axis=0)
    return OfMode(
        ticks=len(inside),
        mean=mean.tolist(),
        spread=spread.tolist(),
        differences=differences,
        noise=noise.tolist(),
        freedom=max(len(means) - 1, 0),
        between=between.tolist(),
    )


def visits(recordings: Sequence[Seen], mode: int) -> Iterator[Array]:
    """Yield the residuals (n, T) of every stay in a mode."""
    return (s.r[visit] for s in recordings for visit in s.visits(mode))


def noise_of(drives: Sequence[OfDrive], mode: int) -> tuple[Array, int]:
    """Return the sum (T, T) of the squares of a mode's differences in these drives, and their number."""
    of = [drive.modes[mode] for drive in drives]
    return np.sum([each.noise for each in of], axis=0), sum(each.differences for each in of)


def visits_of(drives: Sequence[OfDrive], mode: int) -> tuple[Array, int]:
    """Return the sum (T, T) of the squares of visits' means in these drives, and their degrees of freedom."""
    of = [drive.modes[mode] for drive in drives]
    return np.sum([each.between for each in of], axis=0), sum(each.freedom for each in of)

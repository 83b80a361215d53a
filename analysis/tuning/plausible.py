"""Whether a drive that is said to be fault-free may be: how far its residuals lie, in standard deviations.

They are looked at by what other drives show of ticks, visits and baselines (`core.decision.straying`), never by its
own: a drive with a fault in it would make itself plausible. Few visits show their variance badly: deviations are
Student's t, and are given as what is as improbable of a normal variable.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri, stdtr

from faultline.analysis.tuning.claim import Fold
from faultline.analysis.tuning.straying import SUPPOSED
from faultline.analysis.tuning.thresholds import MINIMUM_TICKS, Seen
from faultline.service.core.manifest import Evidence
from faultline.service.core.signals.modes import EDGE

Array = npt.NDArray[np.float64]

PLAUSIBLE = 4.0
"""Standard deviations up to which a residual's level is one without a fault."""


def steady(stand_ins: Sequence[int]) -> list[int]:
    """The modes that are described by data, but for the edge: no decision looks at the level there."""
    return [mode for mode in dict.fromkeys(stand_ins) if mode != EDGE]


def of_baselines(evidence: Evidence, mode: int) -> Array:
    """The variance (K,) of a drive's means in a mode from one drive to the next."""
    allowance = np.array(evidence.allowance)[mode]
    return np.asarray(sum((np.array(drift)[mode] ** 2 for drift in evidence.drifts), allowance**2))


def of_means(evidence: Evidence, mode: int, seen: Sequence[Seen]) -> Array:
    """The variance (K,) of the means in a mode of these recordings, from their ticks and visits."""
    ticks, visits = _ticks_and_visits(mode, seen)
    noise, visit = (np.diag(np.array(matrices)[mode]) for matrices in (evidence.noise, evidence.visit))
    return np.asarray(noise / max(ticks, 1) + visit / max(visits, 1))


def _ticks_and_visits(mode: int, seen: Sequence[Seen]) -> tuple[int, int]:
    """Return how many ticks and visits of a mode recordings have."""
    ticks = visits = 0
    for s in seen:
        inside = s.usable.all(axis=1) & (s.mode == mode)
        ticks += int(inside.sum())
        visits += int((np.diff(s.ticks[inside], prepend=-2) > 1).sum())
    return ticks, visits


def doubts(fold: Fold, evidence: Evidence, generators: Sequence[str], stand_ins: Sequence[int]) -> Iterator[str]:
    """What is implausible of the drives that a fold leaves out, by the `evidence` of the others, a sentence each."""
    rows = [generators.index(name) for name in evidence.generators]
    for drive, offset in fold.test:
        others = [other.seen for other in fold.vehicle.drives if other is not drive]
        apart, halved = np.zeros((2, len(stand_ins), len(rows)))
        for mode in steady(stand_ins):
            freedom = SUPPOSED + _ticks_and_visits(mode, others)[1]
            whole, (first, second) = _median(drive.seen, mode, rows), _halves(drive.seen)
            if others:
                variance = of_means(evidence, mode, [drive.seen]) + of_means(evidence, mode, others)
                variance += (1.0 + 1.0 / len(others)) * of_baselines(evidence, mode)
                apart[mode] = _as_normal(np.abs(whole - offset[rows, mode]) / np.sqrt(variance), freedom)
            variance = of_means(evidence, mode, [first]) + of_means(evidence, mode, [second])
            difference = np.abs(_median(first, mode, rows) - _median(second, mode, rows))
            halved[mode] = _as_normal(difference / np.sqrt(variance), freedom)
        for far, what in ((apart, "from the other drives"), (halved, "apart in the drive's two halves")):
            worst, k = (int(index) for index in np.unravel_index(np.nan_to_num(far).argmax(), far.shape))
            if far[worst, k] > PLAUSIBLE:
                yield (
                    f"{drive.seen.name}: {evidence.generators[k]} lies {far[worst, k]:.1f} standard deviations {what} "
                    f"in mode {drive.seen.modes[worst]!r} ({PLAUSIBLE:.0f} are plausible): is there a fault in it? "
                    "Leave it out, or know why"
                )


def _as_normal(t: Array, freedom: float) -> Array:
    """The standard deviations of a normal variable that are as improbable as these t (K,) of Student's distribution."""
    return np.asarray(-ndtri(np.maximum(stdtr(freedom, -t), 1e-300)))


def _median(s: Seen, mode: int, rows: list[int]) -> Array:
    """Of the residuals (K,); NaN in a mode that was hardly seen."""
    inside = s.usable.all(axis=1) & (s.mode == mode)
    return np.median(s.r[inside][:, rows], axis=0) if inside.sum() >= MINIMUM_TICKS else np.full(len(rows), np.nan)


def _halves(s: Seen) -> tuple[Seen, Seen]:
    """The recording up to its middle, and from there on."""
    halves = [slice(0, len(s.mode) // 2), slice(len(s.mode) // 2, None)]
    first, second = (
        replace(s, z=s.z[half], r=s.r[half], usable=s.usable[half], mode=s.mode[half], number=s.ticks[half])
        for half in halves
    )
    return first, second

"""Steps of a pressure, by which two recordings can be aligned as by eye (thesis 5.8): start of the pump, ladder, dose.

Correlation weighs a cycle that comes back against the same cycle a period later; the one step that does not come back
decides.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from faultline.analysis.model.bench import BenchSetup
from faultline.analysis.recordings.band import gridded
from faultline.analysis.recordings.track import Track
from faultline.service.core.signals.values import FloatArray

GRID_S = 0.1
SMOOTH_S = 0.3
TOGETHER_S = 0.7  # two steps this near, of like size, are one seen twice
SEEN_S = 8.0  # from a silence: the pump builds its pressure in about twice this
LIKE = 0.6  # ratio of their sizes, at least


class Step(NamedTuple):
    """A change [Pa] of pressure, at the time [s] when half of it was done."""

    t: float
    change: float


def steps(track: Track, setup: BenchSetup) -> list[Step]:
    """All steps of a pressure, in order."""
    grid = gridded(track, GRID_S)
    smooth = gaussian_filter1d(grid.value, SMOOTH_S / GRID_S, mode="nearest")
    slope = np.gradient(smooth, GRID_S)
    direction = np.sign(slope) * (np.abs(slope) > setup.step_pa_per_s) * grid.known
    edges = np.flatnonzero(np.diff(direction, prepend=0.0, append=0.0))
    found = []
    for first, last in pairwise(edges.tolist()):
        part = smooth[first : last + 1]
        change = float(part[-1] - part[0])
        if direction[first] and abs(change) >= setup.step_pa:
            half = int(np.argmin(np.abs(part - part[0] - change / 2)))
            found.append(Step(float(grid.t[first + half]), change))
    return found


def shared(follower: Track, reference: Track, lag: float, setup: BenchSetup) -> float:
    """Which part [0..1] of all steps, by size, both logs have at this lag [s, CAN time less logger time]."""
    moved = follower._replace(t=follower.t + lag)
    first = [step for step in steps(moved, setup) if _seen(reference, step)]
    second = [step for step in steps(reference, setup) if _seen(moved, step)]
    total = sum(abs(step.change) for step in [*first, *second])
    if not total:
        return 0.0
    return (_found(first, second) + _found(second, first)) / total


def _seen(track: Track, step: Step) -> bool:
    """Whether the other log runs, and is not silent, for long enough to have the step too."""
    return bool(track.known(np.array([step.t]), SEEN_S)[0])


def _found(mine: list[Step], others: list[Step]) -> float:
    """The sizes [Pa] of my steps that the others have too, summed."""
    t: FloatArray = np.array([step.t for step in others])
    total = 0.0
    for step in mine:
        near = [others[k].change for k in np.flatnonzero(np.abs(t - step.t) <= TOGETHER_S)]
        if any(LIKE <= change / step.change <= 1 / LIKE for change in near):
            total += abs(step.change)
    return total

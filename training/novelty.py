"""Where a test was never trained: the distance of its states and inputs from what it has seen.

The signal that a test predicts takes no part unless its functions take it: a fault of that sensor must not hide itself
by being novel. Centres lie as far from each other as they can; each reaches as far as the ticks that are nearest to it.
"""

import numpy as np
import numpy.typing as npt
import torch

from faultline.analysis.graph.cells import Novelty
from faultline.analysis.recordings.modes import time_of
from faultline.service.core.time_scale import Span, TimeScale
from faultline.training.free_run import Course
from faultline.training.layout import Layout
from faultline.training.windows import Windows

Array = npt.NDArray[np.float64]
Columns = npt.NDArray[np.intp]

CENTRES = 64
QUANTILE = 0.995
"""Of ticks that a fold's centres have not seen: what is further away is called new."""

PARTS, PART = 4, Span(settlings=2.5)
"""Parts in turn, and log time of one: longer than a state remembers, but not in short recordings."""

MARGIN = 1.3
LEAST_REACH = 0.5
"""Of the median reach: a centre of a single tick would make its neighbours novel."""


def novelty_of(layout: Layout, windows: Windows, course: Course) -> Novelty:
    """The measure of every test, such that 1 is the limit."""
    columns = novelty_columns(layout)
    values = operating_points(windows, course)
    part = _parts(windows.clock[course.at].numpy(), time_of(layout.model))
    centres, reaches = [], []
    for own in columns:
        points = values[:, own]
        limit = max(_limit(points, part), 1e-6)
        found, reach = _centres(points)
        centres.append(found)
        reaches.append(reach * limit * MARGIN)
    return Novelty(columns, np.array(centres), np.array(reaches))


def _parts(clock: Array, time: TimeScale) -> Columns:
    """The part (K,) of every tick, by its log time (K,) [s]."""
    moments, at = np.unique((clock / time.period_s).astype(np.int64), return_inverse=True)  # one for all starts
    length = min(time.ticks(PART), max(len(moments) // PARTS, 1))
    return np.asarray(at // length % PARTS, dtype=np.intp)


def operating_points(windows: Windows, course: Course) -> Array:
    """[states; signals; 0] (K, C) of a course, scaled: the ensemble's mean states."""
    parts = [course.x.mean(dim=0), windows.z[course.at].T, torch.zeros(1, len(course.at))]
    return np.asarray(torch.cat(parts).T.numpy(), dtype=np.float64)


def novelty_columns(layout: Layout) -> Columns:
    """For each test: its states and the signals that its functions take, of [states (F); signals (nz); 0]."""
    size, rows = len(layout.states), []
    padding = size + len(layout.signals)
    for t in range(len(layout.tests)):
        own = np.flatnonzero(layout.owner == t)
        rows.append([*own, *(layout.driven(t) + size)])
    width = max(len(row) for row in rows)
    return np.array([[*row, *[padding] * (width - len(row))] for row in rows], dtype=np.intp)


def novelty(of: Novelty, values: Array) -> Array:
    """The novelty (K, T) of operating points (K, C), as the graph has it."""
    away = values[:, of.columns][:, :, None] - of.centres
    return np.asarray(np.sqrt(((away**2).sum(axis=3) / of.reach**2).min(axis=2)))


def _limit(points: Array, part: Columns) -> float:
    """The novelty that ticks of one part have for centres of the others."""
    found = []
    for k in np.unique(part):
        centres, reach = _centres(points[part != k])
        found.append(_nearest(points[part == k], centres, reach))
    return float(np.quantile(np.concatenate(found), QUANTILE))


def _nearest(points: Array, centres: Array, reach: Array) -> Array:
    away = np.linalg.norm(points[:, None] - centres, axis=2)
    return np.asarray((away / reach).min(axis=1))


def _centres(points: Array) -> tuple[Array, Array]:
    """Centres (N, D), farthest first, and how far each reaches (N,)."""
    chosen = [int(np.argmin(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    away = np.linalg.norm(points - points[chosen[0]], axis=1)
    owner = np.zeros(len(points), dtype=np.intp)
    for k in range(1, CENTRES):
        chosen.append(int(away.argmax()))
        now = np.linalg.norm(points - points[chosen[-1]], axis=1)
        owner[now < away] = k
        away = np.minimum(away, now)
    reach = np.zeros(CENTRES)
    np.maximum.at(reach, owner, away)
    return points[chosen], np.maximum(reach, max(LEAST_REACH * float(np.median(reach)), 1e-6))

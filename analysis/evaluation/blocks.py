"""Recordings cut into blocks of three settling times: the unit in which alarms are counted and generators scored.

Residuals of two ticks in a row are nearly the same thing, so a share of ticks has no interval; a block is long enough
that its neighbour is another piece of driving, and a test can be right or wrong in each. Fault-free blocks lie before
the onset, faulty ones from it on. A generator tells in a block if it could in half of its ticks; it alarms there if its
detector does at any tick.

Score of a generator in a block: the absolute mean of its standardised residual (a low pass as long as the block) over
the ticks in which it can tell, by operating mode and over all modes but the edge. It knows no threshold.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from faultline.analysis.evaluation.story import Story
from faultline.service.core.manifest import Manifest
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.signals.values import Mask

BLOCK = 3.0
"""Settling times."""
LEAST_TICKS = 10
"""Of a mode, from which a mean of a block counts."""

ALL = "all"
"""What a block is scored over besides each mode: all of them but the edge."""

Array = npt.NDArray[np.float64]


class Blocks(NamedTuple):
    """N blocks: whether each lies after the onset (N,), tells and alarms (N, T), scores (N, modes, T).

    A score is NaN where the generator could tell in too few ticks of the mode.
    """

    faulty: Mask
    tells: Mask
    alarms: Mask
    scores: Array


def scored(manifest: Manifest) -> tuple[str, ...]:
    """What blocks are scored over, in the order of the scores."""
    return ALL, *manifest.modes.names[EDGE + 1 :]


def blocks(story: Story, onset: int) -> Blocks:
    """The blocks of a recording whose fault begins at tick `onset` (the number of ticks: never)."""
    spans = [(span, False) for span in cut(0, onset, story)] + [
        (span, True) for span in cut(onset, len(story.t_s), story)
    ]
    N, T = len(spans), story.r.shape[1]
    s, alarm = story.standardised, story.alarm
    found = Blocks(
        faulty=np.array([faulty for _, faulty in spans], dtype=np.bool_),
        tells=np.zeros((N, T), dtype=np.bool_),
        alarms=np.zeros((N, T), dtype=np.bool_),
        scores=np.zeros((N, len(scored(story.bundle.manifest)), T)),
    )
    for number, (span, _) in enumerate(spans):
        found.tells[number] = story.usable[span].mean(axis=0) >= 0.5
        found.alarms[number] = alarm[span].any(axis=0)
        found.scores[number] = _scores(s[span], story.usable[span], story.mode[span], found.scores.shape[1])
    return found


def cut(start: int, stop: int, story: Story) -> list[slice]:
    """Equal blocks of about `BLOCK` from tick `start` to `stop`; none in less than half of that."""
    count = round((stop - start) * story.bundle.manifest.period_s / (BLOCK * story.bundle.manifest.settling_s))
    edges = np.linspace(start, stop, count + 1).round().astype(int)
    return [slice(int(a), int(b)) for a, b in pairwise(edges)] if count else []


def joined(parts: list[Blocks]) -> Blocks:
    """The blocks of several recordings."""
    return Blocks(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _scores(s: Array, usable: Mask, mode: npt.NDArray[np.intp], count: int) -> Array:
    """Of one block: (count, T)."""
    chosen = [mode != EDGE, *(mode == number for number in range(EDGE + 1, EDGE + count))]
    found = np.full((count, s.shape[1]), np.nan)
    for row, ticks in enumerate(chosen):
        told = usable & ticks[:, None]
        ticks_told = told.sum(axis=0)
        means = np.where(told, s, 0.0).sum(axis=0) / np.maximum(ticks_told, 1)
        found[row] = np.where(ticks_told >= LEAST_TICKS, abs(means), np.nan)
    return found

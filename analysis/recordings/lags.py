"""Lags at which two pressures resemble each other: normalised cross-correlation of what both loggers know.

Both signals are high-passed and put on one grid; silence counts for nothing (masked normalised correlation, Padfield
2012). A lag is scored by its log likelihood ratio against no relation, -n/2 log(1 - r^2), so that a long overlap that
fits beats a short one that happens to.
"""

from typing import NamedTuple

import numpy as np
from scipy.signal import correlate

from faultline.analysis.recordings.band import Grid, gridded
from faultline.analysis.recordings.track import Mask, Track
from faultline.service.core.signals.values import FloatArray

STEP_S = 0.1  # of the lags
SLOW_S = 2.0  # slower changes do not help to find a time
EDGE_S = 4.0  # so far from a silence the high-passed signals are not alike
MINIMUM_OVERLAP_S = 30.0
CANDIDATES = 6
APART_S = 2.0  # nearer than this two peaks are one
WORTH = 0.5  # of the best score, what a candidate has at least


class Likeness(NamedTuple):
    """Correlation and score (L,) over the lags (L,) [s], CAN time less logger time; NaN where too little overlaps."""

    lag: FloatArray
    correlation: FloatArray
    score: FloatArray

    def candidates(self) -> list[float]:
        """The lags [s] of the highest separate peaks, best first; none where nothing is alike."""
        score = np.where(self.correlation > 0, self.score, -np.inf)
        found: list[float] = []
        least = WORTH * score.max(initial=0.0)
        while len(found) < CANDIDATES and score.max(initial=-np.inf) > max(least, 0.0):
            best = float(self.lag[np.argmax(score)])
            found.append(best)
            score[np.abs(self.lag - best) < APART_S] = -np.inf
        return found


def likeness(follower: Track, reference: Track) -> Likeness:
    """Over all lags of the follower (logger time) behind the reference (CAN time).

    They leave `MINIMUM_OVERLAP_S` known to both.
    """
    x, y = _fast(reference), _fast(follower)
    overlap = _across(x.known, y.known)
    power = _across(x.value**2, y.known) * _across(x.known, y.value**2)
    enough = (overlap >= MINIMUM_OVERLAP_S / STEP_S) & (power > power.max(initial=0.0) * 1e-9)
    r = np.full(len(power), np.nan)
    r[enough] = np.clip(_across(x.value, y.value)[enough] / np.sqrt(power[enough]), -0.999999, 0.999999)
    lag = x.t[0] - y.t[0] + (np.arange(len(r)) - (len(y.t) - 1)) * STEP_S
    return Likeness(lag, r, -0.5 * overlap * np.log1p(-(r**2)))


def correlation(x: Track, y: Track) -> float:
    """Of two high-passed signals on one clock, where both are known; 0 where they have nothing in common."""
    a, b = _fast(x), _fast(y)
    other = np.interp(a.t, b.t, b.value)
    both = a.known & y.known(a.t, EDGE_S)
    power = float(np.sum(a.value[both] ** 2) * np.sum(other[both] ** 2))
    return float(np.sum(a.value[both] * other[both])) / power**0.5 if power > 0 else 0.0


def _fast(track: Track) -> Grid:
    """On the grid, high-passed, 0 where it is not known or near a silence."""
    fast = gridded(track, STEP_S).fast(SLOW_S)
    clear = track.known(fast.t, EDGE_S)
    return fast._replace(known=clear, value=np.where(clear, fast.value, 0.0))


def _across(x: FloatArray | Mask, y: FloatArray | Mask) -> FloatArray:
    return np.asarray(correlate(x.astype(np.float64), y.astype(np.float64), method="fft"), dtype=np.float64)

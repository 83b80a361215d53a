"""The offset of two clocks in windows of a recording: where p_ap explains most of p_du.

In a window of 40 s, at CAN times t:  p_du(t) = gain p_ap(t - offset) + extra dose(t - 0.15 s) + c + d t,  without what
is slower than a second: there a sensor that sticks looks like one that is late. `extra` is by how much more than a
healthy filter's the drop from p_ap to p_du depends on the dose: a clogged one's comes at once, where p_ap takes its
time, which looked like a clock 40 ms off. It is read off the raw pressures, where steady ones outweigh steps; as a free
unknown it would eat up the steps that tell the time. An offset's log likelihood is -n/2 log of the mean square that
stays unexplained; taken against p_ap explaining nothing it is 0 there.
"""

from typing import NamedTuple

import numpy as np

from faultline.analysis.recordings.band import Grid, gridded
from faultline.analysis.recordings.track import Mask, Track
from faultline.service.core.signals.values import FloatArray

STEP_S = 0.02  # of the offsets
SMOOTH_S = 0.15  # of p_ap, one or two samples of the second logger
SLOW_S = 1.0
EDGE_S = 4.0  # so far from a silence the high-passed signals are not alike
WINDOW_S = 40.0
LEAST = 50  # samples of p_du in a window: less than 10 s tells nothing
VALVE_S = 0.15  # a new dose waits for the valve's next pulse, half a period on average
HEALTHY = 0.1e5  # Pa from no dose to full dose, twice a clean filter's drop
GAINS = (0.8, 1.2)  # both sensors are calibrated, and a filter between them takes a little


class Window(NamedTuple):
    """A window: its middle `t` [s, CAN time], and the log likelihood (S,) of each offset that was tried."""

    t: float
    likelihood: FloatArray


class Pressures(NamedTuple):
    """Both pressures, ready: p_ap on a fine grid of the logger's clock, and p_du at its own samples (CAN time).

    Both are clear where they are known, and high-passing them has not met a silence.
    """

    p_ap: Grid
    clear_p_ap: Mask
    t: FloatArray
    p_du: FloatArray
    raw_p_du: FloatArray
    dose: FloatArray
    late_dose: FloatArray
    clear_p_du: Mask

    def windows(self, offsets: FloatArray, lag_s: float = 0.0) -> list[Window]:
        """The windows over all that both know, for offsets (S,) [s] and a sensor of p_du that is this slow [s]."""
        felt = self.p_ap.slowed(lag_s).fast(SLOW_S)
        usable = self.clear_p_du & self._meets(self.t - offsets[0]) & self._meets(self.t - offsets[-1])
        if usable.sum() < LEAST:
            return []
        start, end = float(self.t[usable][0]), float(self.t[usable][-1])
        which = np.floor((self.t - start) / ((end - start) / max(1, round((end - start) / WINDOW_S)) + 1e-6))
        found = []
        for number in np.unique(which[usable]).tolist():
            inside = usable & (which == number)
            if inside.sum() >= LEAST:
                t = self.t[inside]
                x = np.array([np.interp(t - offset, felt.t, felt.value) for offset in offsets])  # (S, n)
                around, y = t - t.mean(), self.p_du[inside]
                place = t - offsets[int(np.argmax(_likelihood(y, x, around)))]
                drop = self.raw_p_du[inside] - np.interp(place, self.p_ap.t, self.p_ap.value)
                slope = _slope(drop, self.dose[inside])
                y = y - np.sign(slope) * max(abs(slope) - HEALTHY, 0.0) * self.late_dose[inside]
                found.append(Window(float(t.mean()), _likelihood(y, x, around)))
        return found

    def _meets(self, t: FloatArray) -> Mask:
        """Which logger times fall where p_ap is clear."""
        place = np.searchsorted(self.p_ap.t, t)
        inside = (place > 0) & (place < len(self.p_ap.t))
        return np.asarray(inside & self.clear_p_ap[np.minimum(place, len(self.p_ap.t) - 1)])


def pressures(p_ap: Track, p_du: Track, dose: Track, smooth_s: float = SMOOTH_S) -> Pressures:
    """Of the second logger's p_ap, under a bell of deviation `smooth_s` [s], and p_du on the CAN clock."""
    grid = gridded(p_ap, STEP_S, smooth_s)
    return Pressures(
        p_ap=grid,
        clear_p_ap=p_ap.known(grid.t, EDGE_S),
        t=p_du.t,
        p_du=_fast(p_du, p_du.t),
        raw_p_du=p_du.value,
        dose=dose.at(p_du.t),
        late_dose=_fast(dose, p_du.t - VALVE_S),
        clear_p_du=p_du.known(p_du.t, EDGE_S),
    )


def _fast(track: Track, t: FloatArray) -> FloatArray:
    """High-passed, at times `t` (N,) [s]; the samples themselves are not smoothed."""
    grid = gridded(track, STEP_S)
    return np.asarray(track.at(t) - np.interp(t, grid.t, grid.slow(SLOW_S)))


def _slope(y: FloatArray, x: FloatArray) -> float:
    """Of y (n,) over x (n,); 0 where x does not change."""
    x = x - x.mean()
    return float(np.sum(x * y) / max(np.sum(x**2), 1e-6))


def _likelihood(y: FloatArray, x: FloatArray, t: FloatArray) -> FloatArray:
    """(S,) of the model above: samples `y` (n,), candidates `x` (S, n) for p_ap, times `t` (n,) of mean 0."""
    q = np.column_stack([np.full(len(t), len(t) ** -0.5), t / np.linalg.norm(t)])
    x, y = x - (x @ q) @ q.T, y - q @ (q.T @ y)
    gain = np.clip(x @ y / np.maximum((x**2).sum(axis=1), 1.0), *GAINS)[:, None]
    rest, alone = np.mean((y - gain * x) ** 2, axis=1), np.mean(y**2)
    return np.asarray(0.5 * len(y) * np.log((alone + 1.0) / (rest + 1.0)))  # 1 Pa^2: neither is ever nothing

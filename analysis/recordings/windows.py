"""The offset of two clocks in windows of a recording: where the follower explains most of the reference.

In a window of 40 s, at CAN times t:  reference(t) = gain follower(t - offset) + extra command(t - delay) + c + d t,
without what is slower than a second: there a sensor that sticks looks like one that is late. `extra` is by how much
more than in a healthy system the drop between the two depends on the command: a clogged filter's comes at once, where
the follower takes its time, which looked like a clock 40 ms off. It is read off the raw pressures, where steady ones
outweigh steps; as a free unknown it would eat up the steps that tell the time. An offset's log likelihood is -n/2 log
of the mean square that stays unexplained; taken against the follower explaining nothing it is 0 there.
"""

from typing import NamedTuple

import numpy as np

from faultline.analysis.model.bench import BenchSetup
from faultline.analysis.recordings.band import Grid, gridded
from faultline.analysis.recordings.track import Mask, Track
from faultline.service.core.signals.values import FloatArray

STEP_S = 0.02  # of the offsets
SMOOTH_S = 0.15  # of the follower, one or two samples of the second logger
SLOW_S = 1.0
EDGE_S = 4.0  # so far from a silence the high-passed signals are not alike
WINDOW_S = 40.0
LEAST = 50  # samples of the reference in a window: less than 10 s tells nothing
GAINS = (0.8, 1.2)  # both sensors are calibrated, and a filter between them takes a little


class Window(NamedTuple):
    """A window: its middle `t` [s, CAN time], and the log likelihood (S,) of each offset that was tried."""

    t: float
    likelihood: FloatArray


class Pressures(NamedTuple):
    """Both pressures, ready: follower on a fine grid of the logger's clock, reference at its own samples (CAN time).

    Both are clear where they are known, and high-passing them has not met a silence. `healthy` is the change of the
    drop between them [Pa], from no command to full command, that is no fault's.
    """

    follower: Grid
    clear_follower: Mask
    t: FloatArray
    reference: FloatArray
    raw_reference: FloatArray
    command: FloatArray
    late_command: FloatArray
    clear_reference: Mask
    healthy: float

    def windows(self, offsets: FloatArray, lag_s: float = 0.0) -> list[Window]:
        """The windows over all that both know, for offsets (S,) [s] and a reference that is this slow [s]."""
        felt = self.follower.slowed(lag_s).fast(SLOW_S)
        usable = self.clear_reference & self._meets(self.t - offsets[0]) & self._meets(self.t - offsets[-1])
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
                around, y = t - t.mean(), self.reference[inside]
                place = t - offsets[int(np.argmax(_likelihood(y, x, around)))]
                drop = self.raw_reference[inside] - np.interp(place, self.follower.t, self.follower.value)
                slope = _slope(drop, self.command[inside])
                y = y - np.sign(slope) * max(abs(slope) - self.healthy, 0.0) * self.late_command[inside]
                found.append(Window(float(t.mean()), _likelihood(y, x, around)))
        return found

    def _meets(self, t: FloatArray) -> Mask:
        """Which logger times fall where the follower is clear."""
        place = np.searchsorted(self.follower.t, t)
        inside = (place > 0) & (place < len(self.follower.t))
        return np.asarray(inside & self.clear_follower[np.minimum(place, len(self.follower.t) - 1)])


def pressures(
    follower: Track, reference: Track, command: Track, setup: BenchSetup, smooth_s: float = SMOOTH_S
) -> Pressures:
    """Of the second logger's follower, under a bell of deviation `smooth_s` [s], and the reference on the CAN clock."""
    grid = gridded(follower, STEP_S, smooth_s)
    return Pressures(
        follower=grid,
        clear_follower=follower.known(grid.t, EDGE_S),
        t=reference.t,
        reference=_fast(reference, reference.t),
        raw_reference=reference.value,
        command=command.at(reference.t),
        late_command=_fast(command, reference.t - setup.command_delay_s),
        clear_reference=reference.known(reference.t, EDGE_S),
        healthy=setup.command_drop_pa,
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
    """(S,) of the model above: samples `y` (n,), candidates `x` (S, n) for the follower, times `t` (n,) of mean 0."""
    q = np.column_stack([np.full(len(t), len(t) ** -0.5), t / np.linalg.norm(t)])
    x, y = x - (x @ q) @ q.T, y - q @ (q.T @ y)
    gain = np.clip(x @ y / np.maximum((x**2).sum(axis=1), 1.0), *GAINS)[:, None]
    rest, alone = np.mean((y - gain * x) ** 2, axis=1), np.mean(y**2)
    return np.asarray(0.5 * len(y) * np.log((alone + 1.0) / (rest + 1.0)))  # 1 Pa^2: neither is ever nothing

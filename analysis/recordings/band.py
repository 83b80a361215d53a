"""The part of a pressure that tells a time: smooth enough for its sampling, without what changes slowly."""

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter

from faultline.analysis.recordings.track import Mask, Track
from faultline.service.core.signals.values import FloatArray


class Grid(NamedTuple):
    """A signal (N,) at uniform times `t` (N,) [s], and where it is known."""

    t: FloatArray
    value: FloatArray
    known: Mask

    @property
    def step_s(self) -> float:
        """Between two points [s]."""
        return float(self.t[1] - self.t[0]) if len(self.t) > 1 else 1.0

    def fast(self, slow_s: float) -> "Grid":
        """Without changes slower than `slow_s` [s], zero-phase; 0 where it is not known."""
        return self._replace(value=np.where(self.known, self.value - self.slow(slow_s), 0.0))

    def slow(self, slow_s: float) -> FloatArray:
        """The mean under a bell of standard deviation `slow_s` [s] over what is known."""
        width = slow_s / self.step_s
        weight = gaussian_filter1d(self.known.astype(float), width, mode="constant")
        total = gaussian_filter1d(np.where(self.known, self.value, 0.0), width, mode="constant")
        return np.asarray(total / np.maximum(weight, 1e-9))

    def slowed(self, lag_s: float) -> "Grid":
        """As a sensor with this time constant [s] sees it."""
        if not lag_s:
            return self
        keep = float(np.exp(-self.step_s / lag_s))
        value, _ = lfilter([1.0 - keep], [1.0, -keep], self.value, zi=[keep * self.value[0]])
        return self._replace(value=np.asarray(value))


def gridded(track: Track, step_s: float, smooth_s: float = 0.0) -> Grid:
    """The track every `step_s`, under a bell of standard deviation `smooth_s` [s] against the noise of its samples."""
    t = np.arange(track.t[0], track.t[-1], step_s)
    value = track.at(t)
    if smooth_s:
        value = gaussian_filter1d(value, smooth_s / step_s, mode="nearest")
    return Grid(t, value, track.known(t))

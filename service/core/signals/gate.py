"""The gate before the residual generators: an outlier is held back, as it would pass through their states for long.

A sample is an outlier where it is further from the median of the last samples than six times how far those are
themselves, by their median absolute deviation (Hampel 1974), and further than a distance that its noise does not reach:

    |z_k - med| > max(6 * 1.4826 * med |z_j - med|, outlier),     j = k - 12 ... k

The last sample that was none stands for it, and what is computed from that is not counted. A step passes after 7
samples, when the median has followed: what was held back was no outlier then, and can be taken in hindsight. Signals
that may come and go within that time have no `outlier` distance, and are not gated.
"""

from collections.abc import Sequence

import numpy as np

from faultline.service.core.manifest import Input
from faultline.service.core.signals.values import FloatArray, Mask

SAMPLES = 13
FAR = 6.0 * 1.4826
"""Six standard deviations of normal samples, in median absolute deviations."""

BACK = 3.0


class Gate:
    """The gate of the inputs with an `outlier` distance. State: their last samples, and the last one that passed.

    The inputs' `columns` (G,) and distances `least` (G,) say which those are.

    `held` (nz,) are the signals whose sample is held back. `stepped` (nz,) are those that have been and now pass,
    without having come back: the sample is not `BACK` times nearer to the one that stood for them than to the last.
    Of them those have `jumped` (nz,) that lie further than the `outlier` distance from what stood for them.
    """

    def __init__(self, inputs: Sequence[Input]) -> None:
        self.columns = np.array([k for k, each in enumerate(inputs) if each.outlier is not None], dtype=np.intp)
        self.least = np.array([each.outlier for each in inputs if each.outlier is not None])
        self._last = np.zeros((SAMPLES, len(self.columns)))
        self._passed = np.zeros(len(self.columns))
        self._refused = np.zeros(len(self.columns))
        self._seen = np.zeros(len(self.columns), dtype=np.intp)
        self.held = np.zeros(len(inputs), dtype=np.bool_)
        self.stepped = np.zeros(len(inputs), dtype=np.bool_)
        self.jumped = np.zeros(len(inputs), dtype=np.bool_)
        self._is_quiet = True  # nothing is held, has stepped or jumped, as nearly always

    def passed(self, z: FloatArray, usable: Mask) -> FloatArray:
        """Return the samples `z` (nz,), with those that are `held` back replaced.

        Those not `usable` (nz,) are no samples. The first `SAMPLES` of a signal pass.
        """
        if not len(self.columns):
            return z
        now, good = z[self.columns], usable[self.columns]
        last = self._last
        last[np.where(good, self._seen % SAMPLES, 0), np.arange(len(now))] = np.where(good, now, last[0])
        self._seen += good
        middle = np.sort(last, axis=0)[SAMPLES // 2]
        spread = np.sort(np.abs(last - middle), axis=0)[SAMPLES // 2]
        is_far = np.abs(now - middle) > np.maximum(FAR * spread, self.least)
        outlier = good & (self._seen > SAMPLES) & is_far
        if self._is_quiet and not outlier.any():
            self._passed = np.where(good, now, self._passed)
            return z
        before, passes = self.held[self.columns], good & ~outlier
        by = np.abs(now - self._passed)
        stepped = before & passes & (np.abs(now - self._refused) < BACK * by)
        self.stepped[self.columns] = stepped
        self.jumped[self.columns] = stepped & (by > self.least)
        self.held[self.columns] = outlier
        self._passed = np.where(passes, now, self._passed)
        self._refused = np.where(outlier, now, self._refused)
        self._is_quiet = not (outlier | stepped).any()
        if not outlier.any():
            return z
        z = z.copy()
        z[self.columns[outlier]] = self._passed[outlier]
        return z

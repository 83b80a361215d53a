"""Times that never go back and never leap, from batch to batch: detectors live on differences of time."""

from dataclasses import replace

import numpy as np

from faultline.service.core.signals.values import FloatArray
from faultline.service.logs.batch import Batch
from faultline.service.logs.report import LogReport

STEP_BACK_S = 1.0
"""Frames of two interfaces may be written this far out of order [s]; more is a clock that was set back."""

STEP_AHEAD_S = 3600.0
"""No pause within a drive is longer [s]; more is a clock that was set, as where there is none at start-up."""

_BLOCK = 64  # frames looked at behind a step of the clock: another one may follow at once


class Ordering:
    """State: the last time [s], and by how much later ones are moved as the clock was set. Steps are counted.

    Only data frames decide: remote and error frames are put between the data frames around them.
    """

    def __init__(self, report: LogReport) -> None:
        self._report = report
        self._last: float | None = None
        self._shift = 0.0

    def ordered(self, batch: Batch) -> Batch:
        """The batch with such times."""
        if not len(batch):
            return batch
        frames = batch.with_data
        if self._last is None and len(frames):
            self._last = float(frames.time[0])
        if self._last is None:
            return batch
        last, has_data = self._last, batch.has_data
        if frames is batch:
            return replace(batch, time=self._times(batch.time, last))
        before = np.concatenate([[last], self._times(frames.time, last)])
        after = np.append(before[1:], before[-1] + STEP_AHEAD_S)
        place = np.cumsum(has_data)
        time = np.clip(batch.time + self._shift, before[place], after[place])
        return replace(batch, time=np.where(has_data, before[place], time))

    def times(self, t: FloatArray) -> FloatArray:
        """Return such times of the rows of a table (N,), at least one."""
        return self._times(t, float(t[0]) if self._last is None else self._last)

    def _times(self, t: FloatArray, last: float) -> FloatArray:
        found = np.empty_like(t)
        at, block = 0, len(t)
        while at < len(t):
            part = t[at : at + block] + self._shift
            highest = np.maximum.accumulate(np.concatenate([[last], part]))
            step = part - highest[:-1]
            wrong = ~((step >= -STEP_BACK_S) & (step <= STEP_AHEAD_S))
            good = int(np.argmax(wrong)) if wrong.any() else len(part)
            found[at : at + good] = highest[1 : good + 1]
            last = float(highest[good])
            at, block = at + good, 8 * block
            if good < len(part):
                self._report.clock_steps += 1
                self._shift += last - float(part[good])
                found[at] = last
                at, block = at + 1, _BLOCK
        self._last = last
        return found

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
    """State: the last time [s], and by how much later ones are moved as the clock was set. Steps are counted."""

    def __init__(self, report: LogReport) -> None:
        self._report = report
        self._last: float | None = None
        self._shift = 0.0

    def ordered(self, batch: Batch) -> Batch:
        """The batch with such times."""
        if not len(batch):
            return batch
        if self._last is None:
            self._last = float(batch.time[0])
        return replace(batch, time=self._times(batch.time, self._last))

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

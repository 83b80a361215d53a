"""Times that never go back and never leap, from batch to batch: detectors live on differences of time.

A frame whose time is far from those around it, as damage of a digit leaves it, takes the time of the one before. Else
everything behind it would be taken for a clock that was set.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from faultline.service.core.signals.values import FloatArray, Mask
from faultline.service.logs.batch import Batch, joined
from faultline.service.logs.report import LogReport

STEP_BACK_S = 1.0
"""Frames of two interfaces may be written this far out of order [s]; more is a clock that was set back."""

STEP_AHEAD_S = 3600.0
"""No pause within a drive is longer [s]; more is a clock that was set, as where there is none at start-up."""

OUTLIERS = 8
"""So many frames in a row may be outliers; more are a clock that was set."""

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
        """Return such times of the rows of a table (N,), at least one, without outliers."""
        t, count, _ = replace_outliers(t, np.nan, is_end=True)
        self._report.outliers += count
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


def without_outliers(batches: Iterable[Batch], report: LogReport) -> Iterator[Batch]:
    """Yield the frames; those whose time leaves that before by more than a second, and soon returns, are counted.

    A batch's last frames wait for the next one where only that shows whether the time returns.
    """
    held: list[Batch] = []
    last = np.nan
    for batch in batches:
        whole = joined([*held, batch]) if held else batch
        time, count, certain = replace_outliers(whole.time, last)
        report.outliers += count
        held = [whole[certain:]] if certain < len(whole) else []
        if certain:
            last = float(time[certain - 1])
            yield replace(whole, time=time)[:certain] if count or held else whole
    if held:  # no more can show whether their times return
        time, count, _ = replace_outliers(held[0].time, last, is_end=True)
        report.outliers += count
        yield replace(held[0], time=time)


def replace_outliers(t: FloatArray, last: float, *, is_end: bool = False) -> tuple[FloatArray, int, int]:
    """Return the times, how many were replaced, and how many of the first are certain; `last` was before them [s].

    What is not certain depends on times that come after these; at the end all are.
    """
    before = np.concatenate([[last], t[:-1]])
    found = t
    count, end = 0, 0
    with np.errstate(invalid="ignore"):
        leaps = np.flatnonzero(np.abs(t - before) > STEP_BACK_S).tolist()
    for leap in leaps:
        if leap < end:
            continue
        base = float(found[leap - 1]) if leap else last
        later = t[leap + 1 : leap + 1 + OUTLIERS]
        back = np.flatnonzero(_returned(later, base, float(t[leap])))
        if len(back):
            end = leap + 1 + int(back[0])
            found = found.copy() if found is t else found
            found[leap:end] = base
            count += end - leap
            end += 1  # the frame that returned is no leap
        elif len(later) < OUTLIERS and not is_end:
            return found, count, leap
    return found, count, len(t)


def _returned(later: FloatArray, base: float, leap: float) -> Mask:
    """Return which of the later times go on from `base`, from which the time had leapt [s]."""
    on = (later >= base - STEP_BACK_S) & (later <= base + STEP_AHEAD_S)
    return np.asarray(on & (later < leap - STEP_BACK_S) if leap > base else on)

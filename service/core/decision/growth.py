"""A fault that grows: the mean shifts of a window in which its size was another one at each time.

Pooled, a small fault in one mode and a larger one in another look like another fault, or like none that is known. So
courses are tried in which the size has grown in proportion to the time,

    size(t) = s min(1, w + (1 - w) (t - t_0) / (t_1 - t_0)),

from the part w of its present size s at the window's beginning t_0 until t_1, and has stayed since. Sizes are counted
in steps of the assumed ones, which lie the closer the more a fault does: a filter's effect grows fastest at the end.
"""

import numpy as np

from faultline.service.core.decision.straying import History
from faultline.service.core.signals.values import FloatArray, Indices, Mask

BEGINS = 0.0, 0.25, 0.5, 0.75
"""Parts of the present size that a fault may have had at the window's beginning."""

ENDS = 0.25, 0.5, 1.0
"""Parts of the window's length after which it may have stopped to grow."""

BETWEEN = 4
"""Present sizes that are tried from one assumed size to the next."""


class Growth:
    """The courses that faults may have taken in one window, for the means `seen` (C, K)."""

    def __init__(self, history: History, seen: Mask) -> None:
        self.ticks = np.maximum(history.ticks[:, seen].sum(axis=0), 1.0)  # (D,)
        self.shift = history.shift[:, :, seen]  # (N, H, D), sums
        self.course = _courses(history.age)  # (W, N)
        self._parts: dict[int, FloatArray] = {}

    def shifts(self, rows: Indices) -> FloatArray:
        """Return the mean shifts (M, D): each present size of one chain, by each course.

        `rows` (J,) are the hypotheses of its sizes from the smallest on: none is before them, and between two of them
        the shift is on the straight line.
        """
        if len(rows) not in self._parts:
            self._parts[len(rows)] = self._sized(len(rows))
        total = self._parts[len(rows)] @ self.shift[:, rows].reshape(-1, self.shift.shape[-1])
        return np.asarray(total / self.ticks)

    def _sized(self, steps: int) -> FloatArray:
        """What each assumed size has of the shift of each part of the window (M, N J)."""
        at = np.multiply.outer(present_sizes(steps), self.course).reshape(-1, self.course.shape[1], 1)  # (M, N, 1)
        return np.maximum(1.0 - np.abs(at - np.arange(1, steps + 1)), 0.0).reshape(len(at), -1)


def present_sizes(steps: int) -> FloatArray:
    """Return the present sizes (S,) that are tried, in steps of the assumed ones: so far along the chain."""
    return np.arange(1, BETWEEN * steps + 1) / BETWEEN


def _courses(age: FloatArray) -> FloatArray:
    """The parts (W, N) of the present size that a fault has had at each age."""
    since = 1.0 - age / max(float(age.max()), 1.0)  # 0 at the beginning, 1 now
    begin, end = np.array(BEGINS)[:, None, None], np.array(ENDS)[:, None]
    grown = begin + (1.0 - begin) * since / end
    return np.asarray(np.minimum(np.maximum(grown, begin), 1.0).reshape(-1, len(age)))

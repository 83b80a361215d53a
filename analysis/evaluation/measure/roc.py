"""Receiver operating characteristic of a generator: how well its score tells faulty blocks from fault-free ones.

The score is that of `blocks`, so the curve is the residual's own and no threshold of the bundle is in it.
"""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def area(free: Array, faulty: Array) -> float | None:
    """Area under the curve: the probability that a faulty block scores higher than a fault-free one, ties a half.

    By ranks (Mann and Whitney 1947). NaN scores are left out; None where a side has none.

    >>> area(np.array([1.0, 2.0]), np.array([2.0, 3.0]))
    0.875
    """
    free, faulty = free[np.isfinite(free)], faulty[np.isfinite(faulty)]
    if not free.size or not faulty.size:
        return None
    _, value, count = np.unique(np.concatenate([free, faulty]), return_inverse=True, return_counts=True)
    ranks = (np.cumsum(count) - (count - 1) / 2)[value[free.size :]]  # equal scores share the mean of theirs
    return float((ranks.sum() - faulty.size * (faulty.size + 1) / 2) / (free.size * faulty.size))


def curve(free: Array, faulty: Array) -> tuple[Array, Array]:
    """Shares of fault-free and of faulty blocks at or above each threshold, from none to all.

    >>> [points.tolist() for points in curve(np.array([1.0, 2.0]), np.array([2.0, 3.0]))]
    [[0.0, 0.0, 0.5, 1.0], [0.0, 0.5, 1.0, 1.0]]
    """
    free, faulty = (np.sort(scores[np.isfinite(scores)]) for scores in (free, faulty))
    thresholds = np.concatenate([[np.inf], np.unique(np.concatenate([free, faulty]))[::-1]])
    below = [np.searchsorted(scores, thresholds) / max(len(scores), 1) for scores in (free, faulty)]
    return 1.0 - below[0], 1.0 - below[1]

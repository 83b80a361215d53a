"""Generators that are numerically the same signal: ten alarms of four signals are four pieces of evidence.

Two are equal where neither differs from the other by more than a tenth in any part, fault-free or with any fault: the
cosine of their standardised residuals there is at least 1 - 0.1^2 / 2 without regard to sign.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

SAME = 0.995


def equal_groups(products: Sequence[Array]) -> list[int]:
    """For each generator the first that equals it, itself at least.

    `products` are sums of products (T, T) of the standardised residuals, one for each part; all zero: nothing is known.

    >>> equal_groups([np.array([[4.0, -4.0, 0.0], [-4.0, 4.0, 0.0], [0.0, 0.0, 1.0]])])
    [0, 0, 2]
    """
    known = [part for part in products if np.diag(part).all()]
    T = len(products[0]) if products else 0
    same = np.full((T, T), bool(known))
    for part in known:
        norm = np.sqrt(np.diag(part))
        same &= abs(part) >= SAME * np.outer(norm, norm)
    first: list[int] = []
    for row in range(T):
        leaders = [other for other in dict.fromkeys(first) if same[row, other]]
        first.append(leaders[0] if leaders else row)
    return first

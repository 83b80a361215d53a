"""Whether what a model leaves of the data is noise: a bin then says nothing about the next one.

Of e_1 ... e_n, where only neighbours without a gap make pairs, P_k of them k bins apart:

    r_k = (sum of e_i e_i+k over the pairs / P_k) / (sum of e_i^2 / n)
    Q   = (n + 2) / n * sum over k of P_k r_k^2

Q is Ljung and Box's statistic (Biometrika 65, 1978), which it equals where nothing is missing; for noise it is chi
square with as many degrees of freedom as there are k. No mean is taken off: a lasting error is something left too.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc

Array = npt.NDArray[np.float64]

LAGS = 10
"""Of bins: as long as the blocks that count as independent."""

FEW = 20
"""With fewer pairs nothing is said of them."""


@dataclass(frozen=True)
class Whiteness:
    """Of what is left: `bins`, the correlation `lag1` of neighbours, Q over `lags`, and the `probability` of more."""

    bins: int
    lag1: float
    q: float
    lags: int
    probability: float


def whiteness(e: Array, run: npt.NDArray[np.int64]) -> Whiteness | None:
    """Of (n,) values in order, of which those of one number in `run` (n,) follow each other; None if they are too few.

    >>> import numpy as np
    >>> e = np.random.default_rng(2).normal(size=300)
    >>> one = np.zeros(300, dtype=np.int64)
    >>> whiteness(e, one).probability > 0.05, whiteness(np.cumsum(e), one).probability < 1e-6
    (True, True)
    """
    n, power, r, q = len(e), float(np.mean(e**2)) if len(e) else 0.0, list[float](), 0.0
    for k in range(1, LAGS + 1):
        pair = run[k:] == run[:-k]
        count = int(pair.sum())
        if count < FEW or power == 0.0:
            break
        r.append(float(np.mean((e[:-k] * e[k:])[pair])) / power)
        q += (n + 2) / n * count * r[-1] ** 2
    if not r:
        return None
    return Whiteness(n, r[0], q, len(r), float(chdtrc(len(r), q)))

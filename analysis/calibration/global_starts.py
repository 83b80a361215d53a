"""Starts for a calibration from a global search, for where the starts from datasheet and prior leave a doubt.

Sets of those parameters that are open are tried quasi-randomly (Sobol 1967) all over their priors. Each costs one free
run: what is not open takes its linear least-squares step from where it was (variable projection, Golub and Pereyra
1973). The best sets, apart from each other, are searched from.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtri
from scipy.stats import qmc

from faultline.analysis.calibration.noise import Weigh
from faultline.analysis.calibration.problem import Problem
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

FEW, MANY, MOST = 3, 64, 128
"""So many sets are tried for a few open parameters, and for more."""

WIDE = 2.0
"""Times the prior's standard deviation: what is looked for is where the prior did not lead."""

APART = 0.3
"""Standard deviations of a prior between two starts, in one open parameter at least."""

GAIN = 5.0
"""Cost [nats] by which a set is better than where the search begins, if any is: those that are not are no starts."""

SEED = 1


@dataclass(frozen=True)
class GlobalStarts:
    """The starts `x` (k, n), the best first, of so many sets `tried`; with `failed` of them the model cannot be run."""

    x: tuple[Array, ...]
    tried: int
    failed: int


def global_starts(
    problem: Problem, weights: Sequence[Weigh], begin: Array, open_ones: Flags, most: int
) -> GlobalStarts:
    """Try sets of the parameters that are open (n,), the others from where they `begin` (n,); at `most` so many starts.

    Raises:
        InputError: the model cannot be run where they begin.
    """
    J = np.concatenate([white(J) for white, J in zip(weights, problem.slopes(begin), strict=True)])[:, ~open_ones]
    H = cho_factor(J.T @ J + np.eye(J.shape[1]))
    ends = list[tuple[float, Array]]()
    tried = _sets(begin, open_ones, problem.bounds)
    for x in tried:
        try:
            e = np.concatenate([white(e) for white, e in zip(weights, problem.left(x), strict=True)])
        except InputError:  # with these the model cannot be run; with others it may
            continue
        g = J.T @ e + x[~open_ones]
        step = -cho_solve(H, g)
        cost = 0.5 * float(e @ e + x @ x + g @ step)
        x[~open_ones] += step
        ends.append((cost, np.clip(x, *problem.bounds)))
    ends.sort(key=lambda end: end[0])
    left = np.concatenate([white(e) for white, e in zip(weights, problem.left(begin), strict=True)])
    enough = 0.5 * float(left @ left + begin @ begin) - GAIN
    better = [end for end in ends if end[0] < enough]
    starts = list[Array]()
    for _, x in better if len(better) > 1 else ends:  # one alone would agree with itself
        if all(np.abs(x - other)[open_ones].max() > APART for other in starts):
            starts.append(x)
    return GlobalStarts(tuple(starts[:most]), len(tried), len(tried) - len(ends))


def _sets(begin: Array, open_ones: Flags, bounds: Array) -> Array:
    """The sets (T, n), within the bounds."""
    n = int(open_ones.sum())
    u = qmc.Sobol(n, seed=SEED).random(MANY if n <= FEW else MOST)
    sets = np.tile(begin, (len(u), 1))
    sets[:, open_ones] = WIDE * ndtri(np.clip(u, 1e-9, 1.0 - 1e-9))
    return np.asarray(np.clip(sets, *bounds))

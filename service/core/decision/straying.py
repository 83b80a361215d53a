"""How far the mean residuals of a drive without faults stray, and what has been seen of them.

All means of C modes and K evidence generators, stacked as one vector of D = C K, are a Gaussian variable: around the
vehicle's offset they lie where the drive's baseline puts them, and what is seen of them in n ticks and v visits strays,

    m ~ N(offset + baseline, diag_c(V_c / n_c + U_c / v_c)),      baseline ~ N(0, P0),  P0 = diag(a^2) + sum_k w_k w_k'

with the covariance V of a tick (the noise of blocks and the spread of ticks), U of a visit to the mode (a visit has a
dose and a history of its own, and does not get surer by its length; of unequal visits v is n^2 / sum of squared
lengths), the drifts w (how all means stray together from one drive to the next: a fluid's viscosity, a sensor's zero),
and a what each strays by itself. Where the operation is another than was seen without a fault, the model's own error
moves the means as well: by a standard deviation of `MOVED` of how far the mean predicted signal is from the usual one.

The drifts move other generators too, by f_k: what is expected of their baselines follows from these means',

    E[f] = f w P0^-1 b,     Var[f] = A P A' + f (1 - w P0^-1 w') f',   A = f w P0^-1,  b the baseline, P = Var[b]
"""

from typing import NamedTuple

import numpy as np

from faultline.service.core.manifest import Evidence
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.signals.values import FloatArray, Indices, Mask

MINIMUM_TICKS = 10
"""A mode counts once this many ticks were seen in it."""

MOVED = 0.05
"""Chosen in a trial on five severe faults of one simulated vehicle; other parts were not tried."""


class Means(NamedTuple):
    """What was seen of C modes and K generators: ticks, squares of visits' lengths, sums of residuals, each (C, K).

    A visit is a stay in a mode; the squares say how evenly the ticks lie in visits. `predicted` (C, K) are sums of the
    signals that were predicted, `shift` (H, C, K) of what each hypothesis would have done to the residuals, `brought`
    (n, C, K) of the ticks in which a consequence showed, `excess` (C, K) of the variance of a network's error.
    """

    ticks: FloatArray
    squares: FloatArray
    total: FloatArray
    predicted: FloatArray
    shift: FloatArray
    brought: FloatArray
    excess: FloatArray

    @property
    def seen(self) -> Mask:
        """The means (C, K) that count."""
        return np.asarray(self.ticks >= MINIMUM_TICKS)


class History(NamedTuple):
    """What was seen of C modes and K generators in N parts of a window, one after the other.

    `ticks` (N, C, K) and sums of `shift` (N, H, C, K) are as those of `Means`, `age` (N,) is their mean one [ticks].
    """

    ticks: FloatArray
    age: FloatArray
    shift: FloatArray


class Apparent(NamedTuple):
    """The distribution of L apparent faults (`core.decision.baseline`): expected value (L,) and covariance (L, L).

    `cross` (D, L) is their covariance with the means; `usual` (L, D) is what they do to the means in usual operation:
    `part` (L,) of the shifts by the hypotheses `rows` (L,).
    """

    mean: FloatArray
    covariance: FloatArray
    cross: FloatArray
    usual: FloatArray
    rows: Indices
    part: FloatArray


class Level(NamedTuple):
    """The distribution of the means by the baseline: expected value (C, K) and covariance (D, D).

    Both hold in usual operation; the `apparent` faults give them in any other.
    """

    mean: FloatArray
    covariance: FloatArray
    apparent: Apparent | None = None

    def in_operation(self, means: Means) -> "Level":
        """Return the level in the operation in which these means were seen."""
        if self.apparent is None:
            return self
        known = self.apparent
        shift = means.shift[known.rows] / np.maximum(means.ticks, 1.0) * known.part[:, None, None]
        more = np.where(means.ticks > 0, shift - known.usual.reshape(shift.shape), 0.0).reshape(known.usual.shape)
        across = known.cross @ more
        mean = self.mean + (known.mean @ more).reshape(self.mean.shape)
        return Level(mean, self.covariance + across + across.T + more.T @ known.covariance @ more)

    @property
    def variance(self) -> FloatArray:
        """Of each mean (C, K)."""
        return np.asarray(self.covariance.diagonal().reshape(self.mean.shape))


class Visit:
    """The stay in a mode: for how many ticks of it each generator could tell, `length` (K,)."""

    def __init__(self, generators: int) -> None:
        self.mode, self.length = EDGE, np.zeros(generators)

    def in_mode(self, mode: int) -> None:
        """A tick in this mode: another one is another visit."""
        if mode != self.mode:
            self.mode, self.length = mode, np.zeros(len(self.length))


class Straying:
    """The numbers of a bundle's evidence: `offset` (C, K), and `unknown`: the level of a drive before it has begun."""

    def __init__(self, evidence: Evidence) -> None:
        self.offset = np.array(evidence.offset)[1:]
        self._noise, self._visit = np.array(evidence.noise)[1:], np.array(evidence.visit)[1:]
        C, K = self.offset.shape
        self._noise += np.array(evidence.spread)[1:, :, None] ** 2 * np.eye(K)
        self._operation = np.array(evidence.operation)[1:]
        drifts = np.array(evidence.drifts).reshape(-1, 1 + C, K)[:, 1:].reshape(-1, C * K)
        own = np.array(evidence.allowance)[1:].ravel()
        self.unknown = Level(np.zeros((C, K)), np.diag(own**2) + drifts.T @ drifts)
        moved = np.zeros((len(drifts), C, len(evidence.followers)))
        for column, follower in enumerate(evidence.followers):
            moved[..., column] = np.array(follower.drifts).reshape(-1, 1 + C)[:, 1:]
        following = moved.reshape(len(drifts), C * len(evidence.followers))
        told = np.linalg.pinv(self.unknown.covariance, hermitian=True) @ drifts.T  # (D, R)
        self._following = following.T @ told.T  # A (C F, D)
        self._unfollowed = (following**2).sum(axis=0) - ((drifts @ told).T @ following * following).sum(axis=0)

    def scatter(self, means: Means) -> FloatArray:
        """How far means strays besides the baseline (D, D), by what was seen of them."""
        ticks = np.maximum(means.ticks, 1.0)
        tick, visit = 1.0 / np.sqrt(ticks), np.sqrt(means.squares) / ticks  # parts that remain of a deviation
        C, K = ticks.shape
        S = np.zeros((C, K, C, K))
        for mode in range(C):
            S[mode, :, mode] = self._noise[mode] * np.outer(tick[mode], tick[mode])
            S[mode, :, mode] += self._visit[mode] * np.outer(visit[mode], visit[mode])
        away = np.where(means.ticks > 0, means.predicted / ticks - self._operation, 0.0)
        return S.reshape(C * K, C * K) + np.diag((MOVED * away.ravel()) ** 2 + (means.excess / ticks).ravel())

    def deviation(self, means: Means) -> FloatArray:
        """How far the means (C, K) lie from the vehicle's offsets; zero where nothing was seen."""
        return np.asarray(np.where(means.ticks > 0, means.total / np.maximum(means.ticks, 1.0) - self.offset, 0.0))

    def everywhere(self, level: Level) -> tuple[FloatArray, FloatArray]:
        """Expected value and variance (C, K + F) of where a baseline puts the means; those of followers are behind."""
        C, A = len(level.mean), self._following
        mean = (A @ level.mean.ravel()).reshape(C, len(A) // C)
        variance = ((A @ level.covariance * A).sum(axis=1) + np.maximum(self._unfollowed, 0.0)).reshape(C, len(A) // C)
        return np.hstack([level.mean, mean]), np.hstack([level.variance, variance])

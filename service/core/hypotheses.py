"""Weighs what may be wrong by sign, size and pattern of the residuals over the operating modes.

A window collects the mean residual m_c of every mode c. A hypothesis h predicts the shift mu_h of all those means,
stacked; how badly it fits them is its misfit

    q_h = d' S_h^-1 d,   d = m - b - mu_h,
    S_h = diag_c(V_c / n_c + U_c / v_c + a_c^2) + sum_k w_k w_k' + diag((gamma mu_h)^2)

with the fault-free mean b, the covariance V of n ticks, U of v visits to the mode (a visit has a dose and a history of
its own, and does not get surer by its length; of unequal visits v is n^2 / sum of squared lengths), the allowance a for
what tuning cannot know, the drifts w (how far all means stray together from one drive to the next), and gamma for the
error of the prediction itself. Size is free: a fault's misfit is that of its best size, on the straight line between
those that are predicted. Without a fault mu is zero. Means of a generator that could not tell are left out.

The window must be fresh: samples from before the onset, pooled with later ones, look like a dose-dependent fault.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from service.core.manifest import MODES, Evidence
from service.core.modes import EDGE
from service.core.signals import Mask, Vector

GAMMA = 0.1
MINIMUM_TICKS = 10
"""A mode counts once this many ticks were seen in it."""


class Means(NamedTuple):
    """What a window saw of C modes and K generators, each (C, K): ticks, squares of visits' lengths, sums of residuals.

    A visit is a stay in a mode; the squares say how evenly the ticks lie in visits.
    """

    ticks: Vector
    squares: Vector
    total: Vector


class Window:
    """The residuals of the evidence generators since `clear`. A tick counts for those that can tell."""

    def __init__(self, evidence: Evidence, generators: Sequence[str]) -> None:
        self._columns = np.array([generators.index(name) for name in evidence.generators])
        self.clear()

    def clear(self) -> None:
        """Starts a fresh window."""
        self._ticks, self._squares, self._total = np.zeros((3, EDGE, len(self._columns)))
        self.leave()

    def leave(self) -> None:
        """Whatever comes next is another visit."""
        self._mode, self._length = EDGE, np.zeros(len(self._columns))

    def add(self, mode: int, r: Vector, usable: Mask) -> None:
        """Takes the residuals `r` (T,) of a tick; those at an edge say nothing."""
        if mode != self._mode:
            self.leave()
        self._mode = mode
        if mode == EDGE:
            return
        told = usable[self._columns]
        self._ticks[mode] += told
        self._squares[mode] += told * (2.0 * self._length + 1.0)
        self._total[mode] += np.where(told, r[self._columns], 0.0)
        self._length = np.where(told, self._length + 1.0, 0.0)

    @property
    def means(self) -> Means:
        """What was seen."""
        return Means(self._ticks, self._squares, self._total)


class Weighed(NamedTuple):
    """Misfits: of no fault, and of every fault at its best size."""

    nothing: float
    faults: dict[str, float]

    @property
    def gain(self) -> float:
        """By how much the best fault fits better than none."""
        return self.nothing - min(self.faults.values(), default=self.nothing)


class Hypotheses:
    """All faults of a bundle, as polygons of predicted shifts that begin at none."""

    def __init__(self, evidence: Evidence) -> None:
        modes = [index for index in range(len(MODES)) if index != EDGE]
        self._offset, self._allowance = np.array(evidence.offset)[modes], np.array(evidence.allowance)[modes]
        self._noise, self._visit = np.array(evidence.noise)[modes], np.array(evidence.visit)[modes]
        K = len(evidence.generators)
        self._drifts = np.array(evidence.drifts).reshape(-1, len(MODES), K)[:, modes]  # (R, C, K)
        self.faults, begin, end = _segments(evidence)
        self._begin, self._end = begin[:, modes], end[:, modes]  # (H, C, K)

    def weigh(self, means: Means) -> Weighed | None:
        """The misfits; None while nothing has been seen long enough."""
        seen = means.ticks >= MINIMUM_TICKS  # (C, K)
        if not seen.any():
            return None
        d, S = self._deviation(means, seen)
        W = np.asarray(np.linalg.inv(S))
        begin, end = self._begin[:, seen], self._end[:, seen]  # (H, D)
        way = end - begin  # along it, the nearest point in terms of W
        length = np.einsum("hd,de,he->h", way, W, way)
        part = np.clip(np.einsum("hd,de,he->h", d - begin, W, way) / np.maximum(length, 1e-300), 0.0, 1.0)
        mu = begin + part[:, None] * way
        faults: dict[str, float] = {}
        for fault, value in zip(self.faults, _misfit(d, mu, S), strict=True):
            faults[fault] = min(faults.get(fault, np.inf), float(value))
        return Weighed(float(d @ W @ d), faults)

    def deviating(self, means: Means, sigmas: float) -> Mask:
        """The generators (K,) whose mean in some mode lies further from the fault-free one than so many deviations."""
        seen = means.ticks >= MINIMUM_TICKS
        far = np.zeros_like(seen)
        if seen.any():
            d, S = self._deviation(means, seen)
            far[seen] = np.abs(d) > sigmas * np.sqrt(S.diagonal())
        return np.asarray(far.any(axis=0))

    def _deviation(self, means: Means, seen: Mask) -> tuple[Vector, Vector]:
        """The deviations d (D,) of the means `seen` (C, K), and S (D, D) without the error of a prediction."""
        ticks = np.maximum(means.ticks, 1.0)
        tick, visit = 1.0 / np.sqrt(ticks), np.sqrt(means.squares) / ticks  # parts that remain of a deviation
        C, K = seen.shape
        S = np.zeros((C, K, C, K))
        for mode in range(C):
            S[mode, :, mode] = self._noise[mode] * np.outer(tick[mode], tick[mode])
            S[mode, :, mode] += self._visit[mode] * np.outer(visit[mode], visit[mode])
            S[mode, :, mode] += np.diag(self._allowance[mode] ** 2)
        S += np.einsum("rck,rdl->ckdl", self._drifts, self._drifts)
        d = means.total / ticks - self._offset
        return d[seen], S[seen][:, seen]


def _misfit(d: Vector, mu: Vector, S: Vector) -> Vector:
    """The misfits (H,) of the shifts mu (H, D)."""
    left = d - mu
    diagonal = np.arange(len(d))
    of = np.broadcast_to(S, (len(mu), *S.shape)).copy()
    of[:, diagonal, diagonal] += (GAMMA * mu) ** 2
    return np.asarray(np.einsum("hd,hd->h", left, np.linalg.solve(of, left[..., None])[..., 0]))


def _segments(evidence: Evidence) -> tuple[list[str], Vector, Vector]:
    """Fault, and both ends (H, modes, K), of every segment between neighbouring sizes of one sign."""
    shape = len(evidence.hypotheses), len(MODES), len(evidence.generators)
    faults: list[str] = []
    begin, end = np.zeros(shape), np.zeros(shape)
    curves: dict[tuple[str, bool], list[tuple[float, list[list[float]]]]] = {}
    for hypothesis in evidence.hypotheses:
        curve = curves.setdefault((hypothesis.fault, hypothesis.size > 0), [])
        curve.append((abs(hypothesis.size), hypothesis.shift))
    for (fault, _), curve in curves.items():
        before = np.zeros(shape[1:])
        for _, shift in sorted(curve, key=lambda point: point[0]):
            begin[len(faults)], end[len(faults)] = before, shift
            before = np.array(shift)
            faults.append(fault)
    return faults, begin, end

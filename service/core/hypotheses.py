"""Weighs what may be wrong by sign, size and pattern of the residuals over the operating modes.

A window collects the mean residual m_c of every mode c. A hypothesis h predicts the shift mu_h of all those means,
stacked; how badly it fits them is its misfit

    q_h = d' S_h^-1 d,   d = m - b - mu_h,
    S_h = diag_c(V_c / n_c + U_c / v_c + a_c^2) + sum_k w_k w_k' + diag((gamma mu_h)^2)

with the fault-free mean b, the covariance V of n ticks, U of v visits to the mode (a visit has a dose and a history of
its own, and does not get surer by its length), the allowance a for what tuning cannot know, the drifts w (how far all
means stray together from one drive to the next), and gamma for the error of the prediction itself. Size
is free: a fault's misfit is that of its best size, on the straight line between those that are predicted. Without a
fault mu is zero.

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
    """What a window saw of C modes and K generators: ticks and visits (C,), and the residuals' sums (C, K)."""

    ticks: Vector
    visits: Vector
    total: Vector


class Window:
    """The residuals of the evidence generators since `clear`. State: ticks and a sum per mode and generator."""

    def __init__(self, evidence: Evidence, generators: Sequence[str]) -> None:
        self._columns = np.array([generators.index(name) for name in evidence.generators])
        self.clear()

    def clear(self) -> None:
        """Starts a fresh window."""
        self._ticks, self._visits = np.zeros(EDGE), np.zeros(EDGE)
        self._mode = EDGE
        self._total = np.zeros((EDGE, len(self._columns)))

    def add(self, mode: int, r: Vector, usable: Mask) -> None:
        """Takes the residuals `r` (T,) of a tick; ticks at an edge, or where a generator cannot tell, are left out."""
        if mode == EDGE or not usable[self._columns].all():
            self._mode = EDGE
            return
        self._ticks[mode] += 1
        self._visits[mode] += mode != self._mode
        self._mode = mode
        self._total[mode] += r[self._columns]

    @property
    def means(self) -> Means:
        """What was seen."""
        return Means(self._ticks, self._visits, self._total)


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
        """The misfits; None while no mode has been seen long enough."""
        seen = means.ticks >= MINIMUM_TICKS
        if not seen.any():
            return None
        d = (means.total[seen] / means.ticks[seen, None] - self._offset[seen]).ravel()
        S = self._covariance(seen, means)
        W = np.asarray(np.linalg.inv(S))
        begin, end = (part[:, seen].reshape(len(self.faults), -1) for part in (self._begin, self._end))
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
        found = np.zeros(self._offset.shape[1], dtype=np.bool_)
        if seen.any():
            d = means.total[seen] / means.ticks[seen, None] - self._offset[seen]
            spread = np.sqrt(self._covariance(seen, means).diagonal()).reshape(d.shape)
            found |= (np.abs(d) > sigmas * spread).any(axis=0)
        return found

    def _covariance(self, seen: Mask, means: Means) -> Vector:
        """S without the error of a prediction, (D, D) of the modes seen."""
        K = self._offset.shape[1]
        S = np.zeros((int(seen.sum()) * K,) * 2)
        for n, mode in enumerate(np.flatnonzero(seen)):
            own = slice(n * K, (n + 1) * K)
            S[own, own] = self._noise[mode] / means.ticks[mode] + self._visit[mode] / means.visits[mode]
            S[own, own] += np.diag(self._allowance[mode] ** 2)
        drifts = self._drifts[:, seen].reshape(len(self._drifts), len(S))
        return np.asarray(S + drifts.T @ drifts)


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

"""Ranks the faults that the alarms leave, by sign, size and pattern of the residuals over the operating modes.

From the first alarm on a fresh window collects the mean residual m_c of every mode c. A hypothesis h (fault and size)
predicts the shift mu_hc; its misfit is

    q_h = sum_c d_c' S_hc^-1 d_c,   d_c = m_c - b_c - mu_hc,   S_hc = V_c / n_c + diag(a_c^2 + (gamma mu_hc)^2)

with the fault-free mean b, the long-run covariance per tick V, the allowance a for calibration error and drive-to-drive
spread, and gamma for the error of the prediction itself. A fault's misfit is that of its best size. Faults whose
misfits differ by less than `TIE`, or by less than the part `TIE_PART` of the larger one, share a rank: the data do not
separate them, or neither explains the data.

The window is fresh because samples from before the onset, pooled with later ones, look like a dose-dependent fault.
"""

from collections.abc import Sequence

import numpy as np

from service.core.manifest import MODES, Evidence
from service.core.modes import EDGE
from service.core.signals import Mask, Vector

GAMMA = 0.1
TIE = 16.0
TIE_PART = 0.25
MINIMUM_TICKS = 10
"""A mode counts once this many ticks were seen in it."""

SIZES_BETWEEN = 4
"""Sizes tried between two neighbours of the manifest's grid, by linear interpolation of the shift."""


class EvidenceWindow:
    """The residual means of an episode of alarms. State: a count per mode and generator, and a sum."""

    def __init__(self, evidence: Evidence, generators: Sequence[str]) -> None:
        self._columns = np.array([generators.index(name) for name in evidence.generators])
        modes = [index for index in range(len(MODES)) if index != EDGE]
        self._offset = np.array(evidence.offset)[modes]  # (C, K)
        self._noise = np.array(evidence.noise)[modes]  # (C, K, K)
        self._allowance = np.array(evidence.allowance)[modes] ** 2  # (C, K)
        self._faults, shifts = _refined(evidence)
        self._shift = shifts[:, modes]  # (H, C, K)
        self.clear()

    def clear(self) -> None:
        """Starts a fresh window."""
        self._count = np.zeros(len(self._offset))
        self._sum = np.zeros_like(self._offset)

    def add(self, mode: int, r: Vector, usable: Mask) -> None:
        """Takes the residuals `r` (T,) of a tick; ticks at an edge, or where a generator cannot tell, are left out."""
        if mode == EDGE or not usable[self._columns].all():
            return
        self._count[mode] += 1
        self._sum[mode] += r[self._columns]

    def misfits(self) -> dict[str, float]:
        """The misfit of every fault at its best size; empty while no mode has been seen long enough."""
        seen = self._count >= MINIMUM_TICKS
        if not seen.any():
            return {}
        mean = self._sum[seen] / self._count[seen, None] - self._offset[seen]
        shift = self._shift[:, seen]
        d = mean - shift  # (H, C, K)
        S = np.broadcast_to(self._noise[seen] / self._count[seen, None, None], (*d.shape, d.shape[-1])).copy()
        diagonal = np.arange(d.shape[-1])
        S[..., diagonal, diagonal] += self._allowance[seen] + (GAMMA * shift) ** 2
        q = np.einsum("hck,hck->h", d, np.linalg.solve(S, d[..., None])[..., 0])
        misfits: dict[str, float] = {}
        for fault, value in zip(self._faults, q, strict=True):
            misfits[fault] = min(misfits.get(fault, np.inf), float(value))
        return misfits


def ranked(candidates: Sequence[tuple[str, ...]], misfits: dict[str, float]) -> list[tuple[tuple[str, ...], int]]:
    """Candidates with their ranks, best first.

    Where one is not a single known fault, or nothing has been seen yet, all are equal.

    >>> ranked([("fA",), ("fB",), ("fC",)], {"fA": 30.0, "fB": 2.0, "fC": 8.0})
    [(('fB',), 1), (('fC',), 1), (('fA',), 3)]
    """
    if not all(len(candidate) == 1 and candidate[0] in misfits for candidate in candidates):
        return [(candidate, 1) for candidate in candidates]
    q = {candidate: misfits[candidate[0]] for candidate in candidates}
    behind = {candidate: q[candidate] - max(TIE, TIE_PART * q[candidate]) for candidate in candidates}
    rank = {candidate: 1 + sum(other < behind[candidate] for other in q.values()) for candidate in candidates}
    return sorted(rank.items(), key=lambda item: (item[1], item[0]))


def _refined(evidence: Evidence) -> tuple[list[str], Vector]:
    """Fault and shift (H, modes, K) of every hypothesis on the finer grid, which reaches from no fault to each size."""
    faults: list[str] = []
    shifts: list[Vector] = []
    nothing = np.zeros((len(MODES), len(evidence.generators)))
    last = ("", 0.0, nothing)
    for hypothesis in evidence.hypotheses:
        shift = np.array(hypothesis.shift)
        same = last[0] == hypothesis.fault and last[1] * hypothesis.size > 0
        before = last[2] if same else nothing
        for part in np.linspace(0.0, 1.0, SIZES_BETWEEN + 2)[1:]:
            faults.append(hypothesis.fault)
            shifts.append((1 - part) * before + part * shift)
        last = (hypothesis.fault, hypothesis.size, shift)
    return faults, np.array(shifts).reshape(len(faults), len(MODES), len(evidence.generators))

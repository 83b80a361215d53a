"""The residuals' baseline: a linear-Gaussian model of block means without a fault, and its Kalman filter.

The mean of a block of n ticks in mode m, of the K generators of the evidence, is

    y = offset_m + D_m a + b_m + G l + v + e,      e ~ N(0, V_m o part)

with the vehicle's offset, the drive's baseline along the model's own drifts a (viscosity, zeros of the sensors, level
in the tank; standard normal) and of each mean by itself b ~ N(0, allowance^2), and the visit's effect v ~ N(0, U_m),
drawn anew at every visit; a network's error adds to that of e (`core.decision.model_error`). Noise that residuals have
in common cancels in their differences where they could tell at the same ticks only, so `part`, element by element, is
1 / n there, and less where ticks of one are missing (`core.decision.blocks`). a, b and l move as
Ornstein-Uhlenbeck processes with the correlation time `DRIVE`, v with `VISIT`:

    x_k = F x_{k-1} + w,   F = exp(-dt / tau),   w ~ N(0, P_m - F P_m F),   P_m = diag(1, allowance^2, 1, U_m)

What a model lacks changes with the operation, as the effect of a fault does: without l, an hour of it is taken for
a small fault since the drive's start, and the surer the longer it lasts. So a fault-free drive looks as if it had
apparent faults l, standard normal. G are the shifts g_h by the smallest size of each fault in the operation of the
block, in such parts that in usual operation they are as far from zero as the baseline's own standard deviation:
g_h' P_0^-1 g_h = 1 with P_0 the covariance of all modes' means by a and b; that size is the largest part. Of networks,
whose answer to a bias is not linear in it, larger sizes are apparent faults as well.

All arrays have the logs first: B of them are filtered side by side, the vehicle's is B = 1.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from faultline.service.core.decision.blocks import Block
from faultline.service.core.manifest import Evidence
from faultline.service.core.signals.values import FloatArray
from faultline.service.core.time_scale import Span, TimeScale

VISIT = Span(settlings=0.75, periods=75)
"""Correlation time of a visit's effect: pulses of an actuator and the sampling beat, and a dose has a history."""

DRIVE = Span(settlings=6000, seconds=120_000)
"""Correlation time of the drive's baseline: in 600 s it moves by a tenth of how far drives differ."""


ROUNDING = 1e-12
"""The variance in parts of a baseline's largest one that stands for none, so that there is something to divide by."""


class GaussianState(NamedTuple):
    """Expected value (B, S) and covariance (B, S, S) of the baseline's state."""

    mean: FloatArray
    covariance: FloatArray


class Innovation(NamedTuple):
    """The whitened innovation of a block (B, K), and the matrices of the filter's step.

    `decay` (B, S) is the diagonal of F, `observe` (B, K, S) has zeros where nothing was seen, `gain` (B, S, K) is
    Kalman's, `whiten` (B, K, K) the inverse of the Cholesky factor of the innovation's covariance.
    """

    white: FloatArray
    decay: FloatArray
    observe: FloatArray
    gain: FloatArray
    whiten: FloatArray

    @property
    def log_density(self) -> FloatArray:
        """Return the log density of the block's means (B,), but for a constant."""
        scale = np.diagonal(self.whiten, axis1=1, axis2=2)
        return np.asarray(np.log(scale).sum(axis=1) - (self.white**2).sum(axis=1) / 2.0)


class BaselineModel:
    """The matrices of the model, by operating mode; row 0 of each, the edge, is not used."""

    def __init__(self, evidence: Evidence, time: TimeScale) -> None:
        self.offset = np.array(evidence.offset)  # (1 + C, K)
        self.noise = np.array(evidence.noise)  # (1 + C, K, K), of a tick
        modes, K = self.offset.shape
        drifts = np.array(evidence.drifts).reshape(-1, modes, K)
        allowance = np.array(evidence.allowance)
        usual = {k: np.array(h.usual) for k, h in enumerate(evidence.hypotheses) if h.usual is not None}
        self.apparent_rows = np.array([*usual], dtype=np.intp)  # of the hypotheses (L,)
        self.apparent_part = _parts(usual.values(), drifts[:, 1:], allowance[1:])  # (L,)
        R, L, own = len(drifts), len(usual), (modes - 1) * K
        self.states = R + own + L + K
        self.apparent, self.visit = slice(R + own, R + own + L), slice(R + own + L, self.states)
        self.tau = np.full(self.states, time.seconds(DRIVE))
        self.tau[self.visit] = time.seconds(VISIT)
        self.observe = np.zeros((modes, K, self.states))
        self.stationary = np.zeros((modes, self.states, self.states))
        variances = [np.ones(R), allowance[1:].ravel() ** 2, np.ones(L), np.zeros(K)]
        self.stationary[:] = np.diag(np.concatenate(variances))
        self.stationary[:, self.visit, self.visit] = np.array(evidence.visit)
        for mode in range(1, modes):
            self.observe[mode, :, :R] = drifts[:, mode].T
            self.observe[mode, :, R + (mode - 1) * K : R + mode * K] = np.eye(K)
            for column, (shift, part) in enumerate(zip(usual.values(), self.apparent_part, strict=True), R + own):
                self.observe[mode, :, column] = part * shift[mode]
            self.observe[mode, :, self.visit] = np.eye(K)

        steady = self.observe[1:].copy()
        steady[..., self.visit] = 0.0
        self.usual = steady.reshape(-1, self.states)  # (D, S), of all modes in usual operation, without visits

    def prior(self, logs: int) -> GaussianState:
        """Return the state before a drive has begun."""
        covariance = np.repeat(self.stationary[1][None], logs, axis=0)
        covariance[:, self.visit, self.visit] = 0.0
        return GaussianState(np.zeros((logs, self.states)), covariance)

    def observed(self, block: Block) -> FloatArray:
        """Return how the state shows in the means of a block (B, K, S), in its operation."""
        H = self.observe[block.mode]
        H[..., self.apparent] = (block.shift[:, self.apparent_rows] * self.apparent_part[:, None]).swapaxes(1, 2)
        return H

    def levels(self, state: GaussianState) -> tuple[FloatArray, FloatArray]:
        """Return where the drive puts the means (B, D) in usual operation, modes stacked, and their covariance."""
        return state.mean @ self.usual.T, self.usual @ state.covariance @ self.usual.T


def _parts(usual: Iterable[FloatArray], drifts: FloatArray, allowance: FloatArray) -> FloatArray:
    """Return the parts (L,) of shifts (modes, K) that are one standard deviation of the baseline, 1 at most."""
    D = drifts.reshape(len(drifts), allowance.size)
    P0 = np.diag(allowance.ravel() ** 2) + D.T @ D
    least = max(ROUNDING * P0.diagonal().max(), 1e-30)  # where nothing strays parts are 0
    P0 += least * np.eye(len(P0))
    g = np.array([shift[1:].ravel() for shift in usual]).reshape(-1, len(P0))
    squares = (g * np.linalg.solve(P0, g.T).T).sum(axis=1)
    return np.asarray(1.0 / np.sqrt(np.maximum(squares, 1.0)))


class BaselineFilter:
    """The Kalman filter of B drives that have no fault."""

    def __init__(self, model: BaselineModel, logs: int = 1) -> None:
        self.model = model
        self.state = model.prior(logs)
        self.end_s = np.zeros(logs)

    def step(self, block: Block) -> Innovation:
        """Advance to the end of a block and take it in."""
        model, mode = self.model, block.mode
        F = np.exp((self.end_s - block.end_s)[:, None] / model.tau)
        self.end_s = block.end_s
        F[:, model.visit] *= ~block.begins[:, None]
        FF = F[:, :, None] * F[:, None, :]
        mean = F * self.state.mean
        P = FF * self.state.covariance + (1.0 - FF) * model.stationary[mode]
        seen = block.ticks > 0
        H = model.observed(block) * seen[..., None]
        noise = model.noise[mode] * block.part
        noise += block.excess[:, :, None] * np.eye(seen.shape[1])
        R = np.where(seen[:, :, None] & seen[:, None, :], noise, np.eye(seen.shape[1]))
        PH = P @ H.swapaxes(1, 2)
        S = H @ PH + R
        whiten = np.linalg.inv(np.linalg.cholesky(S))
        gain = PH @ whiten.swapaxes(1, 2) @ whiten
        innovation = np.where(seen, block.mean - model.offset[mode], 0.0) - (H @ mean[..., None])[..., 0]
        mean = mean + (gain @ innovation[..., None])[..., 0]
        P = P - gain @ PH.swapaxes(1, 2)
        self.state = GaussianState(mean, (P + P.swapaxes(1, 2)) / 2.0)
        return Innovation((whiten @ innovation[..., None])[..., 0], F, H, gain, whiten)


def signature(
    effect: FloatArray, innovation: Innovation, shift: FloatArray, seen: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return how far shifts of the means have moved the filter's state, and how far the whitened innovation.

    `effect` (B, ..., S) is the former before the block, `shift` (B, ..., K) what the block's means are shifted by,
    `seen` (B, K) 0 where nothing was seen (Willsky and Jones, IEEE Trans. Automatic Control 21, 1976, eqs. 12 to 16).
    """
    shape = (len(shift), *[1] * (shift.ndim - 2))
    effect = effect * innovation.decay.reshape(*shape, -1)
    moved = shift * seen.reshape(*shape, -1) - _dot(effect, innovation.observe)
    return effect + _dot(moved, innovation.gain), _dot(moved, innovation.whiten)


def _dot(rows: FloatArray, matrix: FloatArray) -> FloatArray:
    """The products of a log's matrix (B, M, N) with all of its rows (B, ..., N): (B, ..., M)."""
    flat = rows.reshape(len(rows), -1, rows.shape[-1])
    return np.asarray((flat @ matrix.swapaxes(1, 2)).reshape(*rows.shape[:-1], -1))

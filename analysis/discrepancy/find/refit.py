"""The fit again, with an unknown input taken out: where the parameters go when they need not absorb a missing effect.

A fit without the effect may be far from where it would be with it; there the derivatives mislead. A few steps of the
Gauss-Newton method with the input's covariance added to the noise bring it back.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.noise import Weigh
from faultline.analysis.calibration.problem import Problem
from faultline.analysis.discrepancy.find.latent import Latent, Response
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]

STEPS = 6
ENOUGH = 2.0
"""A step that lowers the cost (a chi square) by less is the last."""

SHORTEST = 0.05
"""A part of the step; if that does not help either, there is no better place near."""

FAINT = 1e-10
"""Relative power of directions that are nothing but rounding."""


def without(problem: Problem, x: Array, weights: Sequence[Weigh], response: Response, latent: Latent) -> Array:
    """The x that is most likely with the input of `latent` unknown, from `x` on."""
    lessening = _Lessening(response, latent)

    def cost(x: Array) -> tuple[float, list[Array]]:
        e = [white(part) for white, part in zip(weights, problem.left(x), strict=True)]
        return float(sum(part @ part for part in e) - np.sum(lessening.of(e) ** 2) + x @ x), e

    least, e = cost(x)
    for _ in range(STEPS):
        J = [white(part) for white, part in zip(weights, problem.slopes(x), strict=True)]
        M = lessening.of(J)
        H = sum((part.T @ part for part in J), np.eye(len(x))) - M.T @ M
        gradient = sum((a.T @ b for a, b in zip(J, e, strict=True)), x) - M.T @ lessening.of(e)
        step, share, before = -np.linalg.solve(H, gradient), 1.0, least
        while share >= SHORTEST:
            trial = np.clip(x + share * step, *problem.bounds)
            try:
                value, left = cost(trial)
            except InputError:  # too far: the model cannot be run there
                value = np.inf
            if value < least:
                x, least, e = trial, value, left
                break
            share /= 2.0
        if before - least < ENOUGH:
            break
    return x


class _Lessening:
    """U' for which (I + sigma^2 D R R' D')^(-1) = I - U U', D not projected."""

    def __init__(self, response: Response, latent: Latent) -> None:
        T = latent.scaled_root
        self._parts = list(response.parts)
        self._widths = np.cumsum([part.shape[1] for part in self._parts])[:-1]
        power, V = np.linalg.eigh(T.T @ response.own_gram @ T)
        seen = power > FAINT * max(float(power.max()), 1e-300)
        self._T = T @ V[:, seen] / np.sqrt(1.0 + power[seen])

    def of(self, values: Sequence[Array]) -> Array:
        """U' of values (N, ...) by section."""
        pulled = [part.T @ value for part, value in zip(self._parts, values, strict=True)]
        return np.asarray(self._T.T @ np.concatenate(pulled))

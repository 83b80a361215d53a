"""Residuals under an assumed fault: a few generators once per hypothesis, with the fault built in.

A hypothesis is a fault of one size. Its generators are fed with the samples of the moment, as those without fault are:

    r_h = y - y_hat_h,   x_h <- graph_h(z, x_h)        z: (H, nz)  x: (H, nx) -> r: (H, K), x_next: (H, nx)

so that r - r_h is what that fault does to the residuals in this very operation. Averages over other drives do as well
where a vehicle runs as it did then; under a fault that moves the operation, or on a system that wanders, they do not.
"""

from typing import Protocol

import numpy as np

from faultline.service.core.signals.values import FloatArray, Indices, Mask


class Stepped(Protocol):
    """A fused graph (`core.residuals.generators.Graph`)."""

    def __call__(self, **arrays: FloatArray) -> list[FloatArray]:
        """r, y_hat, sigma, x_next."""


class Assumed:
    """H hypotheses of K generators. State: theirs, `x` (H, nx); `owner` (nx,) says which generator each column is of.

    A hypothesis that cannot be computed shifts nothing at that tick, and begins again from the sensors.
    """

    def __init__(self, graph: Stepped, hypotheses: int, owner: Indices) -> None:
        self._graph = graph
        self._owner = owner
        self.x = np.zeros((hypotheses, len(owner)))

    def restart(self, generators: Mask, fresh: FloatArray) -> None:
        """Takes the states of these generators (K,) from the sensors, as `fresh` (nx,) has them."""
        self.x = np.where(generators[self._owner], fresh, self.x)

    def step(self, z: FloatArray, fresh: FloatArray, r: FloatArray, advanced: Mask) -> FloatArray:
        """Shifts (H, K) of the residuals `r` (K,) at the samples `z` (nz,); only `advanced` (K,) states move on."""
        same = np.empty((len(self.x), len(z)))
        same[:] = z
        assumed, _, _, x = self._graph(z=same, x=self.x)
        if np.isfinite(assumed).all() and np.isfinite(x).all():
            self.x = np.where(advanced[self._owner], x, self.x)
            return np.asarray(r - assumed)
        good = np.asarray(np.isfinite(assumed).all(axis=1) & np.isfinite(x).all(axis=1))
        self.x = np.where(advanced[self._owner], np.where(good[:, None], x, fresh), self.x)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.where(good[:, None], r - assumed, 0.0))

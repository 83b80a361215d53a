"""Runs the residual generators of a bundle, all in one fused graph, one tick at a time.

    x_k, r_k, y_hat_k, sigma_k, novelty_k = graph(z_k, x_{k-1})      z: (1, nz)  x: (1, nx)  r ...: (1, T)

A generator whose input may not be used, or lies outside the operating region, keeps its state for `HELD_TICKS` ticks;
after that the state is taken from the sensors again and the warm-up starts anew: a state carried through where the
model does not hold would tell of that for as long as the slowest pressure remembers.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import onnxruntime as ort

from service.core.manifest import Generator, Input
from service.core.signals import Mask, Vector

HELD_TICKS = 2
NOVELTY_LIMIT = 0.01
"""Novelty is how far the inputs lie outside their operating region, in parts of its width; a hundredth is rounding."""


class Residuals(NamedTuple):
    """One tick of all generators, each (T,): residual, prediction, spread [unit of y], and whether it can tell."""

    r: Vector
    y_hat: Vector
    sigma: Vector
    usable: Mask


class Graph:
    """A fused graph as a function: z (B, nz), x (B, nx) -> r, y_hat, sigma, novelty (B, T), x_next (B, nx), float64."""

    OUTPUTS = ("r", "y_hat", "sigma", "novelty", "x_next")

    def __init__(self, model: bytes) -> None:
        options = ort.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 3
        self._session = ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])

    def __call__(self, **arrays: Vector) -> list[Vector]:
        """The outputs in the order of `OUTPUTS`."""
        outputs: list[Vector] = self._session.run(self.OUTPUTS, arrays)
        return outputs


class GeneratorBank:
    """The generators of a bundle with their states. `step` is called once a tick."""

    def __init__(self, model: bytes, generators: Sequence[Generator], inputs: Sequence[Input]) -> None:
        self._graph = Graph(model)
        names = [channel.signal for channel in inputs]
        self._neutral = np.array([(channel.lower + channel.upper) / 2 for channel in inputs])
        states = [(row, state) for row, generator in enumerate(generators) for state in generator.states]
        self._owner = np.array([row for row, _ in states], dtype=np.intp)  # (nx,)
        self._offset = np.array([state.offset for _, state in states])
        self._gain = np.zeros((len(states), len(names)))
        self._needs = np.zeros((len(generators), len(names)), dtype=np.bool_)
        for column, (_, state) in enumerate(states):
            for signal, gain in state.gain.items():
                self._gain[column, names.index(signal)] = gain
        for row, generator in enumerate(generators):
            self._needs[row, [names.index(signal) for signal in generator.inputs]] = True
        self._warm_up = np.array([generator.warm_up_ticks for generator in generators])
        self._x = np.zeros(len(states))
        self._z = self._neutral.copy()
        self._missed = np.full(len(generators), HELD_TICKS + 1)
        self._ticks = np.zeros(len(generators), dtype=np.int64)

    def step(self, z: Vector, usable: Mask) -> Residuals:
        """Advances by one tick with the samples `z` (nz,), of which only the `usable` (nz,) ones are looked at."""
        self._z = np.where(usable, z, self._z)
        fed = (usable | ~self._needs).all(axis=1)  # (T,)
        self._restart(fed & (self._missed > HELD_TICKS))
        r, y_hat, sigma, novelty, x_next = (row[0] for row in self._graph(z=self._z[None], x=self._x[None]))
        finite = np.isfinite(r)
        finite[self._owner[~np.isfinite(x_next)]] = False
        advanced = fed & finite & (novelty <= NOVELTY_LIMIT)
        self._x = np.where(advanced[self._owner], x_next, self._x)
        self._missed = np.where(advanced, 0, self._missed + 1)
        self._missed[fed & ~finite] = HELD_TICKS + 1
        self._ticks = np.where(advanced, self._ticks + 1, self._ticks)
        return Residuals(r, y_hat, sigma, advanced & (self._ticks > self._warm_up))

    def _restart(self, generators: Mask) -> None:
        """Takes the states of these generators (T,) from the sensors and starts their warm-up anew."""
        if generators.any():
            fresh = self._offset + self._gain @ self._z
            self._x = np.where(generators[self._owner], fresh, self._x)
            self._ticks[generators] = 0

"""Runs the residual generators of a bundle, in a few fused graphs, one tick at a time.

    x_k, r_k, y_hat_k, sigma_k = graph(z_k, x_{k-1})      z: (1, nz)  x: (1, nx)  r ...: (1, T)

A generator whose input may not be used, or lies outside the operating region, keeps its state for `HELD_TICKS` ticks;
after that the state is taken from the sensors again and the warm-up starts anew: a state carried through where the
model does not hold would tell of that for as long as the slowest pressure remembers. Where samples that were held back
turn out to be a step, the ticks since are computed again with them. A generator that was trained says besides how large
its error may be (`core.decision.model_error`).
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import onnxruntime as ort

from faultline.service.core.manifest import Evidence, Generator, Input
from faultline.service.core.residuals.assumed import Assumed
from faultline.service.core.residuals.table import table_of
from faultline.service.core.signals.gate import SAMPLES, Gate
from faultline.service.core.signals.values import FloatArray, Indices, Mask

HELD_TICKS = 2
OUTSIDE = 0.01
"""How far inputs may lie outside their operating region, in parts of its width: a hundredth is rounding."""

MOST_DOUBTFUL = 2 * SAMPLES
"""Ticks that are computed again at most: a step is known after half of `SAMPLES`, and others may overlap with it."""


NOTHING, NOWHERE = np.zeros((0, 0)), np.zeros(0, dtype=np.bool_)
NOT_HELD = np.zeros((), dtype=np.bool_)
FRESH = np.zeros(())
NO_EXCESS = np.zeros(())


class Residuals(NamedTuple):
    """One tick of all generators, each (T,): residual, prediction, spread [unit of y], and whether it can tell.

    Or n ticks in a row: then all arrays have the ticks first.

    `shift` (H, K) is what each hypothesis does to the residuals of the evidence generators, where a bundle has any.
    `brought` (n,) are the consequences of the evidence that show or did lately. `level` are the residuals without the
    drive's baseline (`core.decision.baseline_level`), once that is taken off. Those are `held` (T,) that rest on
    a sample which the gate has replaced, or on one from before a lost frame. `excess` (T,) is the variance of their
    error beyond that of usual operation (`core.decision.model_error`), once that is known.
    """

    r: FloatArray
    y_hat: FloatArray
    sigma: FloatArray
    usable: Mask
    shift: FloatArray = NOTHING
    brought: Mask = NOWHERE
    level: FloatArray | None = None
    held: Mask = NOT_HELD
    excess: FloatArray = NO_EXCESS

    @property
    def counted(self) -> Mask:
        """The residuals (T,) that are evidence: of tests that can tell, from samples that were received."""
        return np.asarray(self.usable & ~self.held)

    @property
    def in_a_row(self) -> "Residuals":
        """Return a tick as the only one of a row."""
        return self._replaced(lambda each: each[None])

    def part(self, begin: int, end: int) -> "Residuals":
        """Return some of the ticks of a row."""
        if begin == 0 and end >= len(self.r):
            return self
        return self._replaced(lambda each: each[begin:end])

    def at(self, k: int) -> "Residuals":
        """Return one of the ticks of a row."""
        return self._replaced(lambda each: each[k])

    def _replaced(self, of: Callable[[Any], Any]) -> "Residuals":
        return Residuals(
            of(self.r),
            of(self.y_hat),
            of(self.sigma),
            of(self.usable),
            of(self.shift),
            of(self.brought),
            None if self.level is None else of(self.level),
            of(self.held),
            of(self.excess) if self.excess.ndim else self.excess,
        )


class Graph:
    """A fused graph as a function: z (B, nz), x (B, nx) -> r, y_hat, sigma (B, T), x_next (B, nx), float64."""

    OUTPUTS = ("r", "y_hat", "sigma", "x_next")

    def __init__(self, model: bytes) -> None:
        options = ort.SessionOptions()
        options.intra_op_num_threads = 1
        options.inter_op_num_threads = 1
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.log_severity_level = 3
        self._session = ort.InferenceSession(model, options, providers=["CPUExecutionProvider"])

    def __call__(self, **arrays: FloatArray) -> list[FloatArray]:
        """The outputs in the order of `OUTPUTS`."""
        outputs: list[FloatArray] = self._session.run(self.OUTPUTS, arrays)
        return outputs


class Generators(Protocol):
    """Interface of the generators, called once a tick."""

    def step(self, z: FloatArray, usable: Mask, ages: FloatArray = FRESH) -> Residuals:
        """Advances by one tick with the samples `z` (nz,), of which only the `usable` (nz,) ones are looked at.

        `ages` (nz,) are the times [s] since they were received.
        """


class _Part(NamedTuple):
    """A graph, and which states are its own."""

    graph: Graph
    states: slice


class GeneratorBank:
    """The generators of a bundle with their states. `step` is called once a tick.

    `graphs` are by the name that the generators have; those of one graph are neighbours, in the order of its columns.
    The hypotheses of the `evidence`, where it has some, run beside them.
    """

    def __init__(
        self,
        graphs: Mapping[str, bytes],
        generators: Sequence[Generator],
        inputs: Sequence[Input],
        period_s: float,
        evidence: Evidence | None = None,
    ) -> None:
        self._parts = _parts(graphs, generators)
        self._of = table_of(generators, inputs, period_s, evidence)
        self._x = np.zeros(len(self._of.owner))
        self._z = (self._of.lower + self._of.upper) / 2
        self._gate = Gate(inputs)
        self._missed = np.full(len(generators), HELD_TICKS + 1)
        self._ticks = np.zeros(len(generators), dtype=np.int64)
        self._since_shown = np.full(len(self._of.consequences), self._of.warm_up.max() + 1)
        self._assumed: Assumed | None = None
        if evidence is not None and evidence.graph is not None:
            hypotheses = Graph(graphs[evidence.graph])
            self._assumed = Assumed(hypotheses, len(evidence.hypotheses), self._of.own_owner)
        self._doubtful: list[tuple[FloatArray, FloatArray, Mask]] = []
        self._before = self._state()

    def step(self, z: FloatArray, usable: Mask, ages: FloatArray = FRESH) -> Residuals:
        """Advances by one tick with the samples `z` (nz,), of which only the `usable` (nz,) ones are looked at.

        `ages` (nz,) are the times [s] since they were received. What is computed from a stale one is not counted: the
        operation may have changed since.
        """
        passed = self._gate.passed(z, usable)
        self._reconsider(z, passed, usable)
        found = self._advance(passed, usable)
        held = np.asarray((self._of.needs & (self._gate.held | (ages > self._of.stale))).any(axis=1))
        return found._replace(held=held)

    def _reconsider(self, z: FloatArray, passed: FloatArray, usable: Mask) -> None:
        """Compute the ticks again whose samples were held back and were a step; remember the tick if one is held."""
        if (stepped := self._gate.stepped).any() and self._doubtful:
            self._doubtful = [(raw, np.where(stepped, raw, taken), was) for raw, taken, was in self._doubtful]
            self._restore(self._before)
            for _, taken, was_usable in self._doubtful:
                self._advance(taken, was_usable)
        if not self._gate.held.any() or len(self._doubtful) == MOST_DOUBTFUL:
            self._doubtful = []
        if self._gate.held.any():
            if not self._doubtful:
                self._before = self._state()
            self._doubtful.append((z, passed, usable))

    def _advance(self, z: FloatArray, usable: Mask) -> Residuals:
        """Advance by one tick with these samples."""
        self._z = np.where(usable, z, self._z)
        fed = (usable | ~self._of.needs).all(axis=1)  # (T,)
        fresh = self._of.offset + self._of.gain @ self._z
        self._restart(fed & (self._missed > HELD_TICKS), fresh)
        r, y_hat, sigma, x_next = self._run()
        finite = np.isfinite(r) & np.isfinite(sigma)
        finite[self._of.owner[~np.isfinite(x_next)]] = False
        advanced = fed & finite & (self._outside() <= OUTSIDE)
        self._x = np.where(advanced[self._of.owner], x_next, self._x)
        self._missed = np.where(advanced, 0, self._missed + 1)
        self._missed[fed & ~finite] = HELD_TICKS + 1
        self._ticks = np.where(advanced, self._ticks + 1, self._ticks)
        shift = NOTHING
        if self._assumed is not None:
            shift = self._assumed.step(self._z, fresh[self._of.own], r[self._of.weighed], advanced[self._of.weighed])
        told = advanced & (self._ticks > self._of.warm_up)
        return Residuals(r, y_hat, sigma, told, shift, self._brought())

    def _state(self) -> tuple[FloatArray, FloatArray, Indices, Indices, Indices, FloatArray]:
        """What a tick leaves to the next one."""
        assumed = NOTHING if self._assumed is None else self._assumed.x
        return self._x, self._z, self._missed, self._ticks, self._since_shown, assumed

    def _restore(self, state: tuple[FloatArray, FloatArray, Indices, Indices, Indices, FloatArray]) -> None:
        self._x, self._z, self._missed, self._ticks, self._since_shown, assumed = state
        if self._assumed is not None:
            self._assumed.x = assumed

    def _brought(self) -> Mask:
        """The consequences that show, or did so lately that states of the generators remember it."""
        shows = self._of.consequences.holding(self._z)
        self._since_shown = np.where(shows, 0, self._since_shown + 1)
        return np.asarray(self._since_shown <= self._of.warm_up.max())

    def _run(self) -> list[FloatArray]:
        """The outputs of all graphs, one after the other."""
        z = self._z[None]
        found = [part.graph(z=z, x=self._x[None, part.states]) for part in self._parts]
        if len(found) == 1:
            return [row[0] for row in found[0]]
        return [np.concatenate([outputs[k][0] for outputs in found]) for k in range(len(Graph.OUTPUTS))]

    def _outside(self) -> FloatArray:
        """Return how far the inputs of each generator lie outside the region, in parts of its width, summed (T,)."""
        of = self._of
        beyond = np.maximum(of.lower - self._z, self._z - of.upper) / (of.upper - of.lower)
        return np.asarray(self._of.needs @ np.maximum(beyond, 0.0))

    def _restart(self, generators: Mask, fresh: FloatArray) -> None:
        """Takes the states of these generators (T,) from the sensors and starts their warm-up anew."""
        if generators.any():
            self._x = np.where(generators[self._of.owner], fresh, self._x)
            self._ticks = np.where(generators, 0, self._ticks)
            if self._assumed is not None:
                self._assumed.restart(generators[self._of.weighed], fresh[self._of.own])


def _parts(graphs: Mapping[str, bytes], generators: Sequence[Generator]) -> list[_Part]:
    found = []
    for name in dict.fromkeys(generator.graph for generator in generators):
        own = [row for row, generator in enumerate(generators) if generator.graph == name]
        counts = [len(generator.states) for generator in generators]
        found.append(_Part(Graph(graphs[name]), slice(sum(counts[: own[0]]), sum(counts[: own[-1] + 1]))))
    return found

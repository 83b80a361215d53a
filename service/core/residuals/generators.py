"""Runs the residual generators of a bundle, in a few fused graphs, one tick at a time.

    x_k, r_k, y_hat_k, sigma_k = graph(z_k, x_{k-1})      z: (1, nz)  x: (1, nx)  r ...: (1, T)

A generator whose input may not be used, or lies outside the operating region, keeps its state for `HELD_TICKS` ticks;
after that the state is taken from the sensors again and the warm-up starts anew: a state carried through where the
model does not hold would tell of that for as long as the slowest pressure remembers. Where samples that were held back
turn out to be a step, the ticks since are computed again with them. A generator that was trained says besides how large
its error may be (`core.decision.model_error`).
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np
import onnxruntime as ort

from faultline.service.core.manifest import Evidence, Generator, Input
from faultline.service.core.residuals.assumed import Assumed
from faultline.service.core.signals.gate import SAMPLES, Gate
from faultline.service.core.signals.regions import Regions
from faultline.service.core.signals.values import FloatArray, Indices, Mask
from faultline.service.core.time_scale import ticks_of

HELD_TICKS = 2
OUTSIDE = 0.01
"""How far inputs may lie outside their operating region, in parts of its width: a hundredth is rounding."""

STALE = 0.3
"""A sample older than this part of its `maximum_age_s`, of five periods, stands for one or more that were lost."""

MOST_DOUBTFUL = 2 * SAMPLES
"""Ticks that are computed again at most: a step is known after half of `SAMPLES`, and others may overlap with it."""


NOTHING, NOWHERE = np.zeros((0, 0)), np.zeros(0, dtype=np.bool_)
NOT_HELD = np.zeros((), dtype=np.bool_)
FRESH = np.zeros(())
NO_EXCESS = np.zeros(())


class Residuals(NamedTuple):
    """One tick of all generators, each (T,): residual, prediction, spread [unit of y], and whether it can tell.

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
        names = [channel.signal for channel in inputs]
        lower, upper = (np.array([getattr(channel, bound) for channel in inputs]) for bound in ("lower", "upper"))
        self._lower, self._upper, self._width = lower, upper, upper - lower
        self._neutral = (lower + upper) / 2
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
        self._warm_up = np.array([ticks_of(generator.warm_up_s, period_s) for generator in generators])
        self._x = np.zeros(len(states))
        self._z = self._neutral.copy()
        self._gate = Gate(inputs)
        self._stale = STALE * np.array([channel.maximum_age_s for channel in inputs])
        self._missed = np.full(len(generators), HELD_TICKS + 1)
        self._ticks = np.zeros(len(generators), dtype=np.int64)
        consequences = [] if evidence is None else evidence.consequences
        self._consequences = Regions([each.where for each in consequences], inputs)
        self._since_shown = np.full(len(consequences), self._warm_up.max() + 1)
        self._weighed, self._own, self._assumed = _assumed(graphs, generators, evidence, self._owner)
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
        held = np.asarray((self._needs & (self._gate.held | (ages > self._stale))).any(axis=1))
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
        fed = (usable | ~self._needs).all(axis=1)  # (T,)
        fresh = self._offset + self._gain @ self._z
        self._restart(fed & (self._missed > HELD_TICKS), fresh)
        r, y_hat, sigma, x_next = self._run()
        finite = np.isfinite(r) & np.isfinite(sigma)
        finite[self._owner[~np.isfinite(x_next)]] = False
        advanced = fed & finite & (self._outside() <= OUTSIDE)
        self._x = np.where(advanced[self._owner], x_next, self._x)
        self._missed = np.where(advanced, 0, self._missed + 1)
        self._missed[fed & ~finite] = HELD_TICKS + 1
        self._ticks = np.where(advanced, self._ticks + 1, self._ticks)
        shift = NOTHING
        if self._assumed is not None:
            shift = self._assumed.step(self._z, fresh[self._own], r[self._weighed], advanced[self._weighed])
        told = advanced & (self._ticks > self._warm_up)
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
        shows = self._consequences.holding(self._z)
        self._since_shown = np.where(shows, 0, self._since_shown + 1)
        return np.asarray(self._since_shown <= self._warm_up.max())

    def _run(self) -> list[FloatArray]:
        """The outputs of all graphs, one after the other."""
        z = self._z[None]
        found = [part.graph(z=z, x=self._x[None, part.states]) for part in self._parts]
        if len(found) == 1:
            return [row[0] for row in found[0]]
        return [np.concatenate([outputs[k][0] for outputs in found]) for k in range(len(Graph.OUTPUTS))]

    def _outside(self) -> FloatArray:
        """Return how far the inputs of each generator lie outside the region, in parts of its width, summed (T,)."""
        beyond = np.maximum(self._lower - self._z, self._z - self._upper) / self._width
        return np.asarray(self._needs @ np.maximum(beyond, 0.0))

    def _restart(self, generators: Mask, fresh: FloatArray) -> None:
        """Takes the states of these generators (T,) from the sensors and starts their warm-up anew."""
        if generators.any():
            self._x = np.where(generators[self._owner], fresh, self._x)
            self._ticks = np.where(generators, 0, self._ticks)
            if self._assumed is not None:
                self._assumed.restart(generators[self._weighed], fresh[self._own])


def _parts(graphs: Mapping[str, bytes], generators: Sequence[Generator]) -> list[_Part]:
    found = []
    for name in dict.fromkeys(generator.graph for generator in generators):
        own = [row for row, generator in enumerate(generators) if generator.graph == name]
        counts = [len(generator.states) for generator in generators]
        found.append(_Part(Graph(graphs[name]), slice(sum(counts[: own[0]]), sum(counts[: own[-1] + 1]))))
    return found


def _assumed(
    graphs: Mapping[str, bytes], generators: Sequence[Generator], evidence: Evidence | None, owner: Indices
) -> tuple[Indices, Indices, Assumed | None]:
    """The rows (K,) of the evidence generators, the columns (nx,) of their states, and their hypotheses."""
    if evidence is None or evidence.graph is None:
        nothing = np.zeros(0, dtype=np.intp)
        return nothing, nothing, None
    names = [generator.name for generator in generators]
    rows = np.array([names.index(name) for name in evidence.generators])
    own = np.concatenate([np.flatnonzero(owner == row) for row in rows])
    columns = np.repeat(np.arange(len(rows)), [len(generators[row].states) for row in rows])
    return rows, own, Assumed(Graph(graphs[evidence.graph]), len(evidence.hypotheses), columns)

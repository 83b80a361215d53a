"""A bundle's gate, modes and residual generators as native code: an `Evaluator` of blocks of ticks."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import Any, Protocol

import numba
import numpy as np

from faultline.analysis.compiled import driver
from faultline.analysis.compiled.elements import NotCompiledError
from faultline.analysis.compiled.kernels import Kernels, kernels_of
from faultline.analysis.compiled.source import OF_HYPOTHESES, OF_TESTS
from faultline.service.bundle.load import Bundle
from faultline.service.core.manifest import Evidence, Generator, Input, Modes
from faultline.service.core.residuals.generators import HELD_TICKS, MOST_DOUBTFUL, Residuals
from faultline.service.core.residuals.table import GeneratorTable, table_of
from faultline.service.core.signals.gate import SAMPLES, Gate
from faultline.service.core.signals.modes import ModeTracker
from faultline.service.core.signals.values import FloatArray, Indices, Mask

BLOCK = 512
"""Ticks that are computed at once: the shifts of 100 hypotheses of 4 tests are 1.6 MB then."""

Run = Callable[..., None]


class Evaluated(Protocol):
    """Interface of what says which generators, modes and hypotheses there are, as a manifest does."""

    @property
    def generators(self) -> Sequence[Generator]:
        """Return the residual generators."""

    @property
    def inputs(self) -> Sequence[Input]:
        """Return the signals that they take."""

    @property
    def modes(self) -> Modes:
        """Return the rules of the operating modes."""

    @property
    def period_s(self) -> float:
        """Return the time from tick to tick [s]."""

    @property
    def evidence(self) -> Evidence | None:
        """Return the evidence with its hypotheses; None where there is none."""


class CompiledEvaluator:
    """Evaluates ticks by compiled functions, to within rounding as `core.residuals.evaluator.TickByTick` does."""

    def __init__(self, what: Evaluated, kernels: Kernels) -> None:
        of = table_of(what.generators, what.inputs, what.period_s, what.evidence)
        self._kernels = kernels
        self._gate = _gate(what.inputs)
        self._modes = _modes(what.modes, what.inputs, what.period_s)
        self._of = _generators(of, kernels)
        hypotheses = len(what.evidence.hypotheses) if what.evidence is not None and len(of.weighed) else 0
        self._state, self._before = _state(of, hypotheses), _state(of, hypotheses)
        nz, nx, T, K = len(what.inputs), len(of.owner), len(what.generators), len(of.weighed)
        shape = MOST_DOUBTFUL, nz
        self._doubtful = driver.Doubtful(np.zeros(shape), np.zeros(shape), _flags(shape), _counts(1))
        rows = (np.zeros((count, hypotheses)) for count in (K, len(of.own)))
        self._row = driver.Row(np.zeros(T), np.zeros(T), np.zeros(T), np.zeros(nx), *rows)

    def evaluate(self, z: FloatArray, usable: Mask, ages: FloatArray) -> Iterator[tuple[Indices, Residuals]]:
        """Yield the modes (m,) and residuals of blocks of the n ticks of samples (n, nz), as `Evaluator` does."""
        for begin in range(0, len(z), BLOCK):
            part = slice(begin, begin + BLOCK)
            yield self._block(z[part], usable[part], ages[part])

    def _block(self, z: FloatArray, usable: Mask, ages: FloatArray) -> tuple[Indices, Residuals]:
        n = len(z)
        z, usable, ages = np.ascontiguousarray(z), np.ascontiguousarray(usable), np.ascontiguousarray(ages)
        gated = driver.Gated(np.zeros(z.shape), _flags(z.shape), _flags(z.shape), _flags(z.shape))
        _compiled(driver.gate)(self._gate, z, usable, gated)
        modes = _counts(n)
        _compiled(driver.modes)(self._modes, usable, gated, modes)
        out = self._outputs(n)
        state = self._of, self._state, self._before, self._doubtful, self._row
        advance = _advance(*map(numba.typeof, (*state, gated, out)))
        advance(self._kernels.tests, self._kernels.hypotheses, *state, z, usable, ages, gated, out)
        shift = out.shift.swapaxes(1, 2)
        return modes, Residuals(out.r, out.y_hat, out.sigma, out.usable, shift, out.brought, held=out.held)

    def _outputs(self, n: int) -> driver.Outputs:
        tests = n, len(self._row.r)
        K, H = self._row.assumed.shape
        return driver.Outputs(
            r=np.zeros(tests),
            y_hat=np.zeros(tests),
            sigma=np.zeros(tests),
            usable=_flags(tests),
            held=_flags(tests),
            shift=np.zeros((n, K, H)),
            brought=_flags((n, len(self._state.since_shown))),
        )


def kernels_of_bundle(bundle: Bundle, *, compiling: bool = True) -> Kernels:
    """Return the functions of a bundle's graphs, compiled if they never were.

    Raises:
        NotCompiledError: the bundle has networks, or a graph with an operation that is not made into native code.
        ToCompileError: they never were, and nothing is to be compiled by this process.
        OSError: the user's cache cannot be written.
    """
    graphs = {generator.graph for generator in bundle.manifest.generators}
    if len(graphs) > 1:
        raise NotCompiledError(f"residual generators of {len(graphs)} graphs, and one is compiled")
    evidence = bundle.manifest.evidence
    hypotheses = None if evidence.graph is None else bundle.graphs[evidence.graph]
    return kernels_of(bundle.graphs[graphs.pop()], hypotheses, len(evidence.hypotheses), compiling=compiling)


@cache
def _compiled(function: Run) -> Run:
    compiled: Run = numba.njit(cache=True)(function)
    return compiled


@cache
def _advance(*types: Any) -> Run:
    """The function that advances, for these types of its arguments; graphs' functions are called by their address.

    So it is compiled once, and not once a bundle.
    """
    tests = numba.types.FunctionType(numba.types.void(*_types(OF_TESTS)))
    hypotheses = numba.types.FunctionType(numba.types.void(*_types(OF_HYPOTHESES)))
    samples, usable = numba.types.Array(numba.float64, 2, "C"), numba.types.Array(numba.boolean, 2, "C")
    *state, gated, out = types
    signature = numba.types.void(tests, hypotheses, *state, samples, usable, samples, gated, out)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", numba.errors.NumbaExperimentalFeatureWarning)
        function: Run = numba.njit(signature, cache=True, error_model="numpy")(driver.advance)
    return function


def _types(text: str) -> list[Any]:
    return [numba.types.Array(numba.float64, 1 + each.count(":,"), "C") for each in text.split(", float")]


def _gate(inputs: Sequence[Input]) -> driver.GateState:
    gate = Gate(inputs)
    size = len(gate.columns)
    last, passed, refused = np.zeros((SAMPLES, size)), np.zeros(size), np.zeros(size)
    return driver.GateState(gate.columns, gate.least, last, passed, refused, _counts(size), _flags(len(inputs)))


def _modes(modes: Modes, inputs: Sequence[Input], period_s: float) -> driver.ModesState:
    tracker = ModeTracker(modes, inputs, period_s)
    regions, order = tracker.regions, np.array(tracker.order)
    bounds = regions.above, regions.below, regions.needed
    return driver.ModesState(tracker.limit, *bounds, order, tracker.last, _counts(2), tracker.settle)


def _generators(of: GeneratorTable, kernels: Kernels) -> driver.Generators:
    return driver.Generators(
        of.lower,
        of.upper,
        of.needs,
        of.owner,
        of.offset,
        of.gain,
        of.warm_up,
        of.stale,
        of.consequences.above,
        of.consequences.below,
        of.weighed,
        of.own,
        of.own_owner,
        kernels.of_tests,
        kernels.of_hypotheses,
        kernels.table,
    )


def _state(of: GeneratorTable, hypotheses: int) -> driver.GeneratorState:
    """As the bundle's generators are before the first tick."""
    T = len(of.warm_up)
    missed, shown = np.full(T, HELD_TICKS + 1), np.full(len(of.consequences), of.warm_up.max() + 1)
    x, z, assumed = np.zeros(len(of.owner)), (of.lower + of.upper) / 2, np.zeros((len(of.own), hypotheses))
    return driver.GeneratorState(x, z, missed, _counts(T), shown, assumed)


def _counts(size: int) -> driver.Ints:
    return np.zeros(size, np.int64)


def _flags(shape: int | tuple[int, ...]) -> Mask:
    return np.zeros(shape, np.bool_)

"""The bank: all residual generators of a model as one graph, with what the manifest says of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import msgspec
import numpy as np
import numpy.typing as npt
import sympy as sp

from faultline.analysis.graph.formula import Formulas
from faultline.analysis.graph.linear import last
from faultline.analysis.graph.network import Evaluator, Network, flow_network
from faultline.analysis.graph.step import STACKED, Stacked, entries, stack, step_graph
from faultline.analysis.model import Model
from faultline.analysis.structure import Test, find_tests
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Generator, Input, State
from faultline.service.core.residuals.generators import Graph

GRAPH = "ode.onnx"
FAULTS = "faults.onnx"

OUTLIER = 6.0
"""Standard deviations of a sensor's noise: a sample that is nearer to those before it is no outlier."""

Array = npt.NDArray[np.float64]
Trial = Mapping[str, float]

MOST_REASONS, MOST_NAMES = 5, 12
"""The notes about tests that are left out give so many reasons, and so many names a reason."""


@dataclass(frozen=True)
class Bank:
    """The generators of a model; `sigma` (T,) is the spread [unit of y] the sensors alone give each residual.

    `left_out` are the tests that cannot be run, with the reason of each.
    """

    model: Model
    tests: tuple[Test, ...]
    inputs: tuple[Input, ...]
    generators: tuple[Generator, ...]
    networks: tuple[Network, ...]
    sigma: Array
    left_out: Mapping[str, str] = field(default_factory=dict)

    def notes(self) -> list[str]:
        """Lines about the tests that are left out, by reason."""
        reasons: dict[str, list[str]] = {}
        for name, reason in self.left_out.items():
            reasons.setdefault(reason, []).append(name)
        lines = [f"left out: {_some(names)}: {reason}" for reason, names in reasons.items()]
        rest = f"left out for {len(lines) - MOST_REASONS} more reasons; `faultline structure --tests` lists all tests"
        return [*lines[:MOST_REASONS], rest] if len(lines) > MOST_REASONS else lines

    @cached_property
    def evaluator(self) -> Evaluator:
        """The networks' matrices as functions of parameters and faults."""
        return Evaluator(self.networks, self.model)

    @property
    def units(self) -> tuple[str, ...]:
        """The unit of every test's residual: that of the signal it predicts."""
        return tuple(self.model.known[test.predicts].unit for test in self.tests)

    def only(self, rows: Sequence[int]) -> "Bank":
        """The bank of these tests alone."""
        generators, networks = tuple(self.generators[k] for k in rows), tuple(self.networks[k] for k in rows)
        tests = tuple(self.tests[k] for k in rows)
        return Bank(self.model, tests, self.inputs, generators, networks, self.sigma[list(rows)])

    def stacked(self, trials: Sequence[Trial]) -> Stacked:
        """The matrices for each trial, a mapping of parameters and faults that differ from the model's values."""
        return stack(self.evaluator(trials), self.model.period_s)

    def formulas(self, trials: Sequence[Trial]) -> Formulas:
        """The formulas of all networks, with the parameters and faults of each trial."""
        expressions = tuple(formula for network in self.networks for formula in network.formulas.values())
        readings = {row: network.reading for row, network in enumerate(self.networks) if network.reading != 0}
        used = {symbol.name for formula in (*expressions, *readings.values()) for symbol in formula.free_symbols}
        model = self.model
        parameters = tuple(name for name in (*model.parameters, *model.assumable) if name in used)
        nominal = {name: p.value for name, p in model.parameters.items()} | dict.fromkeys(model.assumable, 0.0)
        theta = np.array([[trial.get(name, nominal[name]) for trial in trials] for name in parameters])
        theta = theta.reshape(len(parameters), len(trials))
        states = tuple(last(network.test, state).name for network in self.networks for state in network.states)
        signals = tuple(channel.signal for channel in self.inputs)
        return Formulas(expressions, readings, signals, states, parameters, theta, model.name)

    def graph(self) -> bytes:
        """The ONNX graph of the model's own parameters, faults at zero.

        Raises:
            InputError: the model divides by parameters that are zero.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            stacked = self.stacked([{}])
        if not all(np.isfinite(getattr(stacked, name)).all() for name in STACKED):
            zero = ", ".join(name for name, p in self.model.parameters.items() if p.value == 0.0)
            raise InputError(
                f"{self.model.name}: divides by zero with these parameters ({zero} = 0); "
                "give them other values, or leave out the effect that they are of"
            )
        return self._graph([{}])

    def graph_of(self, trials: Sequence[Trial]) -> bytes:
        """The ONNX graph with each trial's parameters and faults built in: as many rows of a batch as trials."""
        return self._graph(trials)

    def _graph(self, trials: Sequence[Trial], pattern: Stacked | None = None) -> bytes:
        names = [channel.signal for channel in self.inputs]
        measured = np.array([[float(name == g.predicts) for g in self.generators] for name in names])
        stacked, formulas = self.stacked(trials), self.formulas(trials)
        return step_graph(stacked, measured, self.sigma, formulas, pattern=pattern)

    @cached_property
    def _pattern(self) -> Stacked:
        """The stacked matrices, not zero where an entry may be so; of a period by which nothing adds up to zero."""
        return stack(self.evaluator.structure, 0.5)

    @cached_property
    def _parametric(self) -> Graph:
        """The graph of the vehicle, with the matrices as inputs."""
        return Graph(self._graph([{}], self._pattern))

    def simulate(self, trials: Sequence[Trial], z: Array, x0: Array) -> Array:
        """Return the residuals (K, B, T) for B trials side by side, by the very graph of the vehicle.

        The samples `z` (K, nz) or (K, B, nz) and the states at the start `x0` (nx,) or (B, nx) are those of all trials
        or of each.
        """
        stacked = self.stacked(trials)
        matrices = {}
        for name in STACKED:
            rows, columns = entries(getattr(self._pattern, name))
            if len(rows):
                matrices[name] = np.ascontiguousarray(getattr(stacked, name)[:, rows, columns].T)
        theta = self.formulas(trials).theta
        if theta.size:
            matrices["theta"] = theta
        B, nz = len(trials), z.shape[-1]
        x = np.array(np.broadcast_to(x0, (B, x0.shape[-1])))
        samples = np.broadcast_to(z.reshape(len(z), -1, nz), (len(z), B, nz))
        r = np.empty((len(z), B, len(self.tests)))
        for k, sample in enumerate(samples):
            r[k], _, _, x = self._parametric(z=np.ascontiguousarray(sample), x=x, **matrices)
        return r

    @property
    def has_equations(self) -> bool:
        """Return True: its graph is that of the model's equations."""
        return True

    def start(self, z: Array) -> Array:
        """The states (nx,) that the samples `z` (nz,) of a tick give."""
        return started(self.generators, [channel.signal for channel in self.inputs], z)


def started(generators: Sequence[Generator], signals: Sequence[str], z: Array) -> Array:
    """Return the states (nx,) of generators that the samples `z` (nz,) of the `signals` give, by `State.gain`."""
    value = dict(zip(signals, z, strict=True))
    states = [state for generator in generators for state in generator.states]
    return np.array([s.offset + sum(gain * value[name] for name, gain in s.gain.items()) for s in states])


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return " ".join(names[:MOST_NAMES]) + more


def build_bank(model: Model) -> Bank:
    """The bank of every test of the model that has integral causality and that the implicit step can solve.

    Raises:
        InputError: there is no such test.
    """
    found = find_tests(model)
    left_out = {test.name: test.obstacle or "" for test in found if not isinstance(test, Test)}
    if len(left_out) == len(found):
        reasons = [f"{name}: {obstacle}" for name, obstacle in left_out.items()] or ["there is no redundancy"]
        raise InputError(
            f"{model.name}: no test can be run ({reasons[0]}); "
            "add a sensor or write the equation in another form (`faultline structure --tests` has all reasons)"
        )
    parts: list[_Part] = []
    refused: list[InputError] = []
    for test in found:
        if isinstance(test, Test):
            try:
                parts.append(_part(model, test))
            except InputError as error:
                refused.append(error)
                left_out[test.name] = str(error).removeprefix(f"{model.name}: ").removeprefix(f"{test.name}: ")
    if not parts:
        raise refused[0]
    return _bank(model, parts, left_out)


def bank_of(model: Model, tests: Sequence[Test]) -> Bank:
    """The bank of some tests of the model.

    Raises:
        InputError: the implicit step cannot solve one of them.
    """
    return _bank(model, [_part(model, test) for test in tests], {})


_Part = tuple[Test, Generator, Network]


def _part(model: Model, test: Test) -> _Part:
    return test, _generator(model, test), flow_network(model, test, list(model.known))


def _bank(model: Model, parts: Sequence[_Part], left_out: Mapping[str, str]) -> Bank:
    tests, generators, networks = zip(*parts, strict=True)
    sigma = np.array([model.known[test.predicts].noise for test in tests])
    return Bank(model, tests, gated(model, tests), generators, networks, sigma, left_out)


def gated(model: Model, tests: Sequence[Test]) -> tuple[Input, ...]:
    """The inputs down to where their sensors end, with the outlier distances of the model.

    A signal that a test predicts by equations has one by its noise where none is stated, unless its steps are edges
    between modes: it may be a command, which comes and goes as the operation wants.
    """
    predicted = {test.predicts for test in tests if test.equations} - model.modes.edges.keys()
    noisy = {name for name in predicted if model.known[name].noise > 0.0}
    found = []
    for each in inputs_of(model):
        known = model.known[each.signal]
        lower = each.lower if known.sensor_min is None else known.sensor_min
        by_noise = OUTLIER * known.noise if each.signal in noisy else None
        outlier = by_noise if known.outlier is None else known.outlier
        found.append(msgspec.structs.replace(each, lower=lower, outlier=outlier))
    return tuple(found)


def inputs_of(model: Model) -> tuple[Input, ...]:
    """The signals of the model as the vehicle takes them."""
    return tuple(
        Input(signal=name, unit=k.unit, maximum_age_s=model.maximum_age_s(name), lower=k.min, upper=k.max)
        for name, k in model.known.items()
    )


def _generator(model: Model, test: Test) -> Generator:
    return Generator(
        name=f"{test.name}.{'ode' if test.equations else 'given'}",
        test=test.name,
        graph=GRAPH,
        predicts=test.predicts,
        inputs=list(test.known),
        states=[state_of(model, test, name) for name in test.states],
        faults=list(test.faults),
        equations=list(test.equations),
        warm_up_s=model.warm_up_s,
    )


def state_of(model: Model, test: Test, name: str) -> State:
    """A state of the test by the first of its initial expressions that needs no signal from outside the test.

    Raises:
        InputError: there is none.
    """
    for expression in model.unknown[name].initial:
        if all(symbol.name in test.known for symbol in expression.free_symbols if symbol.name in model.known):
            return state_by(model, name, expression)
    raise InputError(
        f"{model.name}: unknown.{name}.initial: no expression uses only {', '.join(test.known)} ({test.name}); "
        "add one, a parameter alone will do"
    )


def state_by(model: Model, name: str, expression: sp.Expr) -> State:
    """A state as an affine expression of signals and parameters gives it."""
    value = expression.subs({sp.Symbol(n): p.value for n, p in model.parameters.items()})
    signals = sorted(value.free_symbols, key=str)
    gain = {symbol.name: float(value.coeff(symbol)) for symbol in signals}
    return State(name=name, offset=float(value.subs(dict.fromkeys(signals, 0))), gain=gain)

"""Which network function takes what: the tests' computational graphs as columns of one vector.

A test's dx/dt = g(x, u) has one function a state and its y = h(x, u) one function, with exactly the arguments that
backtracking the computational graph gives (thesis 3.3, 5.10; `analysis.structure.arguments`). All functions of all
tests are evaluated side by side: their arguments are columns of [states of all tests (F); signals (nz); signals a tick
before (nz); 0], the last for those that have fewer than others.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import sympy as sp

from faultline.analysis.graph.bank import state_of
from faultline.analysis.model import Model
from faultline.analysis.structure import Structure, Test, find_tests, structure_of
from faultline.analysis.structure.arguments import Arguments, arguments
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import State

Array = npt.NDArray[np.float64]
Columns = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Layout:
    """The functions of T tests with F states over nz signals.

    `rates` (F, D) and `outputs` (T, D') are columns of [states; signals; signals before; 0]. `owner` (F,) is the test
    of a state, `predicts` (T,) the signal column of a test. `starts` are the states as the test's own signals give them
    on the vehicle, `sensed` the signals of which the model says that they are the state, of whichever test.
    """

    model: Model
    tests: tuple[Test, ...]
    signals: tuple[str, ...]
    states: tuple[str, ...]
    owner: Columns
    rates: Columns
    outputs: Columns
    predicts: Columns
    starts: tuple[State, ...]
    sensed: tuple[str | None, ...]

    @property
    def padding(self) -> int:
        """The column that is zero."""
        return len(self.states) + 2 * len(self.signals)

    @cached_property
    def since(self) -> Columns:
        """The `rates` of the signals at both ends of a tick (F, D'')."""
        first, size = len(self.states), len(self.signals)
        used = [[int(c) for c in row if c != self.padding] for row in self.rates]
        return _padded([[*row, *(c + size for c in row if c >= first)] for row in used], self.padding)

    @cached_property
    def held(self) -> tuple[tuple[int, int], ...]:
        """Test and signal of every value a tick before that `since` takes."""
        last = len(self.states) + len(self.signals)
        found = {
            (int(t), int(c) - last) for t, row in zip(self.owner, self.since, strict=True) for c in row if c >= last
        }
        return tuple(sorted(pair for pair in found if pair[1] < len(self.signals)))

    def driven(self, test: int) -> Columns:
        """The signals that a test's functions take: among them what it predicts only if its own equations use it."""
        used = np.unique(np.concatenate([self.rates[self.owner == test].ravel(), self.outputs[test]]))
        return np.asarray(used[(used >= len(self.states)) & (used != self.padding)] - len(self.states))

    def direct(self, test: int) -> int | None:
        """The state that a test's h returns as it is: it has no other argument, and the sensor is the state's."""
        used = self.outputs[test][self.outputs[test] != self.padding]
        if len(used) != 1 or used[0] >= len(self.states):
            return None
        return int(used[0]) if self.sensed[used[0]] == self.signals[self.predicts[test]] else None

    def started(self, z: Array) -> Array:
        """What `starts` say of the states (..., F) at samples z (..., nz)."""
        gain = np.array([[state.gain.get(name, 0.0) for state in self.starts] for name in self.signals])
        return np.asarray(z @ gain + np.array([state.offset for state in self.starts]))


def layout_of(model: Model, wanted: Sequence[str] | None = None) -> Layout:
    """The layout of the tests that have integral causality, or of the `wanted` ones of them.

    Where all formulas are known a test without a state is none: its equations say all that there is to learn.

    Raises:
        InputError: a wanted test is none of the model's, or cannot be a network, with the reason; none can.
    """
    found = {test.name: test for test in find_tests(model)}
    for name in wanted or ():
        if name not in found:
            raise InputError(f"--tests {name}: {model.name} has no such test; it has {', '.join(found)}")
        if (reason := _obstacle(model, found[name])) is not None:
            raise InputError(f"--tests {name}: cannot be a network: {reason}")
    tests = [test for test in found.values() if isinstance(test, Test) and _obstacle(model, test) is None]
    chosen = [test for test in tests if wanted is None or test.name in wanted]
    if not chosen:
        raise InputError(
            f"{model.name}: there is no network to train: no test has integral causality, or a state beside formulas"
        )
    return _layout(model, chosen)


def _obstacle(model: Model, test: object) -> str | None:
    if not isinstance(test, Test):
        return str(getattr(test, "obstacle", "no integral causality"))
    if test.states or model.without_formula:
        return None
    return "it has no state, its equations alone compute the residual (`faultline code`)"


def _layout(model: Model, tests: Sequence[Test]) -> Layout:
    signals = tuple(model.known)
    place = {(t, name): k for k, (t, name) in enumerate((t, s) for t, test in enumerate(tests) for s in test.states)}
    size = len(place)
    padding = size + 2 * len(signals)

    def columns(t: int, of: Arguments) -> list[int]:
        return [place[t, name] for name in of.states] + [size + signals.index(name) for name in of.known]

    graphs = [arguments(model, test) for test in tests]
    rates = [columns(t, graphs[t].rates[name]) for t, name in place]
    outputs = [
        columns(t, _output(test, graph.output)) for t, (test, graph) in enumerate(zip(tests, graphs, strict=True))
    ]
    return Layout(
        model=model,
        tests=tuple(tests),
        signals=signals,
        states=tuple(f"{tests[t].name}.{name}" for t, name in place),
        owner=np.array([t for t, _ in place], dtype=np.intp),
        rates=_padded(rates, padding),
        outputs=_padded(outputs, padding),
        predicts=np.array([signals.index(test.predicts) for test in tests], dtype=np.intp),
        starts=tuple(_start(model, tests[t], name) for t, name in place),
        sensed=tuple(_sensed(model, name) for _, name in place),
    )


def _output(test: Test, of: Arguments) -> Arguments:
    """Return what h takes: without states not the signal that it predicts, which another equation may have as well."""
    return of if test.states else Arguments((), tuple(name for name in of.known if name != test.predicts))


def _start(model: Model, test: Test, name: str) -> State:
    """A state by its initial values, or by the sensor that is nearest in the test where no formulas are known."""
    if not model.without_formula:
        return state_of(model, test, name)
    return State(name=name, offset=0.0, gain={nearest_sensor(structure_of(model), test, name): 1.0})


def nearest_sensor(structure: Structure, test: Test, name: str) -> str:
    """Return the sensor's signal that the fewest equations of a test part from one of its unknowns.

    An equation of a single unknown is a sensor's; a command says little of where a state is.
    """
    reached, unknowns = set[str](), {name}
    while unknowns != reached:
        inside = [each for each in test.equations if unknowns & {*structure.unknowns_in([each])}]
        sensors = [each for each in inside if len(structure.unknowns_in([each])) == 1 and structure.known_in([each])]
        if sensors:
            return structure.known_in(sensors)[0]
        reached, unknowns = unknowns, unknowns.union(*(structure.unknowns_in([each]) for each in inside))
    return test.predicts


def _padded(rows: Sequence[Sequence[int]], padding: int) -> Columns:
    width = max([1, *map(len, rows)])
    return np.array([[*row, *[padding] * (width - len(row))] for row in rows], dtype=np.intp).reshape(len(rows), width)


def _sensed(model: Model, name: str) -> str | None:
    """The signal that is the state, by an equation that says that their difference is zero, or has these two only."""
    state = sp.Symbol(name)
    for equation in model.equations:
        if model.equations[equation].variables:
            pair = {*model.equations[equation].variables} - {name}
            if len(model.equations[equation].variables) == 2 and len(pair) == 1 and pair <= model.known.keys():
                return pair.pop()
            continue
        expression = model.expression(equation, with_fault=False)
        others = expression.free_symbols - {state}
        if len(others) == 1 and state in expression.free_symbols:
            [signal] = others
            if signal.name in model.known and sp.expand(expression.subs(signal, state)) == 0:
                return str(signal.name)
    return None

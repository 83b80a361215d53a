"""The tests of a model: its minimal test equation supports (MTES), and those of them that can be run.

The number of a test is that of the thesis, which numbers MTES ("MSO_2" there is t02 here).
"""

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from faultline.analysis.model import Model
from faultline.analysis.structure.causality import IntegralCausality, solving_order
from faultline.analysis.structure.matching import bits, union
from faultline.analysis.structure.minimal import minimal_sets
from faultline.analysis.structure.structure import Structure, structure_of


@dataclass(frozen=True, kw_only=True)
class Support:
    """A minimal test equation support: no test of fewer of its faults exists (Krysander, Aslund and Frisk 2010).

    `number` counts from 1, `name` is like "t02". `known` are the signals a test of these equations needs, `states`
    those whose differential constraints are among them. `obstacle` says why it is no `Test`; None for one that is.
    """

    number: int
    name: str
    equations: tuple[str, ...]
    faults: tuple[str, ...]
    known: tuple[str, ...]
    states: tuple[str, ...]
    obstacle: str | None


@dataclass(frozen=True, kw_only=True)
class Test(Support):
    """A test that can be run forward in time: integrate the states, predict a sensor, compare.

    `residual` is the sensor's equation and `predicts` its signal. `sequence` gives for every other algebraic equation
    the variable to solve it for, in an order in which each uses only known signals, states and earlier variables.
    """

    __test__: ClassVar[bool] = False  # pytest must not take it for a test case

    residual: str
    predicts: str
    sequence: tuple[tuple[str, str], ...]


MOST_SETS = 10_000
"""Of each kind that are searched for: their number can grow exponentially with the redundancy."""

Say = Callable[[str], None]


def mso_sets(structure: Structure, most: int | None = None) -> list[tuple[str, ...]]:
    """All minimal structurally over-determined sets of equations (Krysander, Aslund and Nyberg 2008), in order.

    The first `most` of them, if that is given.
    """
    return _named(structure.equations, minimal_sets(structure.unknown_rows, range(len(structure.equations)), most))


def mtes_sets(structure: Structure, most: int | None = None) -> list[tuple[str, ...]]:
    """All minimal test equation supports (Krysander, Aslund and Frisk 2010), in the thesis's order.

    The first `most` of them, if that is given.
    """
    faulty = sorted({*structure.fault_rows.values()})
    return _named(structure.equations, minimal_sets(structure.unknown_rows, faulty, most))


def find_tests(model: Model | Structure, most: int = MOST_SETS, say: Say = lambda _: None) -> tuple[Support, ...]:
    """The first `most` minimal test equation supports, numbered from 1; those that can be run are `Test` objects.

    A structure has no formulas: whether its equations have one solution only is then left open. Residuals of another
    tool are a test each, of the signal alone.
    """
    if isinstance(model, Model) and model.residuals:
        return tuple(_given(number, *each) for number, each in enumerate(model.residuals.items(), start=1))
    say("searching for tests")
    structure, supports = structure_of(model), _Supports(model)
    found = minimal_sets(structure.unknown_rows, sorted({*structure.fault_rows.values()}), most)
    tests = []
    for number, flags in enumerate(found, start=1):
        if number % 100 == 0:
            say(f"test {number} of {len(found)}")
        tests.append(supports.support(number, np.flatnonzero(flags).tolist()))
    return tuple(tests)


@dataclass(frozen=True, kw_only=True)
class Found:
    """The tests and MSO sets of a model; `more_tests` or `more_mso` where there are more than were searched for."""

    tests: tuple[Support, ...]
    mso: list[tuple[str, ...]]
    most: int
    more_tests: bool
    more_mso: bool


def find_all(model: Model | Structure, most: int = MOST_SETS, say: Say = lambda _: None) -> Found:
    """At most `most` tests and MSO sets of a model; residuals of another tool are of no such set."""
    tests, mso = find_tests(model, most + 1, say), list[tuple[str, ...]]()
    if isinstance(model, Structure) or not model.residuals:
        say("searching for MSO sets")
        mso = mso_sets(structure_of(model), most + 1)
    return Found(tests=tests[:most], mso=mso[:most], most=most, more_tests=len(tests) > most, more_mso=len(mso) > most)


def integral_tests(model: Model | Structure) -> tuple[Test, ...]:
    """The tests that need no differentiation and no algebraic loop, with the numbers that `find_tests` gives them."""
    return tuple(test for test in find_tests(model) if isinstance(test, Test))


def _given(number: int, signal: str, faults: tuple[str, ...]) -> Test:
    """The test of a residual that another tool computes: the signal is predicted to be zero."""
    return Test(
        number=number,
        name=signal,
        equations=(),
        faults=faults,
        known=(signal,),
        states=(),
        obstacle=None,
        residual="",
        predicts=signal,
        sequence=(),
    )


def _named(equations: Sequence[str], sets: NDArray[np.bool_]) -> list[tuple[str, ...]]:
    """The equations of every set, (sets, equations)."""
    flags, width = sets.tobytes(), len(equations)
    return [tuple(itertools.compress(equations, flags[at : at + width])) for at in range(0, len(flags), width)]


class _Supports:
    """What is known of a model while its supports are described one after the other."""

    def __init__(self, model: Model | Structure) -> None:
        self._model, self._structure = model, structure_of(model)
        self._one_solution = functools.cache(self._has_one_solution)
        self._signal = functools.cache(self._predicted)
        self._integral = IntegralCausality(self._structure)
        constraints = sorted(self._structure.constraints.values(), key=lambda c: c.state)
        self._faults = [(fault, self._structure.fault_rows[fault]) for fault in self._structure.faults]
        self._faulty = {*self._structure.fault_rows.values()}
        self._states = [(self._structure.unknowns[c.state], c.row) for c in constraints]
        self._signals = {row: known for row, known in enumerate(self._structure.known_rows) if known}

    def support(self, number: int, rows: Sequence[int]) -> Support:
        """A test if any minimal set within has one; with redundancy one there is only the support itself."""
        obstacle = None
        for chosen in self._within(rows):
            found = self._test(number, chosen)
            if isinstance(found, Test):
                return found
            obstacle = obstacle or found
        return self._described(number, rows, obstacle)

    def _within(self, rows: Sequence[int]) -> list[list[int]]:
        """The MSO sets with faults among the rows."""
        masks = [self._structure.unknown_rows[row] for row in rows]
        if len(rows) - union(masks).bit_count() == 1:
            return [[*rows]]
        sets = ([*itertools.compress(rows, flags)] for flags in minimal_sets(masks, range(len(rows)), MOST_SETS))
        return [chosen for chosen in sets if not self._faulty.isdisjoint(chosen)]

    def _described(self, number: int, rows: Sequence[int], obstacle: str | None) -> Support:
        structure, inside = self._structure, {*rows}
        known = union(mask for row, mask in self._signals.items() if row in inside)
        return Support(
            number=number,
            name=f"t{number:02d}",
            equations=tuple([structure.equations[row] for row in rows]),
            faults=tuple([fault for fault, row in self._faults if row in inside]),
            known=tuple(structure.known[z] for z in bits(known)),
            states=tuple([state for state, row in self._states if row in inside]),
            obstacle=obstacle,
        )

    def _test(self, number: int, rows: Sequence[int]) -> Test | str:
        """The test of an MSO set with the first residual equation that permits one, or why there is none."""
        forward = [self._structure.equations[row] for row in self._integral.residuals(rows)]
        if not forward:
            return "no residual equation has integral causality"
        obstacle = f"no sensor is predicted by {', '.join(forward)}, which alone have integral causality"
        for residual, signal in self._outputs(rows, forward):
            order = solving_order(self._structure, [self._structure.equations[row] for row in rows], residual)
            hindered = self._hindered(order)
            if hindered is None:
                sequence = tuple(component[0] for component in order)
                support = self._described(number, rows, obstacle=None)
                return Test(**vars(support), residual=residual, predicts=signal, sequence=sequence)
            obstacle = f"with residual {residual}, {hindered}"
        return obstacle

    def _outputs(self, rows: Sequence[int], forward: Sequence[str]) -> list[tuple[str, str]]:
        """Return the residual equations that predict a signal, with that signal, in the order in which they are tried.

        Without states and formulas a function of all other signals is to be learnt. What moves one of these in a way
        that was never seen says nothing, so that sensors that a fault reaches go first. A sensor is what is in one
        equation only, with one unknown; what is in one with several, as a command, goes last.
        """
        found = [(each, signal) for each in forward if (signal := self._signal(each)) is not None]
        if any(row in rows for _, row in self._states) or not all(map(self._is_free, rows)):
            return found
        own = [(each, signal) for each in forward if (signal := self._own(each)) is not None]
        sensors = [pair for pair in own if len(self._structure.unknowns_in([pair[0]])) == 1]
        sensors.sort(key=lambda pair: self._structure.row[pair[0]] not in self._faulty)
        return list(dict.fromkeys([*sensors, *found, *own]))

    def _is_free(self, row: int) -> bool:
        """Return whether an equation has no formula."""
        model = self._model
        return isinstance(model, Structure) or bool(model.equations[self._structure.equations[row]].variables)

    def _own(self, equation: str) -> str | None:
        """Return the one signal of an equation that is in no other."""
        row = self._structure.row[equation]
        others = union(mask for other, mask in self._signals.items() if other != row)
        own = [*bits(self._structure.known_rows[row] & ~others)]
        return self._structure.known[own[0]] if len(own) == 1 else None

    def _hindered(self, order: list[list[tuple[str, str]]]) -> str | None:
        """What stands against solving the equations in this order, each for its variable and with one solution only."""
        for component in order:
            if len(component) > 1:
                equations, variables = (", ".join(names) for names in zip(*component, strict=True))
                return f"{equations} are an algebraic loop of {variables}"
            [(equation, variable)] = component
            if not self._one_solution(equation, variable):
                return f"{equation} cannot be solved for {variable} with one solution only"
        return None

    def _has_one_solution(self, equation: str, variable: str) -> bool:
        """Whether the equation is linear in the variable: it has one solution then, and may have more otherwise."""
        if isinstance(self._model, Structure) or self._model.equations[equation].variables:
            return True
        slope = sp.diff(self._model.expression(equation, with_fault=True), sp.Symbol(variable))
        return bool(slope != 0 and not slope.has(sp.Symbol(variable)))

    def _predicted(self, equation: str) -> str | None:
        """What a sensor equation predicts: its only signal, or the first of an equation without unknowns.

        It must have a constant factor; without formula, an equation of one unknown is taken for a sensor's.
        """
        signals, unknowns = self._structure.known_in([equation]), self._structure.unknowns_in([equation])
        if len(signals) != 1 and unknowns:
            return None
        if isinstance(self._model, Structure) or self._model.equations[equation].variables:
            return signals[0] if signals and len(unknowns) <= 1 else None
        for signal in signals:
            slope = sp.diff(self._model.expression(equation, with_fault=False), sp.Symbol(signal))
            if slope.is_number and slope != 0:
                return signal
        return None

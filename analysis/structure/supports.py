"""The tests of a model: its minimal test equation supports (MTES), and those of them that can be run.

The number of a test is that of the thesis, which numbers MTES ("MSO_2" there is t02 here).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from faultline.analysis.model import Model
from faultline.analysis.structure.causality import integral_residuals, solving_order
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


def mso_sets(structure: Structure) -> list[tuple[str, ...]]:
    """All minimal structurally over-determined sets of equations (Krysander, Aslund and Nyberg 2008), in order."""
    return _named(structure.equations, minimal_sets(structure.unknown_rows, range(len(structure.equations))))


def mtes_sets(structure: Structure) -> list[tuple[str, ...]]:
    """All minimal test equation supports (Krysander, Aslund and Frisk 2010), in the thesis's order."""
    return _named(structure.equations, minimal_sets(structure.unknown_rows, sorted({*structure.fault_rows.values()})))


def find_tests(model: Model | Structure) -> tuple[Support, ...]:
    """All minimal test equation supports, numbered from 1; those that can be run are `Test` objects.

    A structure has no formulas: whether its equations have one solution only is then left open. Residuals of another
    tool are a test each, of the signal alone.
    """
    if isinstance(model, Model) and model.residuals:
        return tuple(_given(number, *each) for number, each in enumerate(model.residuals.items(), start=1))
    structure = structure_of(model)
    return tuple(
        _support(model, structure, number, equations) for number, equations in enumerate(mtes_sets(structure), start=1)
    )


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


def _support(model: Model | Structure, structure: Structure, number: int, equations: tuple[str, ...]) -> Support:
    """A test if any minimal set within has one; with redundancy one there is only the support itself."""
    obstacle = None
    for chosen in _within(structure, equations):
        found = _test(model, structure, number, chosen)
        if isinstance(found, Test):
            return found
        obstacle = obstacle or found
    return _describe(structure, number, equations, obstacle)


def _within(structure: Structure, equations: tuple[str, ...]) -> list[tuple[str, ...]]:
    """The MSO sets with faults among the equations."""
    rows = structure.rows(equations)
    sets = minimal_sets([structure.unknown_rows[row] for row in rows], range(len(rows)))
    return [chosen for chosen in _named(equations, sets) if structure.faults_in(chosen)]


def _named(equations: Sequence[str], sets: NDArray[np.bool_]) -> list[tuple[str, ...]]:
    """The equations of every set, (sets, equations)."""
    flags, width = sets.tobytes(), len(equations)
    return [tuple(itertools.compress(equations, flags[at : at + width])) for at in range(0, len(flags), width)]


def _describe(structure: Structure, number: int, equations: tuple[str, ...], obstacle: str | None) -> Support:
    return Support(
        number=number,
        name=f"t{number:02d}",
        equations=equations,
        faults=structure.faults_in(equations),
        known=structure.known_in(equations),
        states=structure.states_in(equations),
        obstacle=obstacle,
    )


def _test(model: Model | Structure, structure: Structure, number: int, equations: tuple[str, ...]) -> Test | str:
    """The test of an MSO set with the first residual equation that permits one, or why there is none."""
    forward = integral_residuals(structure, equations)
    if not forward:
        return "no residual equation has integral causality"
    obstacle = f"no sensor is predicted by {', '.join(forward)}, which alone have integral causality"
    for residual in forward:
        signal = _predicted(model, structure, residual)
        if signal is None:
            continue
        order = solving_order(structure, equations, residual)
        hindered = _hindered(model, order)
        if hindered is None:
            sequence = tuple(component[0] for component in order)
            support = _describe(structure, number, equations, obstacle=None)
            return Test(**vars(support), residual=residual, predicts=signal, sequence=sequence)
        obstacle = f"with residual {residual}, {hindered}"
    return obstacle


def _hindered(model: Model | Structure, order: list[list[tuple[str, str]]]) -> str | None:
    """What stands against solving the equations in this order, each for its variable and with one solution only."""
    for component in order:
        if len(component) > 1:
            return f"{', '.join(e for e, _ in component)} are an algebraic loop of {', '.join(v for _, v in component)}"
        [(equation, variable)] = component
        if isinstance(model, Model) and not _has_one_solution(model, equation, variable):
            return f"{equation} cannot be solved for {variable} with one solution only"
    return None


def _has_one_solution(model: Model, equation: str, variable: str) -> bool:
    """Whether the equation is linear in the variable: then it has one solution, with anything else it may have more."""
    slope = sp.diff(model.expression(equation, with_fault=True), sp.Symbol(variable))
    return bool(slope != 0 and not slope.has(sp.Symbol(variable)))


def _predicted(model: Model | Structure, structure: Structure, equation: str) -> str | None:
    """What a sensor equation predicts: its only signal, or the first of an equation without unknowns.

    It must have a constant factor; without formula, an equation of one unknown is taken for a sensor's.
    """
    signals, unknowns = structure.known_in([equation]), structure.unknowns_in([equation])
    if len(signals) != 1 and unknowns:
        return None
    if isinstance(model, Structure):
        return signals[0] if signals and len(unknowns) <= 1 else None
    for signal in signals:
        slope = sp.diff(model.expression(equation, with_fault=False), sp.Symbol(signal))
        if slope.is_number and slope != 0:
            return signal
    return None

"""Every quantity of a model along a run: also those that a solver has no need of."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import sympy as sp

from faultline.analysis.calibration.sections import Section
from faultline.analysis.model import Model
from faultline.analysis.simulation import System, Trajectory

Array = npt.NDArray[np.float64]


def quantities(trajectory: Trajectory) -> dict[str, Array]:
    """Inputs and unknowns (K,) by name, each unknown from an equation that has all else and a multiple of it."""
    system, model = trajectory.system, trajectory.system.model
    h = trajectory.drive.step_s
    found = dict(zip(system.inputs, trajectory.drive.inputs.T, strict=True))
    found |= {str(name): w for name, w in zip(system.variables, trajectory.w.T, strict=True)}
    found |= {d.derivative: np.gradient(found[d.state], h) for d in model.differentials}
    numbers = {name: p.value for name, p in model.parameters.items()} | dict(trajectory.parameters)
    missing = [name for name in model.unknown if name not in found]
    while missing:
        solved = _solvable(model, missing, {*found, *numbers})
        if solved is None:
            break  # of what nothing gives nothing is said
        name, expression = solved
        found[name] = evaluated(expression, found, numbers)
        missing.remove(name)
    return {name: np.broadcast_to(value, len(trajectory.w)) for name, value in found.items()}


def _solvable(model: Model, missing: list[str], at_hand: set[str]) -> tuple[str, sp.Expr] | None:
    for equation in model.equations.values():
        unknown = [symbol for symbol in equation.expression.free_symbols if symbol.name not in at_hand]
        if len(unknown) == 1 and unknown[0].name in missing:
            slope = sp.diff(equation.expression, unknown[0])
            if not slope.has(unknown[0]):
                return unknown[0].name, -equation.expression.xreplace({unknown[0]: sp.Integer(0)}) / slope
    return None


def evaluated(expression: sp.Expr, values: Mapping[str, Array], numbers: Mapping[str, float]) -> Array:
    """An expression's values along a run."""
    names = sorted(symbol.name for symbol in expression.free_symbols)
    function = compiled(expression, names)
    with np.errstate(all="ignore"):
        value = function(*(values[name] if name in values else numbers[name] for name in names))
    return np.nan_to_num(np.asarray(value, dtype=np.float64))


def compiled(expression: sp.Expr, names: Sequence[str]) -> Callable[..., Array]:
    """An expression as a function of arrays, one for each of its `names`."""
    meaning = {"sgsqrt": lambda d: np.sign(d) * np.sqrt(np.abs(d))}
    function: Callable[..., Array] = sp.lambdify([*map(sp.Symbol, names)], expression, modules=[meaning, "numpy"])
    return function


@dataclass(frozen=True)
class Term:
    """A term `factor` * variable of an equation along a run: `value` (K,) is the variable's, `unit` its unit.

    `variable` is an unknown, or empty for an expression that is no such product; `factor` is made of parameters.
    """

    variable: str
    unit: str
    factor: float
    value: Array

    @property
    def size(self) -> float:
        """The root mean square of the term."""
        return abs(self.factor) * float(np.sqrt(np.mean(self.value**2)))


def terms_of(model: Model, equation: str, values: Mapping[str, Array], numbers: Mapping[str, float]) -> list[Term]:
    """The equation's terms that are a multiple of one unknown, the largest first; if it has none, all its terms."""
    expression = sp.expand(model.expression(equation, with_fault=False))
    known = {sp.Symbol(name): sp.Float(value) for name, value in numbers.items()}
    found = []
    for name in values.keys() & model.unknown.keys():
        slope = sp.diff(expression, sp.Symbol(name)).xreplace(known)
        if slope.is_number and slope != 0:
            found.append(Term(name, model.unknown[name].unit, float(slope), values[name]))
    if not found:
        count = len(next(iter(values.values())))
        parts = [np.broadcast_to(evaluated(part, values, numbers), count) for part in sp.Add.make_args(expression)]
        found = [Term("", "", 1.0, part) for part in parts]
    return sorted(found, key=lambda term: (-term.size, term.variable))


def mode_of(model: Model, system: System, section: Section) -> npt.NDArray[np.int64]:
    """The operating mode at the section's instants by the levels alone, as nothing is settling: no *edge*."""
    levels = {
        name: section.drive.inputs[:, system.inputs.index(name)]
        if name in system.inputs
        else np.interp(section.t, section.samples[name].t, section.samples[name].value)
        for name in model.modes.bounded
    }
    return model.modes.at(levels, len(section.t))

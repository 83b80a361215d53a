"""A model as what a solver needs: equations in as few variables as can be, with all their derivatives.

The sensors' equations are set aside: what they measure are the *outputs*; the other known signals are the *inputs*. So
is a sensor of what nothing else determines, as an ambient temperature. What is left is a differential-algebraic system

    G(w, d, u, theta) = 0,    d = derivatives of the states

in states and algebraic variables w. Two rewritings make it fit for Newton's method. A variable that some equation gives
as a plain sum is put in where it is used, so that what cancels does (the pump's efficiency divides by its speed, the
flow does not). And a root, steep at zero, becomes a variable s of its own with the parabola that defines it,
s |s| = argument, which is smooth where the flow turns (Nagel 1975 solves diodes the same way: for the current).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt
import sympy as sp
from scipy.sparse import csr_array
from scipy.sparse.csgraph import structural_rank

from faultline.analysis.model import Model
from faultline.analysis.model.functions import sgsqrt
from faultline.analysis.model.slope import Sign, slope
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]

Evaluation = Callable[..., list[float | Array]]

MOST = 20_000
"""Expressions, and derivatives, that are remembered in a process."""

LAMINAR = 1e-4
"""The slope of a root's parabola at zero, where it would have none: of an orifice's velocity in m/s, a laminar part."""


@dataclass(frozen=True)
class System:
    """`residuals` (n) in `variables` (n: the states first, then the rest) and `derivatives`; `outputs` by signal.

    `roots` are those variables that stand for the root of an argument, which may use variables before them.
    `parameters` are the names that stay symbols; all others have their values.
    """

    model: Model
    states: tuple[str, ...]
    variables: tuple[sp.Symbol, ...]
    derivatives: tuple[sp.Symbol, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    residuals: tuple[sp.Expr, ...]
    outputs: dict[str, sp.Expr]
    roots: dict[sp.Symbol, sp.Expr]

    @cached_property
    def unseen(self) -> tuple[int, ...]:
        """The places of those states whose start no signal tells: they add up what has been."""
        known = {sp.Symbol(name) for name in self.model.known}
        starts = [self.model.unknown[name].initial[0] for name in self.states]
        return tuple(k for k, start in enumerate(starts) if not start.free_symbols & known)

    @property
    def arguments(self) -> list[sp.Symbol]:
        """What the functions below take, arrays over time or numbers: variables, derivatives, inputs, parameters."""
        known = [sp.Symbol(name) for name in (*self.inputs, *self.parameters)]
        return [*self.variables, *self.derivatives, *known]

    def compiled(self, groups: Sequence[Sequence[sp.Expr]]) -> Evaluation:
        """The values of the expressions of all groups as a function of `arguments`.

        A group is compiled once in a process, whatever system it is of: an effect changes few of a model's equations.
        """
        place = {symbol: k for k, symbol in enumerate(self.arguments)}
        parts = []
        for group in groups:
            symbols, function = _function(tuple(group))
            parts.append(([place[symbol] for symbol in symbols], function))

        def evaluate(*arguments: float | Array) -> list[float | Array]:
            return [value for places, function in parts for value in function(*(arguments[k] for k in places))]

        return evaluate

    def jacobian(self, expressions: Sequence[sp.Expr], symbols: Sequence[sp.Symbol]) -> "Jacobian":
        """The derivatives of `expressions` to `symbols`."""
        places: list[tuple[int, int]] = []
        rows = []
        for row, expression in enumerate(expressions):
            found = {column: _derivative(expression, symbol) for column, symbol in enumerate(symbols)}
            entries = {column: entry for column, entry in found.items() if entry != 0}
            places += [(row, column) for column in entries]
            rows.append([*entries.values()])
        return Jacobian((len(expressions), len(symbols)), tuple(places), self.compiled([row for row in rows if row]))

    @cached_property
    def value(self) -> Evaluation:
        """The residuals' values."""
        return self.compiled([[e] for e in self.residuals])

    @cached_property
    def shown(self) -> Evaluation:
        """The outputs' values."""
        return self.compiled([[e] for e in self.outputs.values()])

    @cached_property
    def root_arguments(self) -> tuple[Evaluation, ...]:
        """The values of the roots' arguments, one by one: an argument may use the roots before it."""
        return tuple(self.compiled([[argument]]) for argument in self.roots.values())

    @cached_property
    def by_variable(self) -> "Jacobian":
        """Of the residuals."""
        return self.jacobian(self.residuals, self.variables)

    @cached_property
    def by_derivative(self) -> "Jacobian":
        """Of the residuals."""
        return self.jacobian(self.residuals, self.derivatives)

    @cached_property
    def by_input(self) -> "Jacobian":
        """Of the residuals."""
        return self.jacobian(self.residuals, [sp.Symbol(name) for name in self.inputs])

    @cached_property
    def by_parameter(self) -> "Jacobian":
        """Of the residuals."""
        return self.jacobian(self.residuals, [sp.Symbol(name) for name in self.parameters])

    @cached_property
    def shown_by(self) -> "dict[str, Jacobian]":
        """Of the outputs, by what the derivative is to: "variables", "derivatives", "inputs" or "parameters"."""
        to = {
            "variables": self.variables,
            "derivatives": self.derivatives,
            "inputs": self.inputs,
            "parameters": self.parameters,
        }
        shown = list(self.outputs.values())
        return {name: self.jacobian(shown, [sp.Symbol(str(s)) for s in symbols]) for name, symbols in to.items()}


@dataclass(frozen=True)
class Jacobian:
    """A matrix of functions of which `places` (row, column) may differ from zero."""

    shape: tuple[int, int]
    places: tuple[tuple[int, int], ...]
    entries: Evaluation

    def __call__(self, count: int, arguments: Sequence[Array | float]) -> Array:
        """The matrix at `count` instants, (count, rows, columns)."""
        found = np.zeros((count, *self.shape))
        for (row, column), value in zip(self.places, self.entries(*arguments), strict=True):
            found[:, row, column] = value
        return found


def system_of(model: Model, parameters: Sequence[str], *, disturbed: bool = False) -> System:
    """The model's free-running system, in which `parameters` stay symbols.

    A `disturbed` one has an input more for every equation, after all others: `disturbance(e)`, for expression = d.

    Raises:
        InputError: the model is not to be run freely: too few or too many equations for its variables, or a name of
            its own is that of a disturbance.
    """
    disturbances = _disturbances(model) if disturbed else {}
    equations, outputs = _equations_and_outputs(model, disturbances)
    numbers = {
        sp.Symbol(name): sp.Float(p.value) for name, p in model.parameters.items() if name not in set(parameters)
    }
    states = [sp.Symbol(d.state) for d in model.differentials]
    derivatives = [sp.Symbol(d.derivative) for d in model.differentials]
    unknowns = [sp.Symbol(name) for name in model.unknown]
    algebraic = [v for v in unknowns if v not in states and v not in derivatives]
    left = [sp.expand(e.xreplace(numbers)) for e in equations.values()]
    shown = {signal: e.xreplace(numbers) for signal, (_, e) in outputs.items()}
    left, shown, algebraic = _substituted(left, shown, algebraic, set(derivatives))
    rootless, roots = _without_roots([*left, *shown.values()])
    left, shown = rootless[: len(left)], dict(zip(shown, rootless[len(left) :], strict=True))
    return System(
        model=model,
        states=tuple(d.state for d in model.differentials),
        variables=(*states, *algebraic, *roots),
        derivatives=tuple(derivatives),
        inputs=(*(name for name in model.known if name not in outputs), *disturbances.values()),
        parameters=tuple(parameters),
        residuals=(*left, *(s * (sp.Abs(s) + LAMINAR) - argument for s, argument in roots.items())),
        outputs=shown,
        roots=roots,
    )


def check_free_run(model: Model) -> None:
    """Check that the model can be run freely, without making its system.

    Raises:
        InputError: there are too few or too many equations for its variables.
    """
    _equations_and_outputs(model, {})


def _equations_and_outputs(
    model: Model, disturbances: dict[str, str]
) -> tuple[dict[str, sp.Expr], dict[str, tuple[str, sp.Expr]]]:
    """The equations but those of sensors, with what disturbs them, and what `_sensors` gives; raises `InputError`."""
    equations = {name: model.expression(name, with_fault=False) for name in model.equations}
    equations |= {name: equations[name] - sp.Symbol(d) for name, d in disturbances.items()}
    outputs = _without_inputs(model, equations, _sensors(model, equations))
    equations = {name: e for name, e in equations.items() if name not in {place for place, _ in outputs.values()}}
    dynamic = {name for d in model.differentials for name in (d.state, d.derivative)}
    variables = len(model.differentials) + sum(name not in dynamic for name in model.unknown)
    if len(equations) != variables:
        raise InputError(
            f"{model.name}: {len(equations)} equations besides its sensors' ({', '.join(outputs) or 'none'}) for "
            f"{variables} derivatives and algebraic variables; a free run needs as many"
        )
    return equations, outputs


def disturbance(equation: str) -> str:
    """The name of what is added to the named equation."""
    return f"d_{equation}"


def _disturbances(model: Model) -> dict[str, str]:
    """By equation."""
    found = {name: disturbance(name) for name in model.equations}
    for d in found.values():
        if d in {*model.known, *model.unknown, *model.parameters}:
            raise InputError(f"{model.name}: {d} names a disturbance of an equation; call it something else")
    return found


def _sensors(model: Model, equations: dict[str, sp.Expr]) -> dict[str, tuple[str, sp.Expr]]:
    """By signal that a sensor shows: the equation that says so, and what the signal is in terms of the one unknown."""
    found = {}
    known, unknown = ({sp.Symbol(name) for name in names} for names in (model.known, model.unknown))
    for signal in model.known:
        y = sp.Symbol(signal)
        places = [name for name, e in equations.items() if y in e.free_symbols]
        if len(places) != 1:
            continue
        expression = equations[places[0]]
        gain = sp.diff(expression, y)
        alone = expression.free_symbols & known == {y} and len(expression.free_symbols & unknown) == 1
        if alone and gain.is_number and gain != 0:
            found[signal] = (places[0], _solved(expression, y))
    return found


def _without_inputs(
    model: Model, equations: dict[str, sp.Expr], sensors: dict[str, tuple[str, sp.Expr]]
) -> dict[str, tuple[str, sp.Expr]]:
    """The sensors but those whose equation alone determines a variable, by the structural rank of all others."""
    states = {d.state for d in model.differentials}
    columns = {sp.Symbol(name): column for column, name in enumerate(n for n in model.unknown if n not in states)}
    places = {place for place, _ in sensors.values()}
    rows = [e.free_symbols for name, e in equations.items() if name not in places]
    outputs = {}
    for signal, (place, shown) in sensors.items():
        more = [*rows, equations[place].free_symbols]
        if _rank(more, columns) > _rank(rows, columns):
            rows = more
        else:
            outputs[signal] = (place, shown)
    return outputs


def _rank(rows: Sequence[set[sp.Symbol]], columns: dict[sp.Symbol, int]) -> int:
    """Return the structural rank: how many of the columns' variables the rows can determine at most."""
    if not rows or not columns:
        return 0
    incidence = np.array([[symbol in row for symbol in columns] for row in rows])
    return int(structural_rank(csr_array(incidence)))


def _substituted(
    equations: list[sp.Expr], outputs: dict[str, sp.Expr], algebraic: list[sp.Symbol], derivatives: set[sp.Symbol]
) -> tuple[list[sp.Expr], dict[str, sp.Expr], list[sp.Symbol]]:
    """Puts in every algebraic variable that an equation gives as a sum: variable = what does not know it.

    A balance, which has a derivative, gives none: solved for a flow it would set that by how fast a pressure changes.
    """
    left = list(algebraic)
    while choice := next(
        ((e, v) for e in equations if not e.free_symbols & derivatives for v in left if _given(e, v)), None
    ):
        equation, variable = choice
        value = _solved(equation, variable)
        equations = [sp.expand(e.xreplace({variable: value})) for e in equations if e is not equation]
        outputs = {signal: sp.expand(e.xreplace({variable: value})) for signal, e in outputs.items()}
        left.remove(variable)
    return equations, outputs, left


def _given(equation: sp.Expr, variable: sp.Symbol) -> bool:
    if variable not in equation.free_symbols:
        return False
    gain = sp.expand(_derivative(equation, variable))
    return bool(gain.is_number and gain != 0)


def _solved(equation: sp.Expr, variable: sp.Symbol) -> sp.Expr:
    """The variable from an equation that has a multiple of it; rounding leaves nothing of the variable."""
    return sp.expand(-equation.xreplace({variable: sp.Integer(0)}) / _derivative(equation, variable))


@lru_cache(maxsize=MOST)
def _function(expressions: tuple[sp.Expr, ...]) -> tuple[tuple[sp.Symbol, ...], Evaluation]:
    """The values of expressions as a function of the symbols in them, in the order that is given."""
    symbols = tuple(sorted(set[sp.Symbol]().union(*(e.free_symbols for e in expressions)), key=str))
    meaning = {"sgsqrt": lambda d: np.sign(d) * np.sqrt(np.abs(d))}
    function: Evaluation = sp.lambdify(
        symbols, expressions, modules=[meaning, "numpy"], cse=True, docstring_limit=0
    )  # a docstring has the expressions as text, which takes a third of the time
    return symbols, function


@lru_cache(maxsize=MOST)
def _derivative(expression: sp.Expr, symbol: sp.Symbol) -> sp.Expr:
    """The derivative; |x| is flat at zero."""
    found = slope(expression, symbol)
    return found.replace(Sign, sp.sign) if found.has(Sign) else found


def _without_roots(expressions: list[sp.Expr]) -> tuple[list[sp.Expr], dict[sp.Symbol, sp.Expr]]:
    """The expressions with a variable for every distinct root, and the roots' arguments, innermost first."""
    roots: dict[sp.Symbol, sp.Expr] = {}
    while found := [call for e in expressions for call in e.atoms(sgsqrt) if not call.args[0].has(sgsqrt)]:
        call = min(found, key=str)
        symbol = sp.Symbol(f"root_{len(roots) + 1}")
        roots[symbol] = call.args[0]
        expressions = [e.xreplace({call: symbol}) for e in expressions]
    return expressions, roots

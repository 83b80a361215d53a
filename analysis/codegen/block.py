"""The network of some states of a model: what the implicit step needs where other parts are computed around it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import sympy as sp

from faultline.analysis.codegen.elimination import Solved
from faultline.analysis.graph.linear import last
from faultline.analysis.graph.network import Evaluator, Values, flow_network
from faultline.analysis.model import Differential, Equation, Known, Model, Unknown, sgsqrt
from faultline.analysis.structure import Test

_SENSOR = "the output"


@dataclass(frozen=True)
class Block:
    """A network's `signals`, matrices and `formulas` of signals and of the `last` states; what its `orifices` are."""

    signals: list[str]
    values: Values
    orifices: list[str]
    formulas: dict[sp.Symbol, sp.Expr]
    last: list[sp.Symbol]


def names_in(expression: sp.Expr) -> set[str]:
    """The names of an expression's symbols."""
    return {symbol.name for symbol in expression.free_symbols}


def independent(explicit: Sequence[Solved], states: set[str]) -> list[Solved]:
    """Those that no state enters, directly or through others."""
    dependent = set(states)
    for solved in explicit:
        if names_in(solved.value) & dependent:
            dependent.add(solved.variable)
    return [solved for solved in explicit if solved.variable not in dependent]


def state_network(
    model: Model,
    constraints: Sequence[Differential],
    explicit: Sequence[Solved],
    signals: Sequence[str],
    place: str,
) -> Block:
    """The network of some states, as a small model of its own.

    Its equations are the solved ones, its known signals what enters. It measures its first state, which is only to
    make it a test.
    """
    rows = {f"{s.equation} {s.variable}" if s.part else s.equation: s for s in explicit}
    nothing = Known(unit="1", description="", min=0.0, max=0.0, noise=0.0)
    variable = Unknown(unit="1", description="", initial=(), initial_text=())
    measured = Solved(_SENSOR, _SENSOR, sp.Symbol(constraints[0].state))
    grouped = [*(_grouped(model, s) for s in explicit), measured.value]
    small = replace(
        model,
        known=dict.fromkeys([*signals, _SENSOR], nothing),
        unknown=dict.fromkeys([*(d.state for d in constraints), *(s.variable for s in explicit)], variable),
        equations={
            name: Equation(name=name, description="", text="", expression=sp.Symbol(s.variable) - value, fault=None)
            for (name, s), value in zip({**rows, _SENSOR: measured}.items(), grouped, strict=True)
        },
        differentials=tuple(constraints),
    )
    test = Test(
        number=1,
        name=place.removeprefix(f"{model.name}: "),
        equations=tuple(small.equations),
        faults=(),
        known=tuple(small.known),
        states=tuple(d.state for d in constraints),
        obstacle=None,
        residual=_SENSOR,
        predicts=_SENSOR,
        sequence=tuple((name, s.variable) for name, s in rows.items()),
    )
    found = flow_network(small, test, list(signals))
    [values] = Evaluator([found], small)([{}])
    x = sp.Matrix([sp.Symbol(state) for state in test.states])
    u = sp.Matrix([1, *(sp.Symbol(key) for key in signals), *found.formulas])
    orifices = [_origin(argument, explicit) for argument in found.alpha * x + found.beta * u]
    return Block(list(signals), values, orifices, found.formulas, [last(test.name, state) for state in test.states])


def _grouped(model: Model, solved: Solved) -> sp.Expr:
    """The value as the model groups it, if it has it from one equation: a balance has its capacity outside."""
    if solved.part or solved.equation not in model.equations:
        return solved.value
    expression, variable = model.expression(solved.equation, with_fault=False), sp.Symbol(solved.variable)
    gain = sp.diff(expression, variable)
    if gain == 0 or gain.has(variable):
        return solved.value
    value = -expression.subs(variable, 0) / gain
    return value if sp.expand(value - solved.value) == 0 else solved.value


def _origin(argument: sp.Expr, explicit: Sequence[Solved]) -> str:
    """The equation with a root of this argument."""
    substituted: dict[sp.Symbol, sp.Expr] = {}
    for solved in explicit:
        whole = solved.value.subs(substituted)
        if any(sp.expand(root.args[0] - argument) == 0 for root in whole.atoms(sgsqrt)):
            return solved.equation
        substituted[sp.Symbol(solved.variable)] = whole
    return "orifice"

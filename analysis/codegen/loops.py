"""Solves equations and algebraic loops symbolically, where the solution is certain to be the only real one.

An equation is solved for a variable v that occurs

    linearly                                        a v + b = 0
    in one signed root, linear in v                 a sgsqrt(b v + c) + d = 0      sgsqrt's inverse is s |s|
    in one square root, linear in v                 a sqrt(b v + c) + d = 0        where -d/a >= 0, NaN elsewhere
    linearly and in a signed root, both rising      a v + b sgsqrt(c v + d) + e = 0     with a b c > 0

with coefficients free of v. A loop of two linear equations has a closed form; of larger ones the linear part is
eliminated with intermediate results, and what is left is solved by eliminating variables one by one. Everything else,
as a square or an absolute value, may have several solutions and is refused: none is picked silently.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence

import sympy as sp

from faultline.analysis.codegen.elimination import CANCELLED, Elimination, Solved
from faultline.analysis.model import sgsqrt
from faultline.service.core.errors import InputError


class sgsquare(sp.Function):  # type: ignore[misc]  # noqa: N801  (as in generated code)
    """sgsquare(s) = s |s|, the inverse of sgsqrt; opaque to sympy."""

    nargs = 1


class unrooted(sp.Function):  # type: ignore[misc]  # noqa: N801  (as in generated code)
    """unrooted(s) = s^2 for s >= 0, the only x with sqrt(x) = s; NaN for s < 0, of which nothing is the root."""

    nargs = 1


class loaded(sp.Function):  # type: ignore[misc]  # noqa: N801  (as in generated code)
    """loaded(d0, Z) = the only s with s |s| + Z s = d0 for Z > 0: an orifice in series with a resistance."""

    nargs = 2


class _AmbiguousError(Exception):
    """Why an equation has no solution that is certain to be the only one."""


def solve_component(
    equations: Mapping[str, sp.Expr],
    variables: Sequence[str],
    numbers: Mapping[str, float],
    place: str,
    fresh: Callable[[str], str],
) -> list[Solved]:
    """The variables with their solutions, each in terms of what is given and of those before it.

    `equations` are expressions that equal zero, by name; `numbers` are the parameters' values, which decide whether a
    coefficient is zero and what its sign is. Intermediate results of a large loop get their names from `fresh`.

    Raises:
        InputError: the solution is not certain to be the only one; the message begins with `place` and names the
            equations, the variables and the reason.
    """
    symbols = [sp.Symbol(name) for name in variables]
    try:
        if len(symbols) > 2:
            return _reduced(equations, symbols, numbers, fresh)
        if len(symbols) == 2 and _is_linear(equations.values(), symbols):
            return _linear(equations, symbols, numbers)
        return _eliminated(equations, symbols, numbers)
    except _AmbiguousError as error:
        loop = "the algebraic loop " if len(symbols) > 1 else ""
        raise InputError(
            f"{place}: {loop}{', '.join(equations)} cannot be solved for {', '.join(variables)}: {error}; "
            "choose another residual equation or write the equation in another form"
        ) from error


def _is_linear(expressions: Iterable[sp.Expr], symbols: Sequence[sp.Symbol]) -> bool:
    return all(_linear_in(expression, symbol, symbols) for expression in expressions for symbol in symbols)


def _linear_in(expression: sp.Expr, symbol: sp.Symbol, loop: Sequence[sp.Symbol]) -> bool:
    return not sp.diff(expression, symbol).free_symbols & set(loop)


def _linear(
    equations: Mapping[str, sp.Expr], symbols: Sequence[sp.Symbol], numbers: Mapping[str, float]
) -> list[Solved]:
    """The closed form, if the elimination of the same equations leaves nothing."""
    if Elimination(equations, symbols, numbers, str).left:
        raise _AmbiguousError("its linear equations are dependent")
    matrix = sp.Matrix([[sp.diff(expression, symbol) for symbol in symbols] for expression in equations.values()])
    constants = sp.Matrix([expression.subs(dict.fromkeys(symbols, 0)) for expression in equations.values()])
    [solution] = sp.linsolve((matrix, -constants), *symbols)
    solved = zip(equations, symbols, solution, strict=True)
    return [Solved(name, symbol.name, sp.cancel(value)) for name, symbol, value in solved]


def _reduced(
    equations: Mapping[str, sp.Expr],
    symbols: Sequence[sp.Symbol],
    numbers: Mapping[str, float],
    fresh: Callable[[str], str],
) -> list[Solved]:
    """Eliminates what is linear first; where that is all, nothing is left."""
    elimination = Elimination(equations, symbols, numbers, fresh)
    if elimination.linear and elimination.left:
        raise _AmbiguousError("its linear equations are dependent")
    left = _eliminated(elimination.rest, elimination.left, elimination.numbers)
    return [*elimination.parts, *left, *elimination.solutions]


def _eliminated(
    equations: Mapping[str, sp.Expr], symbols: Sequence[sp.Symbol], numbers: Mapping[str, float]
) -> list[Solved]:
    """Solves one equation for one variable, puts it into the others, and so on; linear ones come first."""
    if not symbols:
        return []
    reason = _AmbiguousError("no equation is left for the last variable")
    choices = [(name, symbol) for name, e in equations.items() for symbol in symbols if symbol in e.free_symbols]
    choices.sort(key=lambda choice: not _linear_in(equations[choice[0]], choice[1], symbols))
    for name, symbol in choices:
        try:
            value = _solved(equations[name], symbol, symbols, numbers)
        except _AmbiguousError as error:
            reason = error
            continue
        others = {other: sp.expand(e.subs(symbol, value)) for other, e in equations.items() if other != name}
        rest = _eliminated(others, [other for other in symbols if other != symbol], numbers)
        return [*rest, Solved(name, symbol.name, value)]
    raise reason


def _solved(expression: sp.Expr, v: sp.Symbol, loop: Sequence[sp.Symbol], numbers: Mapping[str, float]) -> sp.Expr:
    """The one solution of expression = 0 for v, by one of the forms above."""
    expression = sp.expand(expression)
    inner = expression.subs(v, 0)
    slope = sp.diff(expression, v)
    if v not in slope.free_symbols:
        _check_slope(slope, v, loop, numbers)
        return sp.expand(-inner / slope)
    roots = [atom for atom in expression.atoms(sgsqrt, sp.Pow) if v in atom.free_symbols and _is_root(atom)]
    if len(roots) != 1:
        raise _AmbiguousError(f"it is not linear in {v} and may have several solutions")
    [root] = roots
    t = sp.Dummy("t")
    outer = expression.xreplace({root: t})
    gain, weight = sp.diff(outer, t), sp.diff(outer, v)  # outer = gain t + weight v + rest
    argument = sp.expand(root.args[0])
    stretch = sp.diff(argument, v)
    if {v, t} & (gain.free_symbols | weight.free_symbols | stretch.free_symbols):
        raise _AmbiguousError(f"{root} is not alone or not linear in {v}, and there may be several solutions")
    _check_slope(gain, v, loop, numbers)
    _check_slope(stretch, v, loop, numbers)
    offset, rest = argument.subs(v, 0), outer.subs({v: 0, t: 0})
    if _is_zero(weight, numbers):
        inverse = (sgsquare if isinstance(root, sgsqrt) else unrooted)(sp.expand(-rest / gain))
        return sp.expand((inverse - offset) / stretch)
    if not isinstance(root, sgsqrt) or not _is_positive(weight * gain * stretch, numbers):
        raise _AmbiguousError(f"{v} is inside {root} and outside, and there may be several solutions")
    # With d = stretch v + offset: d + Z s = d0
    impedance = sp.expand(gain * stretch / weight)
    open_circuit = sp.expand(offset - rest * stretch / weight)
    return sp.expand((sgsquare(loaded(open_circuit, impedance)) - offset) / stretch)


def _is_root(atom: sp.Expr) -> bool:
    return isinstance(atom, sgsqrt) or atom.exp == sp.Rational(1, 2)


def _check_slope(slope: sp.Expr, v: sp.Symbol, loop: Sequence[sp.Symbol], numbers: Mapping[str, float]) -> None:
    if _is_zero(slope, numbers):
        raise _AmbiguousError(f"the coefficient of {v} is zero")
    others = sorted(symbol.name for symbol in slope.free_symbols & set(loop))
    if others:
        raise _AmbiguousError(f"{v} is multiplied by {', '.join(others)} of the same loop, which may be zero")


def _is_zero(expression: sp.Expr, numbers: Mapping[str, float]) -> bool:
    """Whether it is zero but for rounding: nothing beside the terms of its numerator."""
    numerator = sp.numer(sp.cancel(expression))
    terms = [_value(term, numbers) for term in sp.Add.make_args(sp.expand(numerator))]
    if not all(term.is_number for term in terms):
        return False
    values = [float(term) for term in terms]
    return abs(sum(values)) <= CANCELLED * sum(map(abs, values))


def _is_positive(expression: sp.Expr, numbers: Mapping[str, float]) -> bool:
    """Whether it is positive whatever the signals: a number with the parameters put in."""
    value = _value(expression, numbers)
    return bool(value.is_number and value > 0)


def _value(expression: sp.Expr, numbers: Mapping[str, float]) -> sp.Expr:
    return expression.subs(
        {symbol: numbers[symbol.name] for symbol in expression.free_symbols if symbol.name in numbers}
    )

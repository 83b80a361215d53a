"""Whether a model with an effect in it is sound: a valid model, in units, and the old one at null values."""

from collections.abc import Mapping, Sequence
from random import Random

import sympy as sp

from faultline.analysis.discrepancy.effects.effect import Effect
from faultline.analysis.model import Model, ModelError
from faultline.analysis.model.check import check_model
from faultline.analysis.simulation import check_free_run
from faultline.analysis.structure.lint import unit_findings
from faultline.service.core.errors import InputError

PROBES = 8
"""Points at which formulas are compared that sympy cannot tell to be equal."""

DIGITS = 30
EQUAL = 1e-12


def check_rewritten(before: Model, after: Model, effect: Effect) -> None:
    """Whether `after`, the model `before` with the effect in it, is sound.

    Raises:
        ModelError: the first thing that it is not, with its remedy.
    """
    check_model(after, [*after.equations], effect.place)
    added = len(after.unknown) - len(before.unknown)
    rows = len(after.equations) - len(before.equations) + len(after.differentials) - len(before.differentials)
    if added != rows:
        problem = f"{rows} equations and differentials for {added} new unknowns"
        raise ModelError(f"{effect.place}: {problem}; a model needs as many, add what is missing")
    for finding in unit_findings(after):
        if finding not in [*unit_findings(before)]:
            raise ModelError(f"{effect.place}: {finding.place}: {finding.message}")
    _check_null(before, after, effect)
    _check_runs(before, after, effect)


def _check_runs(before: Model, after: Model, effect: Effect) -> None:
    """A model that could be run freely still can."""
    try:
        check_free_run(after)
    except InputError as error:
        if _runs(before):
            remedy = "let a sensor show one unknown, and give every new unknown an equation"
            raise ModelError(f"{effect.place}: the model cannot be run with it: {error}; {remedy}") from error


def _runs(model: Model) -> bool:
    try:
        check_free_run(model)
    except InputError:
        return False
    return True


def _check_null(before: Model, after: Model, effect: Effect) -> None:
    nulls = {sp.Symbol(name): _exact(p.value) for name, p in effect.strengths.items()}
    changed = [name for name, e in before.equations.items() if after.equations[name].expression != e.expression]
    own = [sp.Symbol(name) for name in after.unknown if name not in before.unknown]
    new = [e.expression.xreplace(nulls) for name, e in after.equations.items() if name not in before.equations]
    values = _given(new, own)
    for name in changed:
        at_null = after.equations[name].expression.xreplace(nulls).xreplace(values)
        if not _same(at_null, before.equations[name].expression, before):
            text = ", ".join(f"{parameter} = {p.value:g}" for parameter, p in effect.strengths.items())
            problem = f"{name} is not `{before.equations[name].text}` with {text}"
            raise ModelError(f"{effect.place}: {problem}; write what vanishes there, or correct null")


def _exact(value: float) -> sp.Expr:
    return sp.Integer(int(value)) if value == int(value) else sp.Float(value)


def _given(equations: Sequence[sp.Expr], unknowns: Sequence[sp.Symbol]) -> dict[sp.Symbol, sp.Expr]:
    """The unknowns that equations give as plain sums, in terms of all others."""
    left, values = list(equations), dict[sp.Symbol, sp.Expr]()
    while choice := next(((e, x) for e in left for x in unknowns if _slope(e, x)), None):
        equation, unknown = choice
        value = {unknown: -equation.xreplace({unknown: sp.Integer(0)}) / _slope(equation, unknown)}
        left = [e.xreplace(value) for e in left if e is not equation]
        values = {x: e.xreplace(value) for x, e in values.items()} | value
    return values


def _slope(equation: sp.Expr, unknown: sp.Symbol) -> sp.Expr | None:
    """The number by which an equation changes with an unknown; None where it is no number or zero."""
    if unknown not in equation.free_symbols:
        return None
    slope = sp.expand(sp.diff(equation, unknown))
    return slope if slope.is_number and slope != 0 else None


def _same(one: sp.Expr, other: sp.Expr, model: Model) -> bool:
    """Whether two formulas are equal: as sympy has it, or else at points within the signals' ranges."""
    difference = sp.expand(one - other)
    if difference == 0:
        return True
    random = Random(0)  # noqa: S311  (no secret, and the same points each time)
    symbols = sorted(difference.free_symbols | other.free_symbols, key=str)
    for _ in range(PROBES):
        point = {symbol: _somewhere(symbol.name, model, random) for symbol in symbols}
        size = sum(abs(_number(term, point)) for term in sp.Add.make_args(other))
        off = _number(difference, point)
        if not off.is_finite or abs(off) > EQUAL * size:  # 1/g where g is null is no number
            return False
    return True


def _number(expression: sp.Expr, point: Mapping[sp.Symbol, sp.Expr]) -> sp.Expr:
    return expression.xreplace(dict(point)).evalf(DIGITS)


def _somewhere(name: str, model: Model, random: Random) -> sp.Expr:
    """A value of a symbol: a signal's in its range, a parameter's near its own, an unknown's of any size and sign."""
    if name in model.known:
        value = random.uniform(model.known[name].min, model.known[name].max)
    elif name in model.parameters:
        value = model.parameters[name].value * random.uniform(0.5, 1.5)
    else:
        value = random.choice((-1.0, 1.0)) * 10.0 ** random.uniform(-7.0, 7.0)
    return sp.Float(value, DIGITS)

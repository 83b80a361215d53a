"""Formulas of a model as nodes of a graph: sums, products, powers of halves and quarters, and its functions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import sympy as sp

from faultline.analysis.graph.writer import Array, Writer
from faultline.analysis.model.functions import exp, log, sgsqrt, sign, tanh
from faultline.service.core.errors import InputError

SMALLEST = 1e-300
"""Keeps the root of zero from being divided by."""


_OPERATORS = {sp.Abs: "Abs", exp: "Exp", log: "Log", tanh: "Tanh"}


@dataclass(frozen=True)
class Formulas:
    """Formulas of signals, states and parameters: the names in the order of their columns, `theta` (P, B).

    The `expressions` are known before the step; `readings`, by the row of their test, are of the states after it.
    """

    expressions: tuple[sp.Expr, ...]
    readings: dict[int, sp.Expr]
    signals: tuple[str, ...]
    states: tuple[str, ...]
    parameters: tuple[str, ...]
    theta: Array
    place: str

    def write_theta(self, w: Writer, *, parametric: bool) -> str:
        """The parameters: an input `theta` of `parametric` ones, constants of several sets; "" of a single one."""
        if not self.parameters:
            return ""
        if parametric:
            return w.input("theta", [len(self.parameters), "B"])
        return w.constant(self.theta, by_row=True) if self.theta.shape[1] > 1 else ""

    def write(self, w: Writer, expressions: Sequence[sp.Expr], z: str, x: str, theta: str) -> str:
        """The values (F, B) of some of them from z (nz, B), x (nx, B) and `theta`, "" for numbers.

        Raises:
            InputError: a formula divides by zero with the parameters of the first set.
        """
        columns = [(z, self.signals), (x, self.states)]
        if theta:
            columns.append((theta, self.parameters))
        else:
            values = zip(self.parameters, self.theta[:, 0].tolist(), strict=True)
            numbers = {sp.Symbol(name): sp.Float(value) for name, value in values}
            expressions = tuple(expression.xreplace(numbers) for expression in expressions)
            if any(expression.has(sp.nan, sp.zoo, sp.oo, -sp.oo, sp.I) for expression in expressions):
                raise InputError(f"{self.place}: a coefficient divides by zero with these parameters; change them")
        used = set().union(*(expression.free_symbols for expression in expressions))
        known = {
            name: w.slice(tensor, 0, column, column + 1)
            for tensor, names in columns
            for column, name in enumerate(names)
            if sp.Symbol(name) in used
        }
        nothing = w("Mul", w.slice(z, 0, 0, 1), w.constant(0.0))  # gives a number its batch
        found = write_formulas(w, expressions, known)
        return w.concat([w("Add", nothing, value) for value in found], axis=0)


def obstacle(expression: sp.Expr) -> str | None:
    """Why a graph cannot have the expression; None if it can."""
    for power in expression.atoms(sp.Pow):
        if not power.exp.is_Rational or power.exp.q & (power.exp.q - 1):
            return "a graph has roots of second, fourth, eighth order only"
    return None


def write_formulas(w: Writer, expressions: Sequence[sp.Expr], values: Mapping[str, str]) -> list[str]:
    """The values of expressions, of which the symbols' are given by name; what they share is computed once."""
    shared, left = sp.cse(list(expressions), symbols=sp.numbered_symbols("shared "))
    known = dict(values)
    for symbol, expression in shared:
        known[symbol.name] = _written(w, expression, known)
    return [_written(w, expression, known) for expression in left]


def _written(w: Writer, e: sp.Expr, values: Mapping[str, str]) -> str:
    if e.is_number:
        return w.constant(float(e))
    if e.is_Symbol:
        return values[e.name]
    if e.is_Add:
        return _sum(w, e, values)
    if e.is_Mul or e.is_Pow:
        return _product(w, e, values)
    [argument] = (_written(w, argument, values) for argument in e.args)
    if type(e) in _OPERATORS:
        return w(_OPERATORS[type(e)], argument)
    size = w("Max", w("Abs", argument), w.constant(SMALLEST))
    assert isinstance(e, sgsqrt | sign), e
    return w("Div", argument, w("Sqrt", size) if isinstance(e, sgsqrt) else size)


def _sum(w: Writer, e: sp.Expr, values: Mapping[str, str]) -> str:
    """Added terms first, then those that are taken away."""
    terms = sorted(sp.Add.make_args(e), key=lambda term: bool(term.as_coeff_Mul()[0].is_negative))
    total = _written(w, terms[0], values)
    for term in terms[1:]:
        if term.as_coeff_Mul()[0].is_negative:
            total = w("Sub", total, _written(w, -term, values))
        else:
            total = w("Add", total, _written(w, term, values))
    return total


def _product(w: Writer, e: sp.Expr, values: Mapping[str, str]) -> str:
    above, below = "", ""
    for factor in sp.Mul.make_args(e):
        base, exponent = factor.as_base_exp() if not factor.is_number else (factor, sp.Integer(1))
        power = _power(w, _written(w, base, values), abs(exponent))
        if exponent.is_negative:
            below = w("Mul", below, power) if below else power
        else:
            above = w("Mul", above, power) if above else power
    if not below:
        return above
    return w("Div", above, below) if above else w("Reciprocal", below)


def _power(w: Writer, base: str, exponent: sp.Rational) -> str:
    """base^exponent by squares and square roots."""
    for _ in range(int(exponent.q).bit_length() - 1):
        base = w("Sqrt", base)
    result, left = "", int(exponent.p)
    while True:
        if left % 2:
            result = w("Mul", result, base) if result else base
        left //= 2
        if not left:
            return result
        base = w("Mul", base, base)

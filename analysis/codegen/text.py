"""Expressions as text that is Python and C99 alike.

Both generated codes do the same operations in the same order, so their results agree to the last bit.
"""

from collections.abc import Mapping
from typing import ClassVar

import sympy as sp

from faultline.analysis.codegen.helpers import LIBRARY
from faultline.analysis.codegen.identifiers import HELPERS
from faultline.analysis.model.functions import exp, log, sign
from faultline.service.core.errors import InputError

_NAMES = {sp.Abs: "fabs", exp: "exponential", log: "logarithm", sign: "signum"}


class Writer:
    """Writes sympy expressions; `names` are the identifiers of their symbols, `numbers` the parameters' values.

    A division by what is no parameter is a call of `divide`, because Python stops at a zero where C goes on.
    """

    _SUM: ClassVar = 1
    _PRODUCT: ClassVar = 2
    _ATOM: ClassVar = 3

    def __init__(self, names: Mapping[str, str], numbers: Mapping[str, float], place: str) -> None:
        self._names = names
        self._numbers = numbers
        self._place = place

    def __call__(self, expression: sp.Expr) -> str:
        """The text of an expression.

        Raises:
            InputError: it divides by parameters that are zero.
        """
        return self._text(expression)[0]

    def _text(self, e: sp.Expr) -> tuple[str, int]:
        if e.is_Symbol:
            return self._names[e.name], self._ATOM
        if e.is_number:
            return number(float(e)), self._SUM if e.is_negative else self._ATOM
        if e.is_Add:
            return self._sum(e), self._SUM
        if e.is_Mul or (e.is_Pow and e.exp.is_negative):
            return self._product(e)
        if e.is_Pow:
            return self._power(e), self._ATOM
        name = _NAMES.get(type(e), type(e).__name__)
        if name not in LIBRARY and name not in HELPERS:
            raise InputError(
                f"{self._place}: {name} cannot be written as code; use + - * / ** and the model's functions"
            )
        return f"{name}({', '.join(self(argument) for argument in e.args)})", self._ATOM

    def _sum(self, e: sp.Expr) -> str:
        text = ""
        signed = [(bool(term.as_coeff_Mul()[0].is_negative), term) for term in e.as_ordered_terms()]
        for negative, term in sorted(signed, key=lambda pair: pair[0]):  # y - p rather than -p + y
            part = self._bracketed(-term if negative else term, self._PRODUCT)
            sign = (" - " if negative else " + ") if text else ("-" if negative else "")
            text += sign + part
        return text

    def _product(self, e: sp.Expr) -> tuple[str, int]:
        coefficient, rest = e.as_coeff_Mul()
        if coefficient.is_negative:
            return "-" + self._bracketed(-e, self._PRODUCT), self._SUM
        above = [] if coefficient == 1 else [number(float(coefficient))]
        constant: list[sp.Expr] = []
        varying: list[sp.Expr] = []
        for factor in sp.Mul.make_args(rest):
            if factor.is_Pow and factor.exp.is_negative:
                below = factor.base ** (-factor.exp)
                (varying if self._varies(below) else constant).append(below)
            else:
                above.append(self._bracketed(factor, self._PRODUCT))
        text = "*".join(above) or "1.0"
        precedence = self._PRODUCT if len(above) > 1 else self._ATOM
        for factor in constant:
            if factor.subs({symbol: self._numbers[symbol.name] for symbol in factor.free_symbols}).is_zero:
                raise InputError(
                    f"{self._place}: divides by {factor}, which is zero with these parameters; change them"
                )
            text += "/" + self._bracketed(factor, self._ATOM)
            precedence = self._PRODUCT
        if varying:
            return f"divide({text}, {self(sp.Mul(*varying))})", self._ATOM
        return text, precedence

    def _power(self, e: sp.Expr) -> str:
        base = self(e.base)
        if e.exp == sp.Rational(1, 2):
            return f"root({base})"
        return f"square({base})" if e.exp == 2 else f"power({base}, {number(float(e.exp))})"

    def _varies(self, e: sp.Expr) -> bool:
        return any(symbol.name not in self._numbers for symbol in e.free_symbols)

    def _bracketed(self, e: sp.Expr, least: int) -> str:
        text, precedence = self._text(e)
        return text if precedence >= least else f"({text})"


def number(value: float) -> str:
    """A float literal that reads back to the same value in both languages."""
    return repr(float(value))


def weighted(terms: Mapping[str, float]) -> str:
    """A sum of products, factor times name; names of one are "" and zeros are left out."""
    text = ""
    for name, factor in terms.items():
        if factor == 0.0:
            continue
        size = abs(factor)
        part = name if name and size == 1.0 else f"{number(size)}*{name}" if name else number(size)
        sign = (" - " if factor < 0 else " + ") if text else ("-" if factor < 0 else "")
        text += sign + part
    return text or "0.0"

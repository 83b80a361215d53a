"""Units: what they are in the International System, and whether a formula adds only what has the same.

Units are those of the International System: `m3/s`, `Pa s`, `kg/(m s2)`, `1` for a plain number. `/` divides by the one
unit after it, so a product below a fraction bar needs parentheses.
"""

import re
from collections.abc import Mapping, Sequence
from fractions import Fraction

import sympy as sp

from faultline.analysis.model.errors import ModelError
from faultline.analysis.model.expression import parse_expression
from faultline.analysis.model.functions import PLAIN, sgsqrt
from faultline.analysis.model.functions import sign as sign_of

Dimension = tuple[Fraction, ...]
"""Exponents of the seven base units."""

SECOND = sp.Symbol("second", positive=True)  # no model's own: those have no assumptions
"""One second: what a derivative is multiplied by to have its state's unit."""


class MismatchError(Exception):
    """Terms of a sum with different units."""


class Dimensions:
    """Dimensions of formulas; None for what has any: zero, a fault variable, a unit that cannot be read."""

    def __init__(self, dimensions: Mapping[str, Dimension], written: Mapping[Dimension, str]) -> None:
        self._dimensions = dimensions
        self._written = written

    def agree(self, terms: Sequence[sp.Expr]) -> Dimension | None:
        """The dimension that all terms have.

        Raises:
            MismatchError: they do not have the same.
        """
        found = [(term, dimension) for term in terms if (dimension := self.of(term)) is not None]
        for term, dimension in found:
            first, expected = found[0]
            if dimension != expected:
                raise MismatchError(f"`{first}` is in {self._text(expected)}, `{term}` in {self._text(dimension)}")
        return found[0][1] if found else None

    def of(self, expression: sp.Expr) -> Dimension | None:
        """The dimension of an expression.

        Raises:
            MismatchError: a sum within has terms of different dimensions.
        """
        if expression == SECOND:
            return _UNITS["s"][1]
        if expression.is_Symbol:
            return self._dimensions.get(expression.name)
        if expression.is_number:
            return None if expression == 0 else _PLAIN
        if expression.is_Add:
            return self.agree(expression.args)
        if expression.is_Mul:
            factors = [self.of(factor) for factor in expression.args]
            known = [dimension for dimension in factors if dimension is not None]
            return _product(known) if len(known) == len(factors) else None
        inner = self.of(expression.args[0])
        if isinstance(expression, PLAIN):
            if inner not in (None, _PLAIN):
                raise MismatchError(
                    f"`{expression.args[0]}` in `{expression}` is in {self._text(inner)}, and must be a plain number"
                )
            return _PLAIN
        if isinstance(expression, sign_of):
            return _PLAIN
        exponent = _exponent(expression)
        return None if inner is None or exponent is None else _power(inner, exponent)

    def _text(self, dimension: Dimension) -> str:
        return self._written.get(dimension) or _text(dimension)


def _exponent(expression: sp.Expr) -> Fraction | None:
    """To which power a power or a function raises the dimension of what is in it; None if it is no such function."""
    if expression.is_Pow and expression.exp.is_Rational:
        return Fraction(expression.exp.p, expression.exp.q)
    if isinstance(expression, sgsqrt):
        return Fraction(1, 2)
    return Fraction(1) if isinstance(expression, sp.Abs) else None


_BASE = ("kg", "m", "s", "A", "K", "mol", "cd")
_PLAIN: Dimension = (Fraction(0),) * len(_BASE)


def _power(dimension: Dimension, exponent: Fraction) -> Dimension:
    return tuple(exponent * e for e in dimension)


def _product(dimensions: Sequence[Dimension]) -> Dimension:
    return tuple(sum(column, Fraction(0)) for column in zip(_PLAIN, *dimensions, strict=True))


def _text(dimension: Dimension) -> str:
    """A dimension in base units."""
    return " ".join(f"{unit}{'' if e == 1 else e}" for unit, e in zip(_BASE, dimension, strict=True) if e) or "1"


def _unit(factor: Fraction | int, *exponents: int) -> tuple[Fraction, Dimension]:
    """A unit as its size in coherent ones, and its dimension with the exponents of mass, length, time.. given."""
    return Fraction(factor), tuple(Fraction(e) for e in (*exponents, *(0,) * (len(_BASE) - len(exponents))))


_UNITS = {
    "g": _unit(Fraction(1, 1000), 1),
    "m": _unit(1, 0, 1),
    "s": _unit(1, 0, 0, 1),
    "A": _unit(1, 0, 0, 0, 1),
    "K": _unit(1, 0, 0, 0, 0, 1),
    "mol": _unit(1, 0, 0, 0, 0, 0, 1),
    "cd": _unit(1, 0, 0, 0, 0, 0, 0, 1),
    "rad": _unit(1),
    "Hz": _unit(1, 0, 0, -1),
    "N": _unit(1, 1, 1, -2),
    "Pa": _unit(1, 1, -1, -2),
    "J": _unit(1, 1, 2, -2),
    "W": _unit(1, 1, 2, -3),
    "C": _unit(1, 0, 0, 1, 1),
    "V": _unit(1, 1, 2, -3, -1),
    "F": _unit(1, -1, -2, 4, 2),
    "Ohm": _unit(1, 1, 2, -3, -2),
    "S": _unit(1, -1, -2, 3, 2),
    "Wb": _unit(1, 1, 2, -2, -1),
    "T": _unit(1, 1, 0, -2, -1),
    "H": _unit(1, 1, 2, -2, -2),
    "L": _unit(Fraction(1, 1000), 0, 3),
    "l": _unit(Fraction(1, 1000), 0, 3),
    "bar": _unit(10**5, 1, -1, -2),
}
"""Units that may have a prefix."""

_PREFIXES = {"n": -9, "u": -6, "m": -3, "c": -2, "d": -1, "h": 2, "k": 3, "M": 6, "G": 9}

_WHOLE_UNITS = {
    "percent": _unit(Fraction(1, 100)),
    "min": _unit(60, 0, 0, 1),
    "h": _unit(3600, 0, 0, 1),
    "t": _unit(1000, 1),
}
"""Units that have no prefix."""

_POWER = re.compile(r"([A-Za-z]+)(?:\^|\*\*)?([+-]?\d+)")
_PRODUCT = re.compile(r"(?<=[\w)]) +(?=[\w(])")
_INNERMOST = re.compile(r"\([^()]*\)")
_AMBIGUOUS = re.compile(r"/.*\*")
_SPELLINGS = {"µ": "u", "Ω": "Ohm", "·": " ", "%": "percent"}


def parse_unit(text: str) -> tuple[Fraction, Dimension]:
    """A unit's size in coherent SI units, and its dimension: exponents of kg, m, s, A, K, mol, cd.

    Raises:
        ValueError: the text is no unit; the message says why.
    """
    formula = " ".join(text.split())
    for sign, spelling in _SPELLINGS.items():
        formula = formula.replace(sign, spelling)
    formula = _PRODUCT.sub("*", _POWER.sub(r"\1**(\2)", formula))
    if _is_ambiguous(formula.replace("**", "")):
        raise ValueError(f"`{text}` can be read in two ways; put a product below a fraction bar in parentheses")
    names = set(re.findall(r"[A-Za-z]+", formula))
    units = {name: unit for name in names if (unit := _prefixed(name)) is not None}
    try:
        expression = parse_expression(formula, sorted(names), text)
    except ModelError as error:
        raise ValueError(f"`{text}` is no unit; write it like m3/s, kg/(m s2) or 1") from error
    number, symbols = expression.as_coeff_Mul()
    if len(units) < len(names) or not number.is_Rational or expression.has(sp.Add, sp.Function) or number <= 0:
        raise ValueError(f"`{text}` is no unit; write it like m3/s, kg/(m s2) or 1")
    powers = [(units[s.name], e) for s, e in symbols.as_powers_dict().items() if s != 1]
    if not all(e.is_Integer for _, e in powers):
        raise ValueError(f"`{text}` has a broken power; give a unit with whole ones")
    size = Fraction(number.p, number.q)
    for (factor, _), exponent in powers:
        size *= factor ** int(exponent)
    return size, _product([_power(dimension, Fraction(int(exponent))) for (_, dimension), exponent in powers])


def _is_ambiguous(formula: str) -> bool:
    """Whether `/` is followed by `*` at the same depth of parentheses."""
    while (group := _INNERMOST.search(formula)) is not None:
        if _AMBIGUOUS.search(group[0]):
            return True
        formula = formula.replace(group[0], "")
    return _AMBIGUOUS.search(formula) is not None


def _prefixed(name: str) -> tuple[Fraction, Dimension] | None:
    """A unit or a multiple of one; None if there is none of that name."""
    if name in _WHOLE_UNITS or name in _UNITS:
        return _WHOLE_UNITS.get(name) or _UNITS[name]
    exponent = _PREFIXES.get(name[0])
    if exponent is None or name[1:] not in _UNITS:
        return None
    factor, dimension = _UNITS[name[1:]]
    return factor * Fraction(10) ** exponent, dimension

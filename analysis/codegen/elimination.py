"""Eliminates the linear part of an algebraic loop line by line, with a name for every coefficient that changes.

Every equation i is a sum over columns: the variables, what is not linear in them (a root, a product), and 1,

    sum_j a_ij c_j = 0

A step solves equation k for variable v, and takes from every other equation i the share of it that rids i of v:

    s_ik = a_iv / a_kv,    a_ij becomes a_ij - s_ik a_kj

The closed form of a loop of n equations has up to n! terms; this has n^2 lines of up to n terms, or 4 n for a ladder.
Only equations that are linear in all variables are used up, and only for variables that are linear in all equations;
the rest is left.

Pivots a_kv are chosen by numbers, the parameters' values and made-up ones for everything else. Among those that are not
small, first come those of parameters alone, as no signal makes them zero; then those that fill in the least (Markowitz
1957); then the model's order.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import sympy as sp

Array = npt.NDArray[np.float64]

CANCELLED = 1e-10
"""A sum that is smaller than this part of its terms is zero but for rounding."""

SMALLEST_PIVOT = 0.1
"""Of the largest coefficient of its variable, each beside the rest of its equation (threshold pivoting)."""

DRAWS = 8

ONE = sp.Integer(1)


class Solved(NamedTuple):
    """A variable, its value, and the equation that it is from.

    With a `part`, which says what it is, it is no variable of the model but an intermediate result; `number` is its
    value if it depends on parameters alone.
    """

    equation: str
    variable: str
    value: sp.Expr
    part: str = ""
    number: float | None = None


@dataclass
class _Coefficient:
    """A sum of terms, with the values (draws,) of the sum and of the sum of the terms' magnitudes."""

    terms: list[sp.Expr]
    value: Array
    size: Array

    def is_zero(self) -> bool:
        return not (np.abs(self.value) > CANCELLED * self.size).any()

    def is_constant(self) -> bool:
        return bool((self.value == self.value[0]).all())

    def less(self, share: "_Coefficient", other: "_Coefficient") -> "_Coefficient":
        product = share.value * other.value
        terms = [*self.terms, -share.terms[0] * other.terms[0]]
        return _Coefficient(terms, self.value - product, self.size + np.abs(product))


_Row = dict[sp.Expr, _Coefficient]
"""The coefficients of an equation by their columns."""


class Elimination:
    """The elimination in a loop; `fresh` gives the parts names that nothing else has.

    `parts` are the lines to begin with; `rest` are the equations that are then left for the variables `left`;
    `solutions` are those of the other variables in terms of these. `numbers` are extended by those of the parts.
    """

    def __init__(
        self,
        equations: Mapping[str, sp.Expr],
        variables: Sequence[sp.Symbol],
        numbers: Mapping[str, float],
        fresh: Callable[[str], str],
    ) -> None:
        self.numbers, self._fresh = dict(numbers), fresh
        self.parts: list[Solved] = []
        self.left = list(variables)
        self._pivots: list[tuple[str, sp.Symbol, _Row]] = []
        rows = {name: _columns(expression, variables) for name, expression in equations.items()}
        curved = {name: {c for c in row if c != ONE and c not in variables} for name, row in rows.items()}
        self.linear = not any(curved.values())
        self._usable = [name for name, columns in curved.items() if not columns]
        self._certain = set(variables).difference(*(c.free_symbols for columns in curved.values() for c in columns))
        with np.errstate(all="ignore"):  # of a negative number, made up or not, there may be no root: NaN
            self._rows = _evaluated(rows, numbers)
            self._scale = {
                name: np.fmax.reduce([np.abs(c.value) for column, c in row.items() if column != ONE], initial=0.0)
                for name, row in self._rows.items()
            }
            while pivot := self._pivot():
                self._eliminate(*pivot)
            for name, row in self._rows.items():
                self._rows[name] = self._named(name, row)
        self.rest = {name: sp.Add(*(c.terms[0] * key for key, c in row.items())) for name, row in self._rows.items()}

    @property
    def solutions(self) -> list[Solved]:
        """What the equations used up give, each in terms of what is left and of those before it."""
        found = []
        for name, variable, row in reversed(self._pivots):
            others = [-c.terms[0] * column for column, c in row.items() if column != variable]
            found.append(Solved(name, variable.name, sp.Add(*others) / row[variable].terms[0]))
        return found

    def _pivot(self) -> tuple[str, sp.Symbol] | None:
        """The next equation to use up and the variable to solve it for."""
        choices: list[tuple[tuple[bool, int], tuple[str, sp.Symbol]]] = []
        for v in (v for v in self.left if v in self._certain):
            column = {name: self._rows[name][v] for name in self._usable if v in self._rows[name]}
            beside = {name: np.abs(c.value) / self._scale[name] for name, c in column.items()}
            largest = np.fmax.reduce([*beside.values()], initial=0.0)
            others = sum(v in row for row in self._rows.values()) - 1
            for name, c in column.items():
                if not c.is_zero() and (beside[name] >= SMALLEST_PIVOT * largest).any():
                    filled = others * (len(self._rows[name].keys() - {ONE}) - 1)
                    choices.append(((not c.is_constant(), filled), (name, v)))
        return min(choices, key=lambda choice: choice[0])[1] if choices else None

    def _eliminate(self, name: str, variable: sp.Symbol) -> None:
        row = self._named(name, self._rows.pop(name))
        self._usable.remove(name)
        self.left.remove(variable)
        self._pivots.append((name, variable, row))
        for other, coefficients in self._rows.items():
            if variable not in coefficients:
                continue
            above, below = coefficients.pop(variable), row[variable]
            quotient = [sp.Add(*above.terms) / below.terms[0]]
            share = _Coefficient(quotient, above.value / below.value, above.size / np.abs(below.value))
            what = f"{other}: the share of {name} to subtract, for {variable} to vanish"
            share = self._part(other, f"{other}_per_{name}", share, what)
            for column, coefficient in row.items():
                if column != variable:
                    old = coefficients.get(column) or _Coefficient([], np.zeros(DRAWS), np.zeros(DRAWS))
                    coefficients[column] = old.less(share, coefficient)

    def _named(self, name: str, row: _Row) -> _Row:
        """A row that is complete, its coefficients as names."""
        found = {}
        for column, coefficient in row.items():
            inside = "_".join(sorted(symbol.name for symbol in column.free_symbols))
            what = f"{name}: {f'coefficient of {column}' if inside else 'what is given'} after the subtractions"
            found[column] = self._part(name, f"{name}_{inside or 'given'}", coefficient, what)
        return {column: coefficient for column, coefficient in found.items() if coefficient.terms[0] != 0}

    def _part(self, equation: str, wanted: str, coefficient: _Coefficient, what: str) -> _Coefficient:
        """The coefficient as a name for its sum, unless that is a name or a number itself."""
        value = sp.Add(*coefficient.terms)
        if value.is_number and coefficient.is_zero():
            value = sp.Integer(0)
        if not (value.is_number or value.is_Atom or (-value).is_Atom):
            name = self._fresh(re.sub(r"\W", "_", wanted))
            number = None
            if {symbol.name for symbol in value.free_symbols} <= self.numbers.keys():
                number = self.numbers[name] = 0.0 if coefficient.is_zero() else float(coefficient.value[0])
            self.parts.append(Solved(equation, name, value, what, number))
            value = sp.Symbol(name)
        return _Coefficient([value], coefficient.value, np.abs(coefficient.value))


def _columns(expression: sp.Expr, variables: Sequence[sp.Symbol]) -> dict[sp.Expr, sp.Expr]:
    """The coefficients of an expression's columns, without zeros."""
    found: dict[sp.Expr, sp.Expr] = {}
    for term in sp.Add.make_args(sp.expand(expression)):
        coefficient, column = term.as_independent(*variables, as_Add=False)
        found[column] = found.get(column, 0) + coefficient
    return {column: coefficient for column, coefficient in found.items() if coefficient != 0}


def _evaluated(rows: Mapping[str, Mapping[sp.Expr, sp.Expr]], numbers: Mapping[str, float]) -> dict[str, _Row]:
    rng = np.random.default_rng(1)
    terms = [coefficient for row in rows.values() for coefficient in row.values()]
    symbols = sorted(set().union(*(term.free_symbols for term in terms)), key=lambda symbol: symbol.name)
    drawn = [
        np.full(DRAWS, numbers[symbol.name]) if symbol.name in numbers else 10 ** rng.uniform(-1, 1, DRAWS)
        for symbol in symbols
    ]
    meaning = {"sgsqrt": lambda d: np.sign(d) * np.sqrt(np.abs(d))}
    values = iter(sp.lambdify(symbols, terms, modules=[meaning, "numpy"], dummify=True)(*drawn))
    found: dict[str, _Row] = {}
    for name, row in rows.items():
        found[name] = {}
        for column, coefficient in row.items():
            value = np.broadcast_to(np.asarray(next(values), dtype=np.float64), DRAWS)
            found[name][column] = _Coefficient([coefficient], value, np.abs(value))
    return found

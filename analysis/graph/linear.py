r"""A test's equations made linear in the new states, where they are not: coefficients are taken at the last ones.

With the states x, those of the last tick x^- and the known signals z of this tick, every rate becomes

    x_i' = sum_j c_ij(x^-, z) sgsqrt(d_j) + sum_k a_ik(x^-, z) x_k + b_i(x^-, z)        d_j affine in x

which is the idea of the chord conductance for what is not a root. Where a choice is left:

    f(x) (flows and affine terms)    a capacity, which the step has as one: 1/f at x^-
    c(x, z) sgsqrt(d)                an opening: c at x^-
    g(x, z)                          what is smooth otherwise: g(x^-) + dg/dx(x^-) (x - x^-), exact to second order
    sgsqrt(c(x, z) d), d affine      sgsqrt(c) sgsqrt(d), an opening
    sgsqrt(d + g(x, z))              g at x^-

Coefficients that are no constants are *formulas*: they act as further signals whose value is known before the step.
What a sensor shows other than in proportion is its *reading*, a formula of the new states: known after the step, exact.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import sympy as sp

from faultline.analysis.graph.formula import obstacle
from faultline.analysis.model import sgsqrt
from faultline.analysis.model.slope import Sign, slope
from faultline.service.core.errors import InputError

TINY = 1e-30
"""Beside |x| in the denominator of its slope, which has none at zero; small in all SI units."""

SMALL = 0.1
"""Of the slope of a root's argument: so much may be of the last state, as it then is forgotten from tick to tick."""


@dataclass(frozen=True)
class Linear:
    """Rates and output of a test, linear in the states but for roots; `formulas` by the symbols that stand for them.

    A rate is (1 + capacity) x'; a capacity is zero or a symbol. The whole output is `output` + `reading`; the reading
    has the symbols of the states at the `last` tick, of the tick after its step.
    """

    rates: list[sp.Expr]
    capacities: list[sp.Expr]
    output: sp.Expr
    formulas: dict[sp.Symbol, sp.Expr]
    reading: sp.Expr


def last(test: str, state: str) -> sp.Symbol:
    """The symbol of a test's state at the last tick."""
    return sp.Symbol(f"{test}.{state}")


def linear_form(
    test: str,
    states: Sequence[str],
    middle: Mapping[sp.Symbol, sp.Expr],
    numbers: Mapping[sp.Symbol, sp.Expr],
    rates: list[sp.Expr],
    output: sp.Expr,
    place: str,
) -> Linear:
    """The form above for the rates of the `states`, written as the model groups them, and the `output`.

    `middle` are the signals in the middle of their ranges, `numbers` the values of parameters and faults.

    Raises:
        InputError: a root of a state is in a root, or flows are multiplied.
    """
    found = _Form(test, states, list(middle), {**middle, **numbers}, place)
    rows = [found.rate(rate) for rate in rates]
    balances, capacities = [sp.expand(row[0]) for row in rows], [row[1] for row in rows]
    affine, reading = found.output(output)
    return Linear(balances, capacities, sp.expand(affine), found.formulas, reading)


@dataclass
class _Form:
    test: str
    names: Sequence[str]
    signals: Sequence[sp.Symbol]
    numbers: Mapping[sp.Symbol, sp.Expr]
    place: str
    formulas: dict[sp.Symbol, sp.Expr] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.states = [sp.Symbol(name) for name in self.names]
        self.at_last = {sp.Symbol(name): last(self.test, name) for name in self.names}
        self.varying = [*self.signals, *self.at_last.values()]

    def rate(self, rate: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
        """One rate in the form above, and its capacity."""
        rate, roots = self._without_roots(rate)
        factor, rest = self._capacity(rate, roots)
        total = sp.Integer(0)
        for symbol, argument in roots.items():
            opening = sp.diff(rest, symbol)
            if opening.free_symbols & roots.keys():
                raise self._refused("multiplies flows", rest, "write it as a sum of flows")
            if {f.as_base_exp()[0] for f in sp.Mul.make_args(opening)} & argument.free_symbols & set(self.states):
                raise self._refused("a flow is multiplied by its own state", opening, "write it without that factor")
            scale, argument = self._argument(argument)
            total += self._coefficient(self._held(opening) * scale) * sgsqrt(argument)
        slopes, given = self._tangent(rest.xreplace(dict.fromkeys(roots, sp.Integer(0))))
        total += sum(self._gain(steep) * state for state, steep in slopes.items())
        capacity = expanded(1 / factor - 1)
        return total + self._given(given), self._formula(capacity, gain=False) if capacity != 0 else capacity

    def output(self, output: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
        """Return the part of the output that is affine in the states, and the reading."""
        kept, moved = self._split(expanded(output))
        if not moved.free_symbols & set(self.states):
            return kept + self._coefficient(moved), sp.Integer(0)
        reading = self._held(moved)
        self._check_written(reading)
        return kept, reading

    def _held(self, expression: sp.Expr) -> sp.Expr:
        """The expression at the last states."""
        return expression.xreplace(self.at_last)

    def _without_roots(self, expression: sp.Expr) -> tuple[sp.Expr, dict[sp.Symbol, sp.Expr]]:
        """The expression with symbols for its outermost roots, and their arguments; equal arguments are one root."""
        calls = sorted(expression.atoms(sgsqrt), key=sp.default_sort_key)
        inner = {call for outer in calls for call in outer.args[0].atoms(sgsqrt)}
        roots: dict[sp.Symbol, sp.Expr] = {}
        symbols: dict[sp.Expr, sp.Symbol] = {}
        for call in calls:
            if call in inner and call.free_symbols & set(self.states):
                raise self._refused("a flow is in a root", call, "give the state between them a storage")
            argument = expanded(call.args[0])
            known = next((symbol for symbol, other in roots.items() if other == argument), None)
            symbols[call] = known or sp.Symbol(f"root {len(roots)}")
            roots[symbols[call]] = argument
        replaced = expression.xreplace(symbols)
        return replaced, {symbol: a for symbol, a in roots.items() if symbol in replaced.free_symbols}

    def _capacity(self, rate: sp.Expr, roots: dict[sp.Symbol, sp.Expr]) -> tuple[sp.Expr, sp.Expr]:
        """What multiplies a whole balance of flows and depends on states, at the last ones; and the balance."""
        factors = sp.Mul.make_args(rate)
        if not any(factor.is_Add and factor.free_symbols & roots.keys() for factor in factors):
            return sp.Integer(1), rate
        outside = [f for f in factors if f.free_symbols & set(self.states) and not f.free_symbols & roots.keys()]
        return self._held(sp.Mul(*outside)), sp.Mul(*(f for f in factors if f not in outside))

    def _argument(self, argument: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
        """A root as a scale, known before the step, times the root of an affine argument."""
        found = self._affine(argument)
        first = next((state for state in self.states if state in argument.free_symbols), None)
        if found is None and first is not None:
            scale = slope(argument, first)
            scaled = self._affine(expanded(argument / scale)) if scale != 0 else None
            if scaled is not None:
                return sgsqrt(self._held(scale)), scaled
        if found is None:
            kept, moved = self._split(argument)
            self._check_small(kept, moved)
            found = kept + self._coefficient(self._held(moved))
        return sp.Integer(1), found

    def _check_small(self, kept: sp.Expr, moved: sp.Expr) -> None:
        """Of a state that a root acts upon little may be taken at the last tick, or the flow swings to and fro."""
        for state in self.states:
            own = slope(kept, state)
            share = slope(moved, state) / own if own != 0 else sp.Integer(0)
            value = share.xreplace(self.numbers)
            if not value.is_number or not abs(value) <= SMALL:
                raise self._refused(f"a root has {state} in it other than in proportion", moved, "make it a sum")

    def _affine(self, expression: sp.Expr) -> sp.Expr | None:
        """The expression with constants for its states and formulas of signals alone; None if it is no such thing."""
        kept, moved = self._split(expression)
        if moved.free_symbols & set(self.states):
            return None
        return kept + self._coefficient(moved)

    def _split(self, expression: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
        """The terms of an expanded sum that are affine in states and signals, and the others."""
        affine = {sp.Integer(1), *self.states, *self.signals}
        terms = sp.Add.make_args(expression)
        fits = [term.as_independent(*self.states, *self.varying, as_Add=False)[1] in affine for term in terms]
        kept = [term for term, fit in zip(terms, fits, strict=True) if fit]
        return sp.Add(*kept), sp.Add(*(term for term, fit in zip(terms, fits, strict=True) if not fit))

    def _tangent(self, smooth: sp.Expr) -> tuple[dict[sp.Symbol, sp.Expr], sp.Expr]:
        """The tangent at the last states: by state its slope, and what is given."""
        kept, moved = self._split(expanded(smooth))
        slopes = {state: kept.coeff(state) for state in self.states}
        given = kept - sum(gain * state for state, gain in slopes.items()) + self._held(moved)
        for state in self.states:
            steep = self._held(slope(moved, state))
            slopes[state] += steep
            given -= steep * self.at_last[state]
        return slopes, expanded(sp.expand(given))

    def _gain(self, steep: sp.Expr) -> sp.Expr:
        """A slope as a constant and a formula."""
        constant, moved = expanded(steep).as_independent(*self.varying, as_Add=True)
        return constant + (self._formula(moved) if moved != 0 else moved)

    def _given(self, given: sp.Expr) -> sp.Expr:
        """What is given as a sum that is affine in the signals, and a formula."""
        kept, moved = self._split(given)
        return kept + self._coefficient(moved)

    def _coefficient(self, coefficient: sp.Expr) -> sp.Expr:
        """The coefficient as it is, where it is affine in the signals, or as a formula."""
        whole = expanded(coefficient)
        return whole if self._split(whole)[1] == 0 else self._formula(coefficient)

    def _formula(self, coefficient: sp.Expr, *, gain: bool = True) -> sp.Expr:
        """The coefficient as a symbol for what varies, times parameters if it may have a gain."""
        factor, varying = coefficient.as_independent(*self.varying, as_Add=False) if gain else (sp.S.One, coefficient)
        varying = varying.replace(Sign, lambda x: x / (sp.Abs(x) + sp.Float(TINY)))
        self._check_written(varying)
        symbol = next((symbol for symbol, other in self.formulas.items() if other == varying), None)
        if symbol is None:
            symbol = sp.Symbol(f"{self.test} formula {len(self.formulas) + 1}")
            self.formulas[symbol] = varying
        return factor * symbol

    def _check_written(self, formula: sp.Expr) -> None:
        reason = obstacle(formula)
        if reason is not None:
            raise self._refused(reason, formula, "write it in another form")

    def _refused(self, reason: str, where: sp.Expr, remedy: str) -> InputError:
        text = str(where)
        short = text if len(text) <= 60 else f"{text[:57]}..."
        return InputError(f"{self.place}: {reason}, {short}; the implicit step cannot solve it: {remedy}")


def expanded(expression: sp.Expr) -> sp.Expr:
    """The expression as a sum of products, in which sums below fraction bars and in functions stay whole.

    So what is above and below a fraction bar cancels: a pump's efficiency divides by its speed, its flow does not.

    >>> n, k, p = sp.symbols("n k p")
    >>> expanded(n*(1 - p/n)/(1 + k))
    n/(k + 1) - p/(k + 1)
    """
    whole: dict[sp.Expr, sp.Symbol] = {}
    for e in sp.postorder_traversal(expression):
        below = e.is_Pow and not e.base.is_Symbol and not (e.exp.is_Integer and e.exp.is_positive)
        if (below or isinstance(e, sp.Function)) and not e.is_number:
            whole.setdefault(e, sp.Symbol(f"whole {len(whole)}"))
    back = {symbol: e for e, symbol in whole.items()}
    return sp.expand(expression.xreplace(whole)).xreplace(back)

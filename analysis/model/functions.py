"""The functions of formulas. Opaque to sympy, whose own rules would turn them into forms that nothing here can write.

The lesser and the greater of two are sums with a size, min(a, b) = (a + b - |a - b|) / 2, with its slope. A curve is
a sum of roots (`analysis.model.curves`). So derivatives, graphs, generated code and simulation know the functions of
this file, powers and sizes alone.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import reduce

import sympy as sp


class sgsqrt(sp.Function):  # type: ignore[misc]  # noqa: N801  (sympy is untyped; this is its name in formulas)
    """sgsqrt(d) = sign(d) sqrt(|d|): the orifice equation (4.2) for both directions of flow.

    sympy's own rules turn sign(d)*sqrt(Abs(d)) into piecewise forms that lose a direction.
    """

    nargs = 1

    @classmethod
    def eval(cls, d: sp.Expr) -> sp.Expr | None:
        """A number has its value; None leaves everything else as it is."""
        return sp.sign(d) * sp.sqrt(abs(d)) if d.is_number else None


class exp(sp.Function):  # type: ignore[misc]  # noqa: N801
    """The exponential function."""

    nargs = 1

    @classmethod
    def eval(cls, x: sp.Expr) -> sp.Expr | None:
        """Return a number's value."""
        return sp.exp(x) if x.is_number else None

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        """Return the derivative."""
        del argindex
        return self


class log(sp.Function):  # type: ignore[misc]  # noqa: N801
    """The natural logarithm."""

    nargs = 1

    @classmethod
    def eval(cls, x: sp.Expr) -> sp.Expr | None:
        """Return a number's value."""
        return sp.log(x) if x.is_number else None

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        """Return the derivative."""
        del argindex
        return 1 / self.args[0]


class tanh(sp.Function):  # type: ignore[misc]  # noqa: N801
    """The hyperbolic tangent."""

    nargs = 1

    @classmethod
    def eval(cls, x: sp.Expr) -> sp.Expr | None:
        """Return a number's value."""
        return sp.tanh(x) if x.is_number else None

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        """Return the derivative."""
        del argindex
        return 1 - self**2


class sign(sp.Function):  # type: ignore[misc]  # noqa: N801
    """The sign of a number: -1, 0 or 1. Its slope is zero, as that at the step is no number."""

    nargs = 1

    @classmethod
    def eval(cls, x: sp.Expr) -> sp.Expr | None:
        """Return a number's value."""
        return sp.sign(x) if x.is_number else None

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        """Return the derivative."""
        del argindex
        return sp.Integer(0)


def _least(a: sp.Expr, b: sp.Expr) -> sp.Expr:
    return (a + b - sp.Abs(a - b)) / 2


def _greatest(a: sp.Expr, b: sp.Expr) -> sp.Expr:
    return (a + b + sp.Abs(a - b)) / 2


SINGLE: Mapping[str, Callable[[sp.Expr], sp.Expr]] = {
    "sgsqrt": sgsqrt,
    "abs": sp.Abs,
    "exp": exp,
    "log": log,
    "tanh": tanh,
    "sign": sign,
}
"""Functions of one argument, by their names in formulas."""

SEVERAL: Mapping[str, Callable[[sp.Expr, sp.Expr], sp.Expr]] = {"min": _least, "max": _greatest}
"""Functions of two or more."""

PLAIN = (exp, log, tanh)
"""Functions of plain numbers, that have no unit."""


def called(name: str, arguments: Sequence[sp.Expr]) -> sp.Expr | None:
    """Return the value of a function of formulas; None where there is no such function of so many arguments."""
    if name in SINGLE and len(arguments) == 1:
        return SINGLE[name](arguments[0])
    if name in SEVERAL and len(arguments) > 1:
        return reduce(SEVERAL[name], arguments)
    return None

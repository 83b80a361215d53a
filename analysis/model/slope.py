"""Derivatives of a model's formulas: symbols are real, so the size |x| has a slope, which sympy's own has not."""

import sympy as sp


def slope(expression: sp.Expr, symbol: sp.Symbol) -> sp.Expr:
    """The derivative; the slope of |x| is `Sign` of x, opaque to sympy so that differences in x stay grouped."""
    if symbol not in expression.free_symbols:
        return sp.Integer(0)
    if not expression.has(sp.Abs):
        return sp.diff(expression, symbol)
    return sp.diff(expression.replace(sp.Abs, _Size), symbol).replace(_Size, sp.Abs)


class Sign(sp.Function):  # type: ignore[misc]  # sympy is untyped
    """The slope of |x|: who takes it says what it is at zero."""

    nargs = 1


class _Size(sp.Function):  # type: ignore[misc]
    """|x| for real x."""

    nargs = 1

    def fdiff(self, argindex: int = 1) -> sp.Expr:
        """The sign."""
        del argindex
        return Sign(self.args[0])

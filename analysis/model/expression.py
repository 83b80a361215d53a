"""Formulas of a model file: text to sympy through a whitelist of syntax; nothing of the text is ever evaluated.

Allowed are numbers, declared names, + - * / **, unary minus and plus, parentheses, and calls of the functions of
`analysis.model.functions` and of the model's own curves. An exponent is a constant whole or rational number of at most
16 in numerator and denominator.
"""

import ast
import re
import warnings
from collections.abc import Collection

import sympy as sp

from faultline.analysis.model.curves import NO_CURVES, Curves
from faultline.analysis.model.errors import ModelError
from faultline.analysis.model.functions import SEVERAL, SINGLE, called

MAXIMUM_LENGTH = 1000
MAXIMUM_DEPTH = 60
MAXIMUM_EXPONENT = 16
MAXIMUM_NUMBER = 1e100

_CHARACTERS = re.compile(r"[A-Za-z0-9_+\-*/()., \t\r\n]*")


FUNCTIONS = frozenset({*SINGLE, *SEVERAL})
"""Names that no variable may have."""


def parse_expression(text: str, names: Collection[str], place: str, curves: Curves = NO_CURVES) -> sp.Expr:
    """The formula in `text` over the declared `names`, as plain sympy symbols; `curves` are further functions.

    Raises:
        ModelError: anything outside the whitelist above; the message begins with `place`.
    """
    if len(text) > MAXIMUM_LENGTH:
        raise ModelError(f"{place}: {len(text)} characters; split formulas longer than {MAXIMUM_LENGTH}")
    good = _CHARACTERS.match(text)
    if good and good.end() < len(text):
        power = "; a power is written **" if text[good.end()] == "^" else ""
        raise ModelError(f"{place}: character {text[good.end()]!r} has no place in a formula: {_short(text)}{power}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about literals like `1or`, which are refused below
            tree = ast.parse(" ".join(text.split()), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ModelError(f"{place}: not a formula: {_short(text)}; write it like `a*(b - c)/d**2`") from error
    return _Reader(names, place, curves).read(tree, 0)


class _Reader:
    """Walks a syntax tree, building the sympy expression from the allowed kinds of node."""

    def __init__(self, names: Collection[str], place: str, curves: Curves) -> None:
        self._names = names
        self._place = place
        self._curves = curves

    def read(self, node: ast.expr, depth: int) -> sp.Expr:
        """The expression of a node `depth` levels below the top."""
        if depth > MAXIMUM_DEPTH:
            raise ModelError(f"{self._place}: nested deeper than {MAXIMUM_DEPTH} levels; give parts names of their own")
        if isinstance(node, ast.BinOp):
            value = self._operation(node, depth)
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
            operand = self.read(node.operand, depth + 1)
            value = -operand if isinstance(node.op, ast.USub) else operand
        elif isinstance(node, ast.Call):
            value = self._call(node, depth)
        elif isinstance(node, ast.Name):
            value = self._name(node.id)
        else:
            value = self._number(node)
        if value.has(sp.nan, sp.zoo, sp.oo, -sp.oo, sp.I):
            raise ModelError(f"{self._place}: {_short(ast.unparse(node))} divides by zero or is no real number")
        if value.is_number and not abs(value) < MAXIMUM_NUMBER:
            raise ModelError(f"{self._place}: the number {_short(ast.unparse(node))} is too large")
        return value

    def _operation(self, node: ast.BinOp, depth: int) -> sp.Expr:
        left = self.read(node.left, depth + 1)
        if isinstance(node.op, ast.Pow):
            return self._power(left, node, depth)
        right = self.read(node.right, depth + 1)
        match node.op:
            case ast.Add():
                return left + right
            case ast.Sub():
                return left - right
            case ast.Mult():
                return left * right
            case ast.Div():
                return left / right
        raise ModelError(f"{self._place}: operator in {_short(ast.unparse(node))} is not one of + - * / **")

    def _power(self, base: sp.Expr, node: ast.BinOp, depth: int) -> sp.Expr:
        value = self.read(node.right, depth + 1)
        exponent = sp.nsimplify(value, rational=True) if value.is_number else value
        power = base**exponent if exponent.is_Rational and _small(exponent) else sp.nan
        if power is sp.nan or not all(_small(p.exp) for p in power.atoms(sp.Pow)):
            raise ModelError(
                f"{self._place}: {_short(ast.unparse(node))}: an exponent must be a constant fraction of whole numbers "
                f"up to {MAXIMUM_EXPONENT}"
            )
        return power

    def _call(self, node: ast.Call, depth: int) -> sp.Expr:
        name = node.func.id if isinstance(node.func, ast.Name) and not node.keywords else ""
        arguments = [self.read(each, depth + 1) for each in node.args]
        curve = self._curves.get(name)
        fits = curve is not None and curve.count == len(arguments)
        value = curve(*arguments) if curve is not None and fits else called(name, arguments)
        if value is None:
            known = ", ".join(f"{each}(x)" for each in SINGLE)
            several = "".join(f", {each}(x, y)" for each in SEVERAL)
            own = "".join(f", {each}({'x, y'[: 3 * of.count - 2]})" for each, of in self._curves.items())
            raise ModelError(f"{self._place}: {_short(ast.unparse(node))} is no call of {known}{several}{own}")
        return value

    def _name(self, name: str) -> sp.Expr:
        if name not in self._names:
            raise ModelError(f"{self._place}: unknown name {name!r}; known names are {', '.join(self._names)}")
        return sp.Symbol(name)

    def _number(self, node: ast.expr) -> sp.Expr:
        value = node.value if isinstance(node, ast.Constant) else None
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise ModelError(
                f"{self._place}: {_short(ast.unparse(node))} is not allowed; a formula has numbers, names, "
                "+ - * / ** and calls as abs(x)"
            )
        if not abs(value) < MAXIMUM_NUMBER:
            raise ModelError(f"{self._place}: the number {_short(ast.unparse(node))} is too large")
        return sp.Integer(value) if isinstance(value, int) else sp.Float(value)


def _small(exponent: sp.Rational) -> bool:
    return bool(max(abs(exponent.p), exponent.q) <= MAXIMUM_EXPONENT)


def _short(text: str) -> str:
    """Enough of `text` to find it by, on one line."""
    line = " ".join(text.split())
    return f"`{line}`" if len(line) <= 60 else f"`{line[:57]}...`"

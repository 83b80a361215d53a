"""Formulas: what is read, and what is refused before anything could happen."""

import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

from faultline.analysis.model import ModelError, sgsqrt
from faultline.analysis.model.expression import parse_expression

A, B = sp.symbols("a b")
NAMES = ("a", "b")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a + 2*b", A + 2 * B),
        ("-a/(b - 1)", -A / (B - 1)),
        ("+a - -b", A + B),
        ("a**2 - b**(1/2)", A**2 - sp.sqrt(B)),
        ("a**-0.5", A ** sp.Rational(-1, 2)),
        ("1.5e-3*a", sp.Float(1.5e-3) * A),
        ("sgsqrt(2/a*(a - b))", sgsqrt(2 / A * (A - B))),
        ("abs(a)", sp.Abs(A)),
        ("a\n  + b", A + B),
        ("7", sp.Integer(7)),
    ],
)
def test_formulas_become_sympy(text: str, expected: sp.Expr) -> None:
    assert parse_expression(text, NAMES, "here") == expected


def test_sgsqrt_is_opaque_for_variables_and_known_for_numbers() -> None:
    assert sgsqrt(A - B).free_symbols == {A, B}
    assert sp.expand(3 * sgsqrt(A - B)).coeff(sgsqrt(A - B)) == 3
    assert [float(sgsqrt(d)) for d in (-4, 0, 2.25)] == [-2.0, 0.0, 1.5]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a + c", "here: unknown name 'c'; known names are a, b"),
        ("a^2", "here: character '^' has no place in a formula: `a^2`; a power is written **"),
        ("__import__('os')", "here: character \"'\" has no place in a formula: `__import__('os')`"),
        (
            "__import__(a)",
            "here: `__import__(a)` is no call of sgsqrt(x), abs(x), exp(x), log(x), tanh(x), sign(x), min(x, y), max(",
        ),
        ("a.__class__", "here: `a.__class__` is not allowed"),
        ("(a).is_real", "here: `a.is_real` is not allowed"),
        ("lambda: a", "here: character ':' has no place"),
        ("[a]", "here: character '[' has no place"),
        ("a if b else a", "here: `a if b else a` is not allowed"),
        ("a, b", "here: `(a, b)` is not allowed"),
        ("True", "here: `True` is not allowed"),
        ("1j*a", "here: `1j` is not allowed"),
        ("a // b", "here: operator in `a // b` is not one of"),
        ("sgsqrt(a, b)", "here: `sgsqrt(a, b)` is no call of"),
        ("sgsqrt()", "here: `sgsqrt()` is no call of"),
        ("abs(*a)", "here: `*a` is not allowed"),
        ("abs(a)(b)", "here: `abs(a)(b)` is no call of"),
        ("a**17", "here: `a ** 17`: an exponent must be"),
        ("9**9**9**9", "here: `9 ** 9 ** 9`: an exponent must be"),
        ("(a**16)**16", "here: `(a ** 16) ** 16`: an exponent must be"),
        ("a**b", "here: `a ** b`: an exponent must be"),
        ("a**0.333", "here: `a ** 0.333`: an exponent must be"),
        ("((10**16)**16)*a", "here: the number `(10 ** 16) ** 16` is too large"),
        ("1e999*a", "here: the number `1e309` is too large"),
        ("9" * 200, "here: the number `" + "9" * 57 + "...` is too large"),
        ("a/0", "here: `a / 0` divides by zero or is no real number"),
        ("a/(b - b)", "here: `a / (b - b)` divides by zero"),
        ("(-2)**0.5", "here: `(-2) ** 0.5` divides by zero or is no real number"),
        ("a +", "here: not a formula: `a +`; write it like"),
        ("", "here: not a formula"),
        ("a 1or b", "here: not a formula"),
        ("a ü b", "here: character 'ü' has no place"),
        ("a + " * 400 + "a", "here: 1601 characters; split formulas longer than 1000"),
        ("-" * 100 + "a", "here: nested deeper than 60 levels"),
        ("(" * 400 + "a" + ")" * 400, "here: not a formula"),
    ],
)
def test_everything_else_is_refused_with_its_place(text: str, message: str) -> None:
    with pytest.raises(ModelError) as error:
        parse_expression(text, NAMES, "here")
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)


@settings(derandomize=True, deadline=None, max_examples=200)
@given(st.text("ab()+-*/.,_ 019eE\tsgqrt", max_size=30) | st.text(max_size=30))
def test_any_text_is_a_formula_or_a_model_error(text: str) -> None:
    try:
        found = parse_expression(text, NAMES, "here")
    except ModelError:
        return
    assert found.free_symbols <= {A, B}

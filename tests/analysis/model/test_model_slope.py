"""Slopes of formulas in real symbols."""

import sympy as sp

from faultline.analysis.model.slope import Sign, slope


def test_the_slope_of_a_size_is_its_sign() -> None:
    x, y = sp.symbols("x y")
    found = slope(abs(x - y) * x, x).replace(Sign, sp.sign)
    assert found.subs({x: 2, y: 5}) == 3 - 2


def test_what_is_not_there_has_no_slope() -> None:
    x, y = sp.symbols("x y")
    assert slope(abs(y), x) == 0

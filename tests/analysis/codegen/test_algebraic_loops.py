"""Equations and loops are solved where the solution is the only one, and refused by name where it may not be."""

from collections.abc import Callable

import pytest
import sympy as sp
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from analysis.codegen import computation_sequence, residual_program
from analysis.codegen.loops import solve_component
from analysis.model import load_model
from analysis.model.expression import parse_expression
from analysis.structure import mtes_sets, structure_of
from service.core.errors import InputError

NAMES = ["x", "y", "w", "a", "b", "c"]
MEANING: dict[str, Callable[..., float]] = {
    "sgsqrt": lambda d: (1.0 if d >= 0 else -1.0) * abs(d) ** 0.5,
    "sgsquare": lambda s: s * abs(s),
    "unrooted": lambda s: s * s if s >= 0 else float("nan"),
    "loaded": lambda d, z: (1.0 if d >= 0 else -1.0) * 2 * abs(d) / (z + (z * z + 4 * abs(d)) ** 0.5),
}
numbers = st.floats(-5, 5).map(lambda value: round(value, 3))
positive = st.floats(0.1, 5).map(lambda value: round(value, 3))


def solve(texts: list[str], variables: list[str], values: dict[str, float]) -> dict[str, float]:
    """Solves for numbers, with everything else given."""
    equations = {f"e{k}": parse_expression(text, NAMES, "test") for k, text in enumerate(texts)}
    found = dict(values)
    for name, solution in solve_component(equations, variables, values, "test"):
        function = sp.lambdify([sp.Symbol(key) for key in found], solution, modules=[MEANING, "math"])
        found[name] = float(function(*found.values()))
    return found


def error(text: str, values: dict[str, float]) -> float:
    expression = parse_expression(text, NAMES, "test")
    function = sp.lambdify([sp.Symbol(key) for key in values], expression, modules=[MEANING, "math"])
    return float(function(*values.values()))


ALONE = ["a*x + b", "b + a*sgsqrt(c*x - b)", "a*x - b + c*sgsqrt(x - b)", "a*x + b*sgsqrt(c*x + 1) - 3"]


@pytest.mark.parametrize("text", ALONE)
@settings(max_examples=30, deadline=None)
@given(a=positive, b=positive, c=positive)
def test_one_equation_holds_with_its_solution(text: str, a: float, b: float, c: float) -> None:
    found = solve([text], ["x"], {"a": a, "b": b, "c": c})
    assert error(text, found) == pytest.approx(0.0, abs=1e-8 * (1 + abs(found["x"])))


def test_a_square_root_is_undone_where_it_can_be() -> None:
    assert solve(["(x - a)**(1/2) - b"], ["x"], {"a": 1.0, "b": 3.0})["x"] == 10.0
    negative = solve(["(x - a)**(1/2) - b"], ["x"], {"a": 1.0, "b": -3.0})["x"]
    assert negative != negative  # NaN: no root is negative


@settings(max_examples=30, deadline=None)
@given(st.lists(numbers, min_size=9, max_size=9), numbers, numbers)
def test_a_linear_loop_is_solved_exactly(entries: list[float], a: float, b: float) -> None:
    rows = [entries[0:3], entries[3:6], entries[6:9]]
    assume(abs(float(sp.Matrix(rows).det())) > 0.1)
    texts = [
        "+".join(f"({g})*{v}" for g, v in zip(row, "xyw", strict=True)) + f" - {sign}*a - b"
        for row, sign in zip(rows, (1, -1, 2), strict=True)
    ]
    if any(v not in text for v in "xyw" for text in texts):
        return
    found = solve(texts, ["x", "y", "w"], {"a": a, "b": b})
    for text in texts:
        assert error(text, found) == pytest.approx(0.0, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(a=positive, b=numbers, c=positive)
def test_an_orifice_fed_through_a_resistance_is_solved_exactly(a: float, b: float, c: float) -> None:
    texts = ["x - a*sgsqrt(y - 1)", "y - (b - c*x)"]
    found = solve(texts, ["x", "y"], {"a": a, "b": b, "c": c})
    for text in texts:
        assert error(text, found) == pytest.approx(0.0, abs=1e-8)


REFUSED = [
    (["x**2 - a"], ["x"], "e0 cannot be solved for x: it is not linear in x and may have several solutions"),
    (["abs(x) - a"], ["x"], "may have several solutions"),
    (["x - a*sgsqrt(b - x) - 1"], ["x"], None),  # both terms rise with x: one solution
    (["x + a*sgsqrt(b - x) - 1"], ["x"], "inside .* and outside"),
    (["x*y - a", "x + y - b"], ["x", "y"], "the algebraic loop e0, e1 cannot be solved for x, y"),
    (["x + y - a", "2*x + 2*y - b"], ["x", "y"], "its linear equations are dependent"),
    (["a*x - 1"], ["x"], "the coefficient of x is zero"),
]


@pytest.mark.parametrize(("texts", "variables", "reason"), REFUSED)
def test_several_solutions_are_refused_with_the_reason(
    texts: list[str], variables: list[str], reason: str | None
) -> None:
    values = {"a": 0.0 if reason and "coefficient" in reason else 2.0, "b": 3.0, "c": 1.0}
    if reason is None:
        solve(texts, variables, values)
        return
    with pytest.raises(InputError, match=reason):
        solve(texts, variables, values)


def test_the_square_roots_of_the_one_state_model_are_refused_and_their_loop_is_named() -> None:
    """Thesis 7.3: the pressures of the one-state model leave two roots open for the flow."""
    model = load_model("uds1")
    widest = mtes_sets(structure_of(model))[-1]
    sequence = computation_sequence(model, widest, "e10")
    with pytest.raises(InputError, match=r"algebraic loop e01, e02, e06, e07, e08 cannot be solved for .*several"):
        residual_program(model, sequence, name="uds1_t15")

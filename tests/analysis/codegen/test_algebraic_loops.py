"""Equations and loops are solved where the solution is the only one, and refused by name where it may not be."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
import sympy as sp
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from faultline.analysis.codegen import computation_sequence, residual_program
from faultline.analysis.codegen.identifiers import Names
from faultline.analysis.codegen.loops import solve_component
from faultline.analysis.model import load_model
from faultline.analysis.model.expression import parse_expression
from faultline.analysis.structure import mtes_sets, structure_of
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]

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
    names = [*NAMES, *variables, *values]
    equations = {f"e{k}": parse_expression(text, names, "test") for k, text in enumerate(texts)}
    found = dict(values)
    for solved in solve_component(equations, variables, values, "test", Names().fresh):
        function = sp.lambdify([sp.Symbol(key) for key in found], solved.value, modules=[MEANING, "math"])
        found[solved.variable] = float(function(*found.values()))
    return found


def error(text: str, values: dict[str, float]) -> float:
    expression = parse_expression(text, [*values], "test")
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


def weighted(row: Array) -> str:
    """The left-hand side of a linear equation, without its zeros."""
    return " + ".join(f"({weight!r})*x{j}" for j, weight in enumerate(row.tolist()) if weight)


def made(kind: str, n: int) -> Array:
    """The matrix of a loop: `dense`, also one that is `small` where it begins; the `ladder` of resistors between
    neighbours; the `star` of resistors between the first node and all others; two `blocks` beside the diagonal."""
    matrix = np.round(np.random.default_rng(n).uniform(-2, 2, (n, n)), 3)
    if kind in ("dense", "small"):
        matrix[0, 0] *= 1e-14 if kind == "small" else 1
        return matrix
    if kind in ("ladder", "star"):
        sparse = np.zeros((n, n))
        sparse[0, :], sparse[:, 0] = matrix[0, :], matrix[:, 0]
        return (np.triu(np.tril(matrix, 1), -1) if kind == "ladder" else sparse) + 5 * np.eye(n)
    empty = np.zeros((n // 2, n // 2))
    return np.block([[empty, matrix[: n // 2, : n // 2]], [matrix[n // 2 :, n // 2 :], empty]])


@pytest.mark.parametrize(
    ("kind", "n"), [("ladder", 12), ("dense", 8), ("blocks", 8), ("small", 5), ("ladder", 30), ("star", 12)]
)
def test_a_large_linear_loop_is_solved_as_numpy_does(kind: str, n: int) -> None:
    """The wound: a closed form of five equations had a line of thousands of characters, of ten it was never found."""
    matrix, given = made(kind, n), np.arange(1.0, n + 1)
    variables = [f"x{j}" for j in range(n)]
    texts = [f"{weighted(row)} - {k + 1}*a - b" for k, row in enumerate(matrix)]
    found = solve(texts, variables, {"a": 2.0, "b": 0.5})
    expected = np.linalg.solve(matrix, 2.0 * given + 0.5)
    np.testing.assert_allclose([found[name] for name in variables], expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "n", "lines", "terms"), [("ladder", 12, 48, 3), ("dense", 8, 80, 9), ("star", 12, 48, 13)]
)
def test_the_code_of_a_large_loop_has_short_lines_and_few(kind: str, n: int, lines: int, terms: int) -> None:
    names = [f"k{i}_{j}" for i in range(n) for j in range(n)]
    texts = [
        " + ".join(f"k{i}_{j}*x{j}" for j, weight in enumerate(row) if weight) + " - a"
        for i, row in enumerate(made(kind, n))
    ]
    variables = [f"x{j}" for j in range(n)]
    equations = {f"e{k}": parse_expression(text, [*names, *variables, "a"], "test") for k, text in enumerate(texts)}
    parameters = dict(zip(names, made(kind, n).ravel().tolist(), strict=True))
    found = solve_component(equations, variables, parameters, "test", Names().fresh)
    assert len(found) <= lines
    assert max(len(sp.Add.make_args(sp.numer(solved.value))) for solved in found) <= terms
    assert {solved.variable for solved in found if not solved.part} == set(variables)
    for solved in found:  # the parameters alone decide the pivots: no signal can make one zero
        assert not sp.denom(solved.value).free_symbols & {sp.Symbol("a")}


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("texts", [["p*x + q*y - a", "r*x + s*y"], ["0.1*x + 0.7*y - a", "sign*(0.3*x + 2.1*y)"]])
def test_a_coefficient_that_is_but_rounding_counts_as_zero(texts: list[str], sign: int) -> None:
    """Without x the second equation has y in its root alone: 0.3/0.1*0.7 is 2.1, but for a rest without meaning."""
    texts = [texts[0], texts[1] + " - b*sgsqrt(y - 1) - w", "w - x - 7*y - c"]
    parameters = {"p": 0.1, "q": 0.7, "r": 0.3 * sign, "s": 2.1 * sign, "sign": float(sign)}
    found = solve(texts, ["x", "y", "w"], {"a": 0.2, "b": 3.0, "c": 1.0, **parameters})
    for text in texts:
        assert error(text, found) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("c", [0.7, -0.7])
def test_a_ladder_with_an_orifice_in_the_middle_is_solved_exactly(c: float) -> None:
    n = 9
    texts = [f"{weighted(row)} - a" for row in made("ladder", n)]
    texts[4] += " + sgsqrt(3*x4 - c)"
    found = solve(texts, [f"x{j}" for j in range(n)], {"a": 2.0, "c": c})
    for text in texts:
        assert error(text, {name: found[name] for name in ("a", "c", *(f"x{j}" for j in range(n)))}) == pytest.approx(
            0.0, abs=1e-9
        )


def test_a_signal_in_a_coefficient_is_no_pivot_if_a_parameter_can_be() -> None:
    """Where the signal a is zero the loop is regular, and so is its solution."""
    texts = ["a*x + y + w - 1", "x + a*y - w - 2", "2*x - y + a*w - 3"]
    equations = {f"e{k}": parse_expression(text, NAMES, "test") for k, text in enumerate(texts)}
    found: dict[str, float] = {"a": 0.0}
    for solved in solve_component(equations, ["x", "y", "w"], {}, "test", Names().fresh):
        found[solved.variable] = float(solved.value.subs(found))
    matrix = np.array([[0, 1, 1], [1, 0, -1], [2, -1, 0]])
    np.testing.assert_allclose([found[v] for v in "xyw"], np.linalg.solve(matrix, [1, 2, 3]))


REFUSED = [
    (["x**2 - a"], ["x"], "e0 cannot be solved for x: it is not linear in x and may have several solutions"),
    (["abs(x) - a"], ["x"], "may have several solutions"),
    (["x - a*sgsqrt(b - x) - 1"], ["x"], None),  # both terms rise with x: one solution
    (["x + a*sgsqrt(b - x) - 1"], ["x"], "inside .* and outside"),
    (["x*y - a", "x + y - b"], ["x", "y"], "the algebraic loop e0, e1 cannot be solved for x, y"),
    (["x*y - a", "x*y + y - b"], ["x", "y"], "y is multiplied by x of the same loop, which may be zero"),
    (["x + y - a", "2*x + 2*y - b"], ["x", "y"], "its linear equations are dependent"),
    (["0.1*x + 0.7*y - a", "0.3*x + 2.1*y - b"], ["x", "y"], "its linear equations are dependent"),  # but for rounding
    (["x + y - a", "y + w - b", "x - w - c"], ["x", "y", "w"], "its linear equations are dependent"),
    (["0.1*x + 0.7*y - a", "0.3*x + 2.1*y + w - b", "w - 0.7*x - 4.9*y"], ["x", "y", "w"], "equations are dependent"),
    (["x + y - a", "y + w - b", "x - w + sgsqrt(z)", "z - x + w"], ["x", "y", "w", "z"], "no equation is left"),
    (["0.1*x + 0.7*w - a", "y - 2.1*w - b", "0.3*x + y - c"], ["x", "y", "w"], "equations are dependent"),
    (["a*x - 1"], ["x"], "the coefficient of x is zero"),
    (["0.3*x - 0.1*b*x - 1"], ["x"], "the coefficient of x is zero"),
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
    model = load_model("uds/production")
    widest = mtes_sets(structure_of(model))[-1]
    sequence = computation_sequence(model, widest, "e10")
    with pytest.raises(InputError, match=r"algebraic loop e01, e02, e06, e07, e08 cannot be solved for .*several"):
        residual_program(model, sequence, name="uds_production_t15")

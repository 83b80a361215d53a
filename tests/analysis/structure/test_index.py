"""Index, observability and differential order: the thesis's model, and linear systems with random coefficients."""

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eig

from faultline.analysis.model import Differential, load_model
from faultline.analysis.structure import Structure, mso_sets, structure_of
from faultline.analysis.structure.causality import IntegralCausality
from faultline.analysis.structure.index import differential_orders, low_index, observable
from faultline.analysis.structure.matrix import structural_model

ORACLE: list[dict[str, Any]] = json.loads((Path(__file__).parent / "uds_index_oracle.json").read_text())
UDS4 = structure_of(load_model("uds"))
STEADY = settings(derandomize=True, deadline=None, max_examples=150)
X = Differential(name="dx", state="x", derivative="x'")


@st.composite
def dynamic_structures(draw: st.DrawFn) -> Structure:
    """Up to three states, two algebraic unknowns and seven algebraic equations; any of them may be redundant."""
    states = draw(st.integers(0, 3))
    unknowns = [f"x{k}" for k in range(states)] + [f"dx{k}" for k in range(states)]
    unknowns += [f"v{k}" for k in range(draw(st.integers(0, 2)))]
    subsets = st.lists(st.sampled_from(unknowns), unique=True, max_size=3) if unknowns else st.just([])
    rows = draw(st.lists(subsets, min_size=max(1, len(unknowns) - states - 1), max_size=7))
    return structural_model(
        {f"e{k}": row for k, row in enumerate(rows)},
        [Differential(name=f"d{k}", state=f"x{k}", derivative=f"dx{k}") for k in range(states)],
        unknowns=unknowns,
    )


def pencil(structure: Structure, rng: np.random.Generator) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """E and A (equations, unknowns) of s E - A with random coefficients in the algebraic equations."""
    constraints = structure.differentials
    shape = len(structure.equations), len(structure.unknowns)
    E, A = np.zeros(shape), np.zeros(shape)
    for i, name in enumerate(structure.equations):
        for x in structure.unknowns_in([name]):
            k = structure.unknowns.index(x)
            if name not in constraints:
                A[i, k] = rng.uniform(0.5, 1.5) * rng.choice([-1.0, 1.0])
            elif x == constraints[name].state:
                E[i, k] = 1.0
            else:
                A[i, k] = 1.0
    return E, A


def rank(matrix: npt.NDArray[Any]) -> int:
    values = np.linalg.svd(matrix, compute_uv=False) if matrix.size else np.zeros(1)
    return int(np.sum(values > 1e-7))


def states_are_determined(structure: Structure, seed: int) -> bool:
    """Hautus's test with numbers: for no s is there a solution without signals in which a state is not zero."""
    rng = np.random.default_rng(seed)
    E, A = pencil(structure, rng)
    states = [structure.unknowns.index(x) for x in structure.states_in(structure.equations)]
    other = np.delete(A, states, axis=1)  # no s in these columns
    needed = rank(other) + len(states)
    size = rank(0.7371 * E - A)
    left, right = rng.normal(size=(size, len(E))), rng.normal(size=(E.shape[1], size))
    # A random square compression of the rank's size has all points where the pencil loses rank among its eigenvalues.
    found = eig(left @ A @ right, left @ E @ right, right=False) if size else np.zeros(0)
    points = [0.0, 0.7371, *found[np.isfinite(found) & (np.abs(found) < 1e4)]]
    return all(rank(s * E - A) == needed for s in points)


def test_index_and_order_of_every_mso_set_are_those_of_the_oracle() -> None:
    for equations, expected in zip(mso_sets(UDS4), ORACLE, strict=True):
        assert low_index(UDS4, equations) == expected["low_index"]
        assert differential_orders(UDS4, equations) == expected["orders"]
        assert observable(within(UDS4, equations)) == expected["observable"]


def within(structure: Structure, equations: tuple[str, ...]) -> Structure:
    """The structure of some of the equations."""
    return structural_model(
        {name: structure.unknowns_in([name]) for name in equations},
        [structure.differentials[name] for name in equations if name in structure.differentials],
    )


def test_the_four_state_model_is_of_low_index_and_observable() -> None:
    assert low_index(UDS4)
    assert observable(UDS4)


def test_an_unused_unknown_is_not_determined_but_leaves_the_states_observable() -> None:
    structure = structural_model({"e": ["x'", "x"], "y": ["x"]}, [X], unknowns=["x", "x'", "unused"])
    assert not low_index(structure)
    assert observable(structure)


@STEADY
@given(dynamic_structures())
def test_an_mso_set_has_low_index_exactly_if_it_has_an_integral_residual(structure: Structure) -> None:
    for equations in mso_sets(structure):
        assert low_index(structure, equations) == bool(
            IntegralCausality(structure).residuals(structure.rows(equations))
        )


def test_a_given_derivative_of_a_given_state_has_high_index() -> None:
    """v is the derivative of a measured position: x is no state that could be integrated."""
    structure = structural_model({"y": ["x"], "other": ["v"], "v": ["v", "x'"]}, [X])
    assert low_index(structure)
    assert not low_index(structure, ["y", "dx", "v"])


@pytest.mark.parametrize(
    ("equations", "expected"),
    [
        ({"e": ["x'"], "y": ["x"]}, True),
        ({"e": ["x'"], "y": ["x'"]}, False),  # an integrator whose start nothing measures
        ({"e": ["x'", "x"]}, False),  # a motion of its own
        ({"e": ["x'", "x", "v"], "y": ["v"]}, False),
        ({"e": ["x'", "v"], "y": ["x"]}, True),
        ({"e": ["v"], "y": ["v"]}, False),
    ],
)
def test_observability_of_one_state(equations: dict[str, list[str]], expected: bool) -> None:
    assert observable(structural_model(equations, [X])) is expected


def test_two_integrators_are_not_observable_from_their_sum() -> None:
    """Every state reaches the sensor, but at s = 0 one sensor is too few."""
    constraints = [Differential(name=f"d{k}", state=f"x{k}", derivative=f"v{k}") for k in (1, 2)]
    assert not observable(structural_model({"e1": ["v1"], "e2": ["v2"], "y": ["x1", "x2"]}, constraints))
    assert observable(structural_model({"e1": ["v1", "x1"], "e2": ["v2"], "y": ["x1", "x2"]}, constraints))


@STEADY
@given(dynamic_structures(), st.integers(0, 2**32 - 1))
def test_observability_is_that_of_linear_systems_with_random_coefficients(structure: Structure, seed: int) -> None:
    assert observable(structure) == states_are_determined(structure, seed)


@settings(STEADY, max_examples=60)
@given(dynamic_structures(), st.integers(0, 2**32 - 1))
def test_orders_are_degrees_of_the_polynomials_that_eliminate_the_unknowns(structure: Structure, seed: int) -> None:
    """The combination that eliminates all unknowns has the minors of the pencil as its coefficients."""
    rng = np.random.default_rng(seed)
    s = sp.Symbol("s")
    for equations in itertools.islice(mso_sets(structure), 3):
        part = within(structure, equations)
        E, A = (sp.Matrix((1000 * M).round().astype(int)) for M in pencil(part, rng))
        whole = sp.Matrix(s * E - A)
        degrees = {}
        for i, name in enumerate(part.equations):
            minor = whole.copy()
            minor.row_del(i)
            degrees[name] = sp.Poly(minor.det(method="berkowitz"), s).degree()
        assert differential_orders(structure, equations) == degrees


def test_only_mso_sets_have_differential_orders() -> None:
    with pytest.raises(ValueError, match="no MSO set"):
        differential_orders(UDS4, UDS4.equations)

"""The search: its bounded step is exact, it never ends worse than it began, and it walks round what cannot be run."""

from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from faultline.analysis.discrepancy.name.search import descend
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]
FREE = np.array([[-np.inf], [np.inf]])


class Made:
    """A likelihood and a problem at once: the differences `left` of x, slopes by difference quotients.

    It cannot be run where x is above `end`.
    """

    def __init__(self, left: Callable[[Array], Array], bounds: Array, end: float = np.inf) -> None:
        self._left, self.bounds, self._end = left, bounds, end

    def left(self, _: Any, x: Array) -> Array:
        if x.max() > self._end:
            raise InputError("no run")
        return self._left(x)

    def slopes(self, _: Any, x: Array) -> Array:
        h = 1e-6
        steps = h * np.eye(len(x))
        return np.column_stack([(self._left(x + d) - self._left(x - d)) / (2 * h) for d in steps])


def found(left: Callable[[Array], Array], bounds: Array, x: Array, steps: int = 15, end: float = np.inf) -> Any:
    made: Any = Made(left, bounds, end)
    return descend(made, made, x, steps)


def cost(left: Callable[[Array], Array], x: Array) -> float:
    e = left(x)
    return 0.5 * float(e @ e + x @ x)


def best(A: Array, b: Array, bounds: Array) -> Array:
    """By trying every face of the box."""
    n = A.shape[1]
    H, g = A.T @ A + np.eye(n), A.T @ b
    candidates = []
    for face in product((None, 0, 1), repeat=n):
        if any(side is not None and np.isinf(bounds[side, k]) for k, side in enumerate(face)):
            continue
        x = np.array([0.0 if side is None else bounds[side, k] for k, side in enumerate(face)])
        free = [k for k, side in enumerate(face) if side is None]
        held = [k for k, side in enumerate(face) if side is not None]
        if free:
            x[free] = np.linalg.solve(H[np.ix_(free, free)], g[free] - H[np.ix_(free, held)] @ x[held])
        if (x >= bounds[0] - 1e-12).all() and (x <= bounds[1] + 1e-12).all():
            candidates.append(x)
    return min(candidates, key=lambda x: cost(lambda x: A @ x - b, x))


@given(st.integers(0, 10_000))
def test_the_optimum_of_a_linear_model_within_bounds_is_exact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, b = rng.normal(0.0, 3.0, (6, 3)), rng.normal(0.0, 5.0, 6)
    bounds = np.array([rng.choice([-np.inf, -0.5, 0.0], 3), rng.choice([np.inf, 0.3, 0.1], 3)])
    end = found(lambda x: A @ x - b, bounds, np.zeros(3))
    exact = best(A, b, bounds)
    # a last step that promises less than 0.05 nats is not made
    assert end.cost - cost(lambda x: A @ x - b, exact) < 0.05 + 1e-9
    assert (end.x >= bounds[0]).all()
    assert (end.x <= bounds[1]).all()


def test_one_step_is_exact_where_a_bound_holds_one_unknown() -> None:
    """The other one goes where it is best with the first at its bound, not where the free step had it."""
    A, b = np.array([[3.0, 2.0], [2.0, 3.0], [0.0, 1.0]]), np.array([10.0, -10.0, 1.0])
    bounds = np.array([[-np.inf, 0.0], [np.inf, np.inf]])
    end = found(lambda x: A @ x - b, bounds, np.zeros(2))
    assert end.x == pytest.approx([A[:, 0] @ b / (A[:, 0] @ A[:, 0] + 1.0), 0.0])
    assert end.inside.tolist() == [True, False]
    assert end.promised < 0.05
    assert end.curvature == pytest.approx(A.T @ A + np.eye(2), rel=1e-6)
    assert end.log_evidence == pytest.approx(-end.cost - 0.5 * np.log(A[:, 0] @ A[:, 0] + 1.0), rel=1e-6)


@pytest.mark.parametrize("steps", [0, 1, 15])
def test_it_never_ends_worse_than_it_began(steps: int) -> None:
    def left(x: Array) -> Array:
        return np.array([30.0 * np.sin(3.0 * x[0]) + 5.0, 20.0 * np.tanh(x[0] * x[1] - 1.0), 4.0 * x[1] - 9.0])

    for seed in range(30):
        start = np.random.default_rng(seed).normal(0.0, 2.0, 2)
        end = found(left, np.repeat(FREE, 2, axis=1), start, steps)
        assert end.cost <= cost(left, start) + 1e-12, seed
        assert end.cost == pytest.approx(cost(left, end.x)), seed
        if steps == 0:
            assert (end.x == start).all(), seed


def test_slopes_beside_which_the_prior_is_nothing_are_no_error() -> None:
    """Two unknowns that do nearly the same, and are known to 1e-9 of their prior: a matrix of squares has no room."""
    A = 1e9 * np.array([[1.0, 1.0], [1.0, 1.0 + 1e-12], [2.0, 2.0]])
    end = found(lambda x: A @ x - A @ np.array([0.7, 0.3]), np.array([[0.0, 0.0], [0.5, np.inf]]), np.zeros(2))
    assert end.x.sum() == pytest.approx(1.0, abs=1e-6)
    assert 0.0 <= end.x[0] <= 0.5


def test_it_begins_within_the_bounds() -> None:
    end = found(lambda x: 3.0 * x - 9.0, np.array([[0.0], [0.5]]), np.array([7.0]))
    assert end.x == pytest.approx([0.5])
    assert not end.inside[0]


def test_it_goes_less_far_where_the_model_cannot_be_run() -> None:
    """The first step would go to 0.99; from 0.6 on there is no run."""
    end = found(lambda x: 10.0 * x - 10.0, FREE, np.zeros(1), end=0.6)
    assert 0.5 < end.x[0] <= 0.6


def test_where_it_cannot_be_run_at_all_it_stays() -> None:
    end = found(lambda x: 10.0 * x - 10.0, FREE, np.zeros(1), end=0.0)
    assert end.x == pytest.approx([0.0])
    assert end.promised > 40.0


def test_a_start_that_cannot_be_run_is_an_error() -> None:
    with pytest.raises(InputError, match="no run"):
        found(lambda x: x, FREE, np.zeros(1), end=-1.0)

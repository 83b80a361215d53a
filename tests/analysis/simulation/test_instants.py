"""Systems solved as arrays over time against numpy, which takes one instant after the other."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import pytest

from faultline.analysis.simulation.instants import UndeterminedError, solved

Array = npt.NDArray[np.float64]
COUNT = 50


def sparse(seed: int, n: int, width: int, share: float) -> dict[tuple[int, int], float | Array]:
    """Some entries that change with time, some that do not."""
    rng = np.random.default_rng(seed)
    found: dict[tuple[int, int], float | Array] = {}
    for i in range(n):
        for j in range(width):
            if i == j or rng.random() < share:
                found[i, j] = float(rng.normal()) if rng.random() < 0.5 else rng.normal(size=COUNT)
    return found


def dense(entries: Mapping[tuple[int, int], float | Array], n: int, width: int) -> Array:
    found = np.zeros((COUNT, n, width))
    for (i, j), value in entries.items():
        found[:, i, j] = value
    return found


def assert_solves(A: Mapping[tuple[int, int], float | Array], B: Mapping[tuple[int, int], float | Array]) -> None:
    n, width = 1 + max(i for i, _ in A), 1 + max(j for _, j in B)
    found = solved(A, B, np.ones(n), (width, COUNT)).transpose(2, 0, 1)
    whole, right = dense(A, n, n), dense(B, n, width)
    size = np.abs(whole).max() * np.abs(found).max(axis=(1, 2)) + np.abs(right).max()
    assert (np.abs(whole @ found - right).max(axis=(1, 2)) < 1e-9 * size).all()


@pytest.mark.parametrize("share", [0.2, 1.0])
@pytest.mark.parametrize("seed", range(20))
def test_it_solves_as_lapack_does(seed: int, share: float) -> None:
    assert_solves(sparse(seed, 6, 6, share), sparse(seed + 100, 6, 3, 0.5))


def test_a_pivot_that_vanishes_at_an_instant_costs_no_digits() -> None:
    """With the first of each row nothing could be eliminated at instant 7, and hardly anything at the next."""
    pivot = np.ones(COUNT)
    pivot[7:9] = 0.0, 1e-13
    B: dict[tuple[int, int], float | Array] = {(0, 0): 1.0, (1, 0): np.arange(COUNT, dtype=float)}
    assert_solves({(0, 0): pivot, (0, 1): 0.5, (1, 0): 0.5, (1, 1): pivot}, B)


def test_zeros_are_no_entries() -> None:
    """A lag whose time constant is zero has them."""
    assert_solves({(0, 0): 0.0, (0, 1): 2.0, (1, 0): 3.0, (1, 1): np.zeros(COUNT)}, {(0, 0): 1.0, (1, 0): 0.0})


def test_the_sizes_of_variables_and_equations_do_not_matter() -> None:
    A, B = sparse(1, 5, 5, 0.6), sparse(2, 5, 2, 1.0)
    sizes, weights = 10.0 ** np.array([0, 6, -7, 3, -2]), 10.0 ** np.array([5, -8, 0, 9, -3])
    scaled = {(i, j): value * weights[i] / sizes[j] for (i, j), value in A.items()}
    right = {(i, j): value * weights[i] for (i, j), value in B.items()}
    found, expected = solved(scaled, right, sizes, (2, COUNT)), solved(A, B, np.ones(5), (2, COUNT))
    assert np.allclose(found / sizes[:, None, None], expected, rtol=1e-10, atol=0.0)


def test_what_is_open_at_one_instant_is_named() -> None:
    """The second equation is half of the first there; a small coefficient says least of its variable."""
    last = np.full(COUNT, 3.0)
    last[20] = 0.25
    A: dict[tuple[int, int], float | Array] = {(0, 0): 4.0, (0, 1): 0.5, (1, 0): 2.0, (1, 1): last}
    with pytest.raises(UndeterminedError) as caught:
        solved(A, {(0, 0): 1.0}, np.ones(2), (1, COUNT))
    assert caught.value.column == 1


def test_a_variable_in_no_equation_is_open() -> None:
    with pytest.raises(UndeterminedError) as caught:
        solved({(0, 0): 1.0, (1, 0): 2.0}, {(0, 0): 1.0}, np.ones(2), (1, COUNT))
    assert caught.value.column == 1

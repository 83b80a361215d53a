"""MSO and MTES sets of random structures against their definitions, by brute force."""

import itertools
from collections.abc import Collection, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import structural_rank

from faultline.analysis.structure import generic, minimal
from faultline.analysis.structure.matching import Matching, bits, mask_of
from faultline.analysis.structure.minimal import minimal_sets

STEADY = settings(derandomize=True, deadline=None, max_examples=120)


@st.composite
def structures(draw: st.DrawFn, most_rows: int = 7) -> list[int]:
    """Rows over up to five unknowns, more rows than unknowns often enough; empty rows and unused unknowns occur."""
    unknowns = draw(st.integers(0, 5))
    return draw(st.lists(st.integers(0, 2**unknowns - 1), max_size=most_rows))


def rank(rows: Sequence[int]) -> int:
    """The structural rank, by scipy."""
    width = max(1, *(row.bit_length() for row in rows)) if rows else 1
    matrix = [[row >> x & 1 for x in range(width)] for row in rows]
    return int(structural_rank(csr_matrix(np.array(matrix, dtype=np.int8).reshape(len(rows), width)))) if rows else 0


def subsets(rows: Sequence[int]) -> list[frozenset[int]]:
    """All sets of rows, the small ones first."""
    return [frozenset(s) for size in range(len(rows) + 1) for s in itertools.combinations(range(len(rows)), size)]


def brute_msos(rows: Sequence[int]) -> set[frozenset[int]]:
    """Minimal sets of more rows than their structural rank."""
    found: list[frozenset[int]] = []
    for chosen in subsets(rows):
        if not any(smaller <= chosen for smaller in found) and len(chosen) > rank([rows[i] for i in chosen]):
            found.append(chosen)
    return set(found)


def found_sets(rows: Sequence[int], removable: Collection[int] | None = None) -> list[frozenset[int]]:
    """In the order of the search; every row may be removed if none are named."""
    found = minimal_sets(rows, range(len(rows)) if removable is None else removable)
    assert found.shape == (len(found), len(rows))
    return [frozenset(np.flatnonzero(chosen).tolist()) for chosen in found]


@STEADY
@given(structures())
def test_mso_sets_are_the_minimal_sets_with_redundancy(rows: list[int]) -> None:
    found = found_sets(rows)
    assert len(found) == len(set(found))
    assert set(found) == brute_msos(rows)


@STEADY
@given(structures())
def test_the_over_determined_part_is_the_union_of_the_mso_sets(rows: list[int]) -> None:
    matching = Matching(rows)
    assert matching.rank == rank(rows)
    assert set(matching.over_determined()) == set().union(*brute_msos(rows))


@STEADY
@given(structures(), st.data())
def test_mtes_are_the_unions_of_mso_sets_within_minimal_fault_supports(rows: list[int], data: st.DataObject) -> None:
    faulty = data.draw(st.sets(st.integers(0, len(rows) - 1))) if rows else set()
    msos = brute_msos(rows)
    supports = {mso & faulty for mso in msos} - {frozenset()}
    minimal = [s for s in supports if not any(other < s for other in supports)]
    expected = {frozenset().union(*(mso for mso in msos if mso & faulty <= s)) for s in minimal}
    found = found_sets(rows, faulty)
    assert len(found) == len(set(found))
    assert set(found) == expected


@STEADY
@given(structures(most_rows=9), st.data())
def test_permuting_rows_and_unknowns_permutes_the_sets(rows: list[int], data: st.DataObject) -> None:
    order = data.draw(st.permutations(range(len(rows))))
    columns = data.draw(st.permutations(range(5)))
    permuted = [mask_of([columns[x] for x in bits(rows[i])]) for i in order]
    found = {frozenset(order[i] for i in s) for s in found_sets(permuted)}
    assert found == set(found_sets(rows))


@STEADY
@given(structures())
def test_removing_a_row_leaves_the_over_determined_part_of_the_rest(rows: list[int]) -> None:
    """Of an over-determined set, as the search has it: there every unknown is matched."""
    part = [rows[i] for i in Matching(rows).over_determined()]
    matching = Matching(part)
    for row in range(len(part)):
        rest = [i for i in range(len(part)) if i != row]
        expected = [rest[i] for i in Matching([part[i] for i in rest]).over_determined()]
        assert matching.over_determined_without(row) == expected


def test_an_equation_without_unknowns_is_a_test_of_its_own() -> None:
    """Regression against the peer tool, which drops consistency checks of known signals."""
    assert found_sets([0b01, 0, 0b10]) == [frozenset([1])]


def test_no_redundancy_and_no_rows_give_no_sets() -> None:
    """Regression against the peer tool, which crashed here."""
    assert found_sets([0b01]) == []
    assert found_sets([0b11]) == []
    assert found_sets([]) == []
    assert found_sets([0b01, 0b01], removable=[]) == []


def test_numbers_that_cancel_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a prime so small that random numbers often cancel, the sets are still exact: other numbers are drawn."""
    monkeypatch.setattr(generic, "BITS", 5)
    seeds: list[int] = []

    def counted(rows: Sequence[int], seed: int) -> generic.Field:
        seeds.append(seed)
        return generic.null_vectors(rows, seed)

    monkeypatch.setattr(minimal, "null_vectors", counted)
    random = np.random.default_rng(5)
    for _ in range(200):
        unknowns, size = int(random.integers(1, 5)), int(random.integers(1, 8))
        rows = [int(random.integers(2**unknowns) & random.integers(2**unknowns)) for _ in range(size)]
        assert set(found_sets(rows)) == brute_msos(rows)
    assert seeds.count(0) > 50
    assert len(seeds) - seeds.count(0) > 20, "the small prime must make trouble, or this shows nothing"


def test_the_inverses_of_many_numbers() -> None:
    prime = 2**generic.BITS - 1
    for size in (0, 1, 31, 32, 33, 200):
        values = np.random.default_rng(size).integers(1, prime, size, dtype=np.uint64)
        assert np.all(generic.product(values, generic.inverses(values)) == 1)

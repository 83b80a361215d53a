"""MSO and MTES sets of random structures against their definitions, by brute force."""

import itertools
from collections.abc import Iterable, Sequence

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import structural_rank

from analysis.structure.matching import Matching, bits, mask_of
from analysis.structure.minimal import minimal_sets

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


def sets_of(masks: Iterable[int]) -> list[frozenset[int]]:
    return [frozenset(bits(mask)) for mask in masks]


def everything(rows: Sequence[int]) -> int:
    return (1 << len(rows)) - 1


@STEADY
@given(structures())
def test_mso_sets_are_the_minimal_sets_with_redundancy(rows: list[int]) -> None:
    found = sets_of(minimal_sets(rows, everything(rows)))
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
    faulty = data.draw(st.integers(0, everything(rows)))
    msos = brute_msos(rows)
    supports = {frozenset(i for i in mso if faulty >> i & 1) for mso in msos} - {frozenset()}
    minimal = [s for s in supports if not any(other < s for other in supports)]
    fault_rows = frozenset(bits(faulty))
    expected = {frozenset().union(*(mso for mso in msos if mso & fault_rows <= s)) for s in minimal}
    found = sets_of(minimal_sets(rows, faulty))
    assert len(found) == len(set(found))
    assert set(found) == expected


@STEADY
@given(structures(most_rows=9), st.data())
def test_permuting_rows_and_unknowns_permutes_the_sets(rows: list[int], data: st.DataObject) -> None:
    order = data.draw(st.permutations(range(len(rows))))
    columns = data.draw(st.permutations(range(5)))
    permuted = [mask_of([columns[x] for x in bits(rows[i])]) for i in order]
    found = {frozenset(order[i] for i in s) for s in sets_of(minimal_sets(permuted, everything(rows)))}
    assert found == set(sets_of(minimal_sets(rows, everything(rows))))


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
    assert sets_of(minimal_sets([0b01, 0, 0b10], 0b111)) == [frozenset([1])]


def test_no_redundancy_and_no_rows_give_no_sets() -> None:
    """Regression against the peer tool, which crashed here."""
    assert list(minimal_sets([0b01], 0b1)) == []
    assert list(minimal_sets([0b11], 0b1)) == []
    assert list(minimal_sets([], 0)) == []

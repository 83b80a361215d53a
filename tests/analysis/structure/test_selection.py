"""Test selection: all optimal sets, against brute force; requirements need not be mutual."""

import functools
import itertools
import operator
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pytest

from faultline.analysis.model import ModelError, load_model
from faultline.analysis.structure import find_tests, integral_tests, signature_matrix
from faultline.analysis.structure.selection import kept, select_tests

UDS4 = load_model("uds")
FAULTS = tuple(UDS4.faults)
Signature = npt.NDArray[np.bool_]


def meets(signature: Signature, faults: list[str], required: dict[str, list[str]], chosen: tuple[int, ...]) -> bool:
    """The definition: detected, and for each of the others a test that sees only the one."""
    seen = [{f for f, hit in zip(faults, signature[t], strict=True) if hit} for t in chosen]
    return all(any(f in s for s in seen) for f in required) and all(
        any(f in s and other not in s for s in seen) for f, others in required.items() for other in others
    )


def brute(
    signature: Signature, faults: list[str], required: dict[str, list[str]], costs: list[int]
) -> list[tuple[int, ...]]:
    """All cheapest sets among all sets of tests."""
    tests = range(len(signature))
    sets = [chosen for size in range(len(tests) + 1) for chosen in itertools.combinations(tests, size)]
    good = [chosen for chosen in sets if meets(signature, faults, required, chosen)]
    least = min(sum(costs[t] for t in chosen) for chosen in good)
    return sorted(chosen for chosen in good if sum(costs[t] for t in chosen) == least)


def cases() -> Iterator[tuple[int, Signature, list[str], dict[str, list[str]], list[int]]]:
    """436 random cases; of what can be required, each part is with probability two thirds, so not mutually."""
    for seed in range(436):
        rng = np.random.default_rng(seed)
        faults = [f"f{i}" for i in range(rng.integers(1, 6))]
        signature = rng.random((rng.integers(1, 9), len(faults))) < rng.uniform(0.2, 0.8)
        required = {
            fault: [other for other in others if rng.random() < 2 / 3]
            for fault, others in kept(signature, faults).items()
            if rng.random() < 2 / 3
        }
        yield seed, signature, faults, required, rng.integers(1, 5, len(signature)).tolist()


def test_all_smallest_and_all_cheapest_sets_are_those_of_brute_force() -> None:
    asymmetric = several = 0
    for seed, signature, faults, required, costs in cases():
        smallest = select_tests(signature, faults, required)
        assert smallest == brute(signature, faults, required, [1] * len(signature)), f"seed {seed}"
        cheapest = select_tests(signature, faults, required, costs)
        assert cheapest == brute(signature, faults, required, costs), f"seed {seed}"
        pairs = {(f, other) for f, others in required.items() for other in others}
        asymmetric += any((other, f) not in pairs for f, other in pairs)
        several += len(smallest) > 1
    assert asymmetric > 100
    assert several > 100


def test_without_a_requirement_all_that_the_tests_do_is_kept() -> None:
    for seed, signature, faults, _, _ in itertools.islice(cases(), 100):
        everything = {f: list(others) for f, others in kept(signature, faults).items()}
        assert select_tests(signature, faults) == select_tests(signature, faults, everything), f"seed {seed}"
        assert meets(signature, faults, everything, tuple(range(len(signature)))), f"seed {seed}"


def test_the_thesis_model_has_four_smallest_sets_of_five_integral_tests() -> None:
    """Regression against the peer tool, which transposes an asymmetric requirement and finds none of them."""
    tests = integral_tests(UDS4)
    found = select_tests(signature_matrix(tests, FAULTS), FAULTS)
    assert [{tests[t].number for t in chosen} for chosen in found] == [
        {2, 6, 8, 20, 21},
        {2, 8, 9, 13, 20},
        {2, 8, 10, 12, 21},
        {2, 8, 10, 13, 19},
    ]


def test_costs_decide_among_sets_and_may_make_a_larger_one_cheaper() -> None:
    tests = integral_tests(UDS4)
    signature = signature_matrix(tests, FAULTS)
    dear = select_tests(signature, FAULTS, costs=[1.5 if t.number == 20 else 1.0 for t in tests])
    assert [{tests[t].number for t in chosen} for chosen in dear] == [{2, 8, 10, 12, 21}, {2, 8, 10, 13, 19}]
    wide = np.array([[True, True], [True, False], [False, True]])
    assert select_tests(wide, ["f", "g"], {"f": [], "g": []}) == [(0,)]
    assert select_tests(wide, ["f", "g"], {"f": [], "g": []}, costs=[3, 1, 1]) == [(1, 2)]


def test_sums_of_costs_that_differ_by_rounding_are_equal() -> None:
    signature = np.array([[True, False], [False, True], [True, True]])
    assert select_tests(signature, ["f", "g"], {"f": [], "g": []}, costs=[0.1, 0.2, 0.3]) == [(0, 1), (2,)]


def test_nothing_required_needs_no_test() -> None:
    assert select_tests(np.zeros((2, 1), dtype=np.bool_), ["f"]) == [()]
    assert select_tests(np.zeros((0, 1), dtype=np.bool_), ["f"], {}) == [()]


def test_among_all_21_tests_of_the_thesis_model_no_smallest_set_is_missed() -> None:
    tests = find_tests(UDS4)
    found = select_tests(signature_matrix(tests, FAULTS), FAULTS)
    pairs = list(itertools.product(FAULTS, FAULTS))
    met = [sum(1 << k for k, (f, o) in enumerate(pairs) if f in t.faults and o not in t.faults) for t in tests]
    everything = functools.reduce(operator.or_, met)

    def complete(chosen: tuple[int, ...]) -> bool:
        return functools.reduce(operator.or_, (met[t] for t in chosen)) == everything

    assert not any(map(complete, itertools.combinations(range(21), 6)))
    assert found == [chosen for chosen in itertools.combinations(range(21), 7) if complete(chosen)]


def test_a_requirement_that_no_test_meets_names_the_pair() -> None:
    tests = integral_tests(UDS4)
    signature = signature_matrix(tests, FAULTS)
    with pytest.raises(
        ModelError, match=r"^fA_t cannot be isolated from fA_p: every test sensitive to fA_t is to fA_p too$"
    ):
        select_tests(signature, FAULTS, {"fA_p": ["fA_t"], "fA_t": ["fA_p"]})
    assert select_tests(signature, FAULTS, {"fA_p": ["fA_t"]})
    with pytest.raises(ModelError, match=r"^fA_ori cannot be detected: no test is sensitive to it$"):
        select_tests(signature[2:3], FAULTS, {"fA_ori": []})


def test_wrong_names_shapes_and_costs_are_refused() -> None:
    signature = np.array([[True, False]])
    with pytest.raises(ModelError, match=r"^h: no fault of the signature matrix; those are f, g$"):
        select_tests(signature, ["f", "g"], {"f": ["h"]})
    with pytest.raises(ModelError, match=r"^signature of shape \(1, 2\): 1 faults need \(tests, 1\)$"):
        select_tests(signature, ["f"])
    with pytest.raises(ModelError, match=r"^2 costs for 1 tests"):
        select_tests(signature, ["f", "g"], costs=[1, 2])
    with pytest.raises(ModelError, match=r"^costs\[0\]: 0 is no cost"):
        select_tests(signature, ["f", "g"], costs=[0])

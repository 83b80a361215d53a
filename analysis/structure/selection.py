"""Test selection: all smallest or cheapest sets of tests that keep a required isolability, exactly.

Every requirement (a fault is detected; a fault is isolated from another) is met by some tests, and a selection has to
hit each of these sets. The optimum is found by an integer program; all selections that attain it by a search over
the requirement that the fewest tests can meet, cut where the rest cannot be met within the optimum.
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from faultline.analysis.model.errors import ModelError
from faultline.analysis.structure.matching import bits, mask_of

TOLERANCE = 1e-9  # of the optimum, below which two sums of costs are equal
SLACK = 1e-6  # of the optimum: what the bound by a linear program may be wrong


def select_tests(
    signature: npt.NDArray[np.bool_],
    faults: Sequence[str],
    required: Mapping[str, Collection[str]] | None = None,
    costs: Sequence[float] | None = None,
) -> list[tuple[int, ...]]:
    """All smallest sets of tests that meet the requirement, or all cheapest if `costs` (tests,) are given.

    `signature` (tests, faults) is True where a test is sensitive to a fault; the result has row numbers, sorted.
    `required` maps a fault that must be detected to the others that it must be isolable from, which need not be mutual;
    without it, all that the tests do together must be kept.

    Raises:
        ModelError: a requirement that no test meets, names that are no faults, or costs that are not positive.
    """
    if signature.ndim != 2 or signature.shape[1] != len(faults):
        raise ModelError(f"signature of shape {signature.shape}: {len(faults)} faults need (tests, {len(faults)})")
    prices = _prices(costs, len(signature))
    rows = _required(signature, faults, kept(signature, faults) if required is None else required)
    clauses = [mask_of([*np.flatnonzero(row).tolist()]) for row in rows]
    clauses = [c for c in set(clauses) if not any(other != c and other & c == other for other in clauses)]
    if not clauses:
        return [()]
    return sorted(tuple(bits(chosen)) for chosen in _Search(sorted(clauses, key=int.bit_count), prices))


def kept(signature: npt.NDArray[np.bool_], faults: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """What the tests do together, as a requirement: for every detected fault the others that it is isolable from."""
    isolable = np.any(signature[:, :, None] & ~signature[:, None, :], axis=0)  # (F, F)
    return {
        fault: tuple(other for j, other in enumerate(faults) if isolable[i, j])
        for i, fault in enumerate(faults)
        if np.any(signature[:, i])
    }


def _required(
    signature: npt.NDArray[np.bool_], faults: Sequence[str], required: Mapping[str, Collection[str]]
) -> list[npt.NDArray[np.bool_]]:
    """For every requirement the tests (tests,) that meet it."""
    number = {fault: i for i, fault in enumerate(faults)}
    for name in (*required, *(other for others in required.values() for other in others)):
        if name not in number:
            raise ModelError(f"{name}: no fault of the signature matrix; those are {', '.join(faults)}")
    found = []
    for fault, others in required.items():
        sensitive = signature[:, number[fault]]
        if not np.any(sensitive):
            raise ModelError(f"{fault} cannot be detected: no test is sensitive to it")
        found.append(sensitive)
        for other in others:
            isolating = sensitive & ~signature[:, number[other]]
            if not np.any(isolating):
                raise ModelError(
                    f"{fault} cannot be isolated from {other}: every test sensitive to {fault} is to {other} too"
                )
            found.append(isolating)
    return found


def _prices(costs: Sequence[float] | None, tests: int) -> list[float]:
    prices = [1.0] * tests if costs is None else [float(cost) for cost in costs]
    if len(prices) != tests:
        raise ModelError(f"{len(prices)} costs for {tests} tests: one each is needed")
    for number, price in enumerate(prices):
        if not 0 < price < math.inf:
            raise ModelError(f"costs[{number}]: {price:g} is no cost of a test; it must be positive and finite")
    return prices


class _Search:
    """All cheapest sets of tests that hit every clause, when iterated.

    `clauses` have a bit for every test, sets of clauses a bit for every clause.
    """

    def __init__(self, clauses: Sequence[int], prices: Sequence[float]) -> None:
        from scipy.optimize import Bounds, LinearConstraint, linprog, milp  # some 0.4 s of every other command

        hits = np.array([[c >> t & 1 for t in range(len(prices))] for c in clauses], dtype=np.float64)  # (C, T)
        best = milp(
            prices, integrality=np.ones(len(prices)), bounds=Bounds(0, 1), constraints=LinearConstraint(hits, lb=1)
        )
        # The dual of the linear program shares prices out: hitting clauses costs no less than their shares together.
        dual = linprog(-np.ones(len(clauses)), A_ub=hits.T, b_ub=prices)
        if best.x is None or dual.x is None:
            raise RuntimeError(f"both programs have solutions, but scipy says: {best.message} {dual.message}")
        self._clauses, self._prices, self._shares = clauses, prices, dual.x.tolist()
        self._hit = [mask_of([*np.flatnonzero(column).tolist()]) for column in hits.T]
        self._optimum = math.fsum(price for price, x in zip(prices, best.x, strict=True) if x > 0.5)

    def __iter__(self) -> Iterator[int]:
        everything = (1 << len(self._prices)) - 1
        return self._completed(0, (1 << len(self._clauses)) - 1, everything, self._optimum * (1 + TOLERANCE))

    def _completed(self, chosen: int, left: int, allowed: int, budget: float) -> Iterator[int]:
        """The sets that add `allowed` tests to the `chosen` ones, hit the clauses `left` and keep within the budget."""
        if not left:
            yield chosen
            return
        if budget < 2 * min(self._prices):
            yield from (chosen | 1 << t for t in bits(self._hitting(left, allowed)) if self._prices[t] <= budget)
            return
        if self._least(left, allowed) > budget + SLACK * self._optimum:
            return
        for test in bits(min((self._clauses[c] & allowed for c in bits(left)), key=int.bit_count)):
            allowed &= ~(1 << test)  # later branches do without it: no set is found twice
            if self._prices[test] <= budget:
                yield from self._completed(
                    chosen | 1 << test, left & ~self._hit[test], allowed, budget - self._prices[test]
                )

    def _hitting(self, left: int, allowed: int) -> int:
        """The allowed tests that hit all clauses left."""
        for clause in bits(left):
            allowed &= self._clauses[clause]
            if not allowed:
                break
        return allowed

    def _least(self, left: int, allowed: int) -> float:
        """A lower bound of what hitting the clauses left costs: the shares, or the cheapest tests of disjoint ones."""
        used, disjoint, shares = 0, 0.0, 0.0
        for number in bits(left):  # short clauses come first
            shares += self._shares[number]
            clause = self._clauses[number] & allowed
            if not clause:
                return math.inf
            if not clause & used:
                used |= clause
                disjoint += min(self._prices[test] for test in bits(clause))
        return max(shares, disjoint)

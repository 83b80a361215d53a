"""Tests that discriminate explanations: they are sensitive to one of two faults and not to the other.

Structural isolability (thesis 2.3): a test separates two faults where its row of the fault signature matrix has exactly
one of them. Where none does, only size and sign of the residuals in the operating modes can.
"""

from collections.abc import Collection, Iterable, Sequence
from itertools import combinations
from typing import Annotated

import msgspec
from msgspec import Meta

from faultline.service.core.manifest import Generator
from faultline.service.core.records.event import Diagnosis

MOST = 4  # explanations that are compared, the best ones: six pairs


class Separation(msgspec.Struct, frozen=True, kw_only=True):
    """Pair of explanations, and the tests that discriminate them."""

    between: Annotated[list[list[str]], Meta(description="the faults of one explanation, and of the other")]
    telling: Annotated[list[str], Meta(description="tests that tell them apart, and can now")]
    waiting: Annotated[list[str], Meta(description="and those that cannot tell now")]


def separations(
    generators: Iterable[Generator], diagnoses: Sequence[Diagnosis], cannot_tell: Collection[str]
) -> list[Separation]:
    """Return for each pair of the best explanations with known faults the tests that discriminate them.

    >>> class Row:
    ...     def __init__(self, test, faults): self.test, self.faults = test, faults
    >>> rows = [Row("t02", ["fA_t", "fA_p"]), Row("t05", ["fA_p"]), Row("t09", ["fA_t"])]
    >>> two = [Diagnosis(faults=["fA_t"], rank=1, p=0.5), Diagnosis(faults=["fA_p"], rank=1, p=0.5)]
    >>> [each] = separations(rows, two, ["t09"])
    >>> each.between, each.telling, each.waiting
    ([['fA_t'], ['fA_p']], ['t05'], ['t09'])
    """
    sensitive: dict[str, set[str]] = {}
    for generator in generators:
        sensitive.setdefault(generator.test, set()).update(generator.faults)
    known = [each.faults for each in sorted(diagnoses, key=lambda each: each.rank) if each.faults][:MOST]
    found = []
    for one, other in combinations(known, 2):
        tests = [test for test, faults in sensitive.items() if faults.isdisjoint(one) != faults.isdisjoint(other)]
        found.append(
            Separation(
                between=[one, other],
                telling=[test for test in tests if test not in cannot_tell],
                waiting=[test for test in tests if test in cannot_tell],
            )
        )
    return found

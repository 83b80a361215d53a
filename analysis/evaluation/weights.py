"""What a diagnosis says, as a probability of each explanation."""

from collections.abc import Collection, Sequence

from faultline.service.core.records.event import Diagnosis

Explanation = frozenset[str]
"""Names of the faults that are there together; none: no known fault explains it."""

UNKNOWN: Explanation = frozenset()
UNNAMED = "unknown"
"""How it reads."""


def weights(diagnoses: Sequence[Diagnosis]) -> dict[Explanation, float]:
    """The probability given to each explanation; where no p is told, it is shared equally by those of rank 1.

    >>> told = [Diagnosis(faults=["fA"], rank=1, p=None), Diagnosis(faults=["fB"], rank=1, p=None)]
    >>> weights([*told, Diagnosis(faults=["fC"], rank=3, p=None)])[frozenset({"fA"})]
    0.5
    """
    found: dict[Explanation, float] = {}
    if any(diagnosis.p is not None for diagnosis in diagnoses):
        given = [(diagnosis, diagnosis.p or 0.0) for diagnosis in diagnoses]
    else:
        first = [diagnosis for diagnosis in diagnoses if diagnosis.rank == 1]
        given = [(diagnosis, 1.0 / len(first)) for diagnosis in first]
    for diagnosis, p in given:  # what is unknown may be near several places
        explanation = frozenset(diagnosis.faults)
        found[explanation] = found.get(explanation, 0.0) + p
    return found


def suggested(diagnoses: Sequence[Diagnosis]) -> list[Diagnosis]:
    """Return the explanations that something speaks for.

    Left out is an unknown behind faults that fit, near nothing: what is said of every fault is no answer.

    >>> told = [Diagnosis(faults=["fA"], rank=1, p=0.95), Diagnosis(faults=[], rank=2, p=0.05)]
    >>> [one.faults for one in suggested(told)]
    [['fA']]
    """
    return [one for one in diagnoses if one.faults or one.near or one.rank == 1 or one.p is None]


def true_explanation(faults: Collection[str], known: Collection[str]) -> Explanation:
    """What should be told of these faults: their names, or *unknown* where one of them is not among the `known`."""
    return frozenset(faults) if set(faults) <= set(known) else UNKNOWN

"""Generic values for a structure: every occurrence of an unknown gets a random number of a prime field.

Sets of rows then have the rank of their structure, unless the numbers happen to cancel; who uses them must be able to
see that. What is computed here are the rows' vectors in the left null space: a combination of rows cancels all unknowns
if its coefficients are in it, and which rows may be left out together follows from which of these vectors are linearly
dependent (they represent the dual of the rows' matroid; Oxley, Matroid Theory, 2011, chapter 2).
"""

import random
from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from faultline.analysis.structure.matching import bits

Field = NDArray[np.uint64]
"""Numbers of the field, 0 .. 2**BITS - 2."""

BITS = 31
"""2**31 - 1 is prime, and the product of two of its numbers fits 64 bits."""


class UnluckyNumbersError(ArithmeticError):
    """Random numbers that cancel where generic ones do not; other ones will do."""


def null_vectors(rows: Sequence[int], seed: int) -> Field:
    """For every row its coordinates in the left null space of a generic matrix, (rows - unknowns, rows).

    The rows must be an over-determined part with at least one row. A coordinate is zero only if those that follow are.

    Raises:
        UnluckyNumbersError: the matrix has a smaller rank than its structure.
    """
    prime, draw = _prime(), random.Random(seed)  # noqa: S311 (nothing is kept secret)
    # Unknowns are eliminated one by one; every equation that is left remembers which combination of rows it is.
    left = [({x: draw.randrange(1, prime) for x in bits(row)}, {i: 1}) for i, row in enumerate(rows)]
    frequency = Counter(x for row in rows for x in bits(row))
    for x in sorted(frequency, key=frequency.__getitem__):
        holders = [equation for equation in left if x in equation[0]]
        if not holders:
            raise UnluckyNumbersError
        pivot = min(holders, key=lambda equation: len(equation[0]) + len(equation[1]))
        inverse = pow(pivot[0][x], -1, prime)
        for equation in holders:
            if equation is not pivot:
                factor = -equation[0][x] * inverse % prime
                _add(equation[0], pivot[0], factor)
                _add(equation[1], pivot[1], factor)
        left.remove(pivot)
    # A triangular change of basis, so that none is lost.
    for k, (_, combination) in enumerate(left):
        for _, following in left[k + 1 :]:
            _add(combination, following, draw.randrange(1, prime))
    return np.array([[combination.get(i, 0) for i in range(len(rows))] for _, combination in left], dtype=np.uint64)


def product(a: Field, b: Field) -> Field:
    """The product in the field, with the usual broadcasting."""
    value: Field = a * b
    for _ in range(2):  # a Mersenne prime: what is above its bits counts as ones
        above = value >> np.uint64(BITS)
        value &= np.uint64(_prime())
        value += above
    return value


def difference(a: Field, b: Field) -> Field:
    """The difference in the field, with the usual broadcasting."""
    value: Field = a + (np.uint64(_prime()) - b)
    value -= (value >= _prime()) * np.uint64(_prime())
    return value


def inverses(values: Field) -> Field:
    """One over each of a list of numbers of the field, none of them zero, (n,).

    Two numbers at a time: the inverse of their product times either is the inverse of the other (Montgomery 1987).
    """
    if len(values) < 32:
        return np.array([pow(v, -1, _prime()) for v in values.tolist()], dtype=np.uint64)
    half = len(values) // 2
    one, other = values[:half], values[half : 2 * half]
    both = inverses(np.concatenate([product(one, other), values[2 * half :]]))
    return np.concatenate([product(both[:half], other), product(both[:half], one), both[half:]])


def _add(entries: dict[int, int], more: dict[int, int], factor: int) -> None:
    """Adds a multiple of `more`; entries that become zero go."""
    prime = _prime()
    for key, value in more.items():
        total = (entries.get(key, 0) + factor * value) % prime
        if total:
            entries[key] = total
        else:
            entries.pop(key, None)


def _prime() -> int:
    return (1 << BITS) - 1

"""A shape: a dimensionless function that a missing term may follow, as a formula and as a course along a run."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Tables = Mapping[str, Mapping[str, object]]


@dataclass(frozen=True)
class Shape:
    """A dimensionless `formula` with its course `value` (K,) along a run, and what it brings, as tables of an entry.

    `family` is the same for shapes that differ in a fitted constant only. A `foreign` one uses a signal that the
    equation does not contain. `bare` ones are added only: as a factor they would be a parameter.
    """

    form: str
    words: str
    formula: str
    value: Array
    family: str
    foreign: bool = False
    bare: bool = False
    parameters: Tables = field(default_factory=dict)
    unknowns: Tables = field(default_factory=dict)
    equations: tuple[Mapping[str, object], ...] = ()
    differentials: tuple[Mapping[str, object], ...] = ()


def nice(value: float, digits: int = 1) -> float:
    """Return a value as people write it.

    >>> nice(0.01374)
    0.01
    """
    return float(f"{value:.{digits}g}")


def scale(unit: str, value: float, what: str) -> dict[str, object]:
    """Return the table of a constant that makes a signal dimensionless."""
    return {"unit": unit, "description": what, "value": value}

"""At which of many tests without states ranking looks: at no more than their equations have redundancy.

They are functions of the same samples: where they are linear they have no more directions than that (Krysander, Aslund
and Nyberg 2008). What numbers show beyond is curvature, which tells faults apart, or what networks err where they have
seen little, which looks like one. Drives left out decide which of the two it is.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.linalg import null_space

from faultline.analysis.graph.bank import Bank
from faultline.analysis.graph.independence import independent, most_apart
from faultline.analysis.structure import structure_of

Array = npt.NDArray[np.float64]


def static_rows(bank: Bank) -> list[int]:
    """Return the rows of the generators whose tests have equations and no states."""
    return [row for row, each in enumerate(bank.generators) if each.equations and not each.states]


def ranked_few(bank: Bank, standard: Array) -> list[int]:
    """Return the rows of generators whose residuals (K, T) are numerically independent, few of them without states."""
    static = static_rows(bank)
    parity = dict(zip(static, _parities(bank, static), strict=True))

    def may(rows: Sequence[int]) -> bool:
        return int(np.linalg.matrix_rank(np.array([parity[row] for row in rows]))) == len(rows)

    kept = most_apart(standard, static, may)
    rows = [row for row in range(len(bank.generators)) if row in kept or row not in static]
    return [rows[k] for k in independent(standard[:, rows])]


def _parities(bank: Bank, rows: Sequence[int]) -> list[Array]:
    """Return each test's parity vector (E,) over all equations, for random coefficients of the same structure.

    A minimal over-determined set has one vector that eliminates its unknowns, the left null space of its coefficients.
    Random coefficients have the generic rank: vectors that are dependent then are so by structure.
    """
    structure, rng = structure_of(bank.model), np.random.default_rng(0)
    unknowns = {name: column for column, name in enumerate(structure.unknowns)}
    matrix = np.zeros((len(structure.equations), len(unknowns)))
    for row, equation in enumerate(structure.equations):
        for name in structure.unknowns_in([equation]):
            matrix[row, unknowns[name]] = rng.uniform(0.5, 2.0)
    found = []
    for each in rows:
        own = [structure.row[name] for name in bank.generators[each].equations]
        parity = np.zeros(len(matrix))
        parity[own] = null_space(matrix[own].T)[:, 0]
        found.append(parity)
    return found

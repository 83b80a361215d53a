"""At which of many tests without states ranking looks: at no more than their equations have redundancy.

They are functions of the same samples: where they are linear they have no more directions than that (Krysander, Aslund
and Nyberg 2008). What numbers show beyond is curvature, which tells faults apart, or what networks err where they have
seen little, which looks like one. Drives left out decide which of the two it is.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt

from faultline.analysis.graph.bank import Bank
from faultline.analysis.graph.independence import independent, most_apart
from faultline.analysis.structure.structure import redundancy, structure_of

Array = npt.NDArray[np.float64]


def static_rows(bank: Bank) -> list[int]:
    """The rows of the generators whose tests have equations and no states."""
    return [row for row, each in enumerate(bank.generators) if each.equations and not each.states]


def ranked_few(bank: Bank, standard: Array) -> list[int]:
    """The rows of generators whose residuals (K, T) are numerically independent, few of them without states."""
    static, structure = static_rows(bank), structure_of(bank.model)

    def may(rows: Sequence[int]) -> bool:
        """Whether no set of these rows with the last one has more tests than redundancy."""
        for count in range(len(rows)):
            for some in combinations(rows[:-1], count):
                equations = {name for row in (*some, rows[-1]) for name in bank.generators[row].equations}
                if count + 1 > redundancy(structure, sorted(equations)):
                    return False
        return True

    kept = most_apart(standard, static, may)
    rows = [row for row in range(len(bank.generators)) if row in kept or row not in static]
    return [rows[k] for k in independent(standard[:, rows])]

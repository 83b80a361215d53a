"""What can be computed without differentiating, and what the known signals tell about the states.

A set of equations is a pencil sE - A over its unknowns: a differential constraint has s times its state minus its
derivative, everything else is a generic constant. That only two entries of a constraint are fixed does not matter:
scaling the row and the columns of state and derivative makes them generic too.
"""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from faultline.analysis.structure.decomposition import Part, dulmage_mendelsohn
from faultline.analysis.structure.matching import Matching, mask_of
from faultline.analysis.structure.structure import Structure


def low_index(structure: Structure, equations: Sequence[str] | None = None) -> bool:
    """Whether the equations (all by default) have low structural index.

    That is: the algebraic equations alone determine every unknown of the set but the states, so that derivatives and
    algebraic variables follow from states and known signals without differentiation (Frisk et al. 2012). An MSO set has
    a residual of integral causality exactly then. One with an under-determined algebraic variable is not of low index.
    """
    chosen = structure.equations if equations is None else structure.names(mask_of(structure.rows(equations)))
    states = _positions(structure, structure.states_in(chosen))
    rows = [
        structure.unknown_rows[row] & ~states for row in structure.rows(chosen) if not _differential(structure, row)
    ]
    wanted = structure.unknowns if equations is None else structure.unknowns_in(chosen)
    return Matching(rows).rank == (_positions(structure, wanted) & ~states).bit_count()


def observable(structure: Structure) -> bool:
    """Whether known signals structurally determine all states (those of differential constraints), initial values too.

    True if no state is under-determined and the pencil of M0 and M+ has full column rank for every complex s. It has
    full rank for generic s. At s = 0 a state drops out of its constraint. Elsewhere only M0 can lose rank, where the
    determinant of a Hall component has a root: it is a polynomial of more than one term (Murota: Matrices and
    Matroids for Systems Analysis, 2000).
    """
    parts = dulmage_mendelsohn(structure)
    if set(structure.states_in(structure.equations)) & set(parts.under.unknowns):
        return False
    under = set(structure.rows(parts.under.equations))
    inside = ~_positions(structure, parts.under.unknowns)
    rows = [row for row in range(len(structure.equations)) if row not in under]
    unknowns = set(structure.unknowns) - set(parts.under.unknowns)
    still = [structure.unknown_rows[row] & inside & ~_state(structure, row) for row in rows]  # s = 0
    if Matching(still).rank < len(unknowns):
        return False
    return not any(_has_free_motion(structure, component) for component in parts.just)


def differential_orders(structure: Structure, equations: Sequence[str]) -> Mapping[str, int]:
    """How often each equation of an MSO set is differentiated, at most, to eliminate all unknowns; by equation.

    For an equation that is the Jacobi number of the others: the largest total order, over all perfect matchings of the
    others with the unknowns, where a state in its differential constraint has order one and all else order zero (Li,
    Yuan and Gao 2015 for the differential resultant). Known signals of an equation are differentiated as often. The
    largest is the order of the MSO set.

    Raises:
        ValueError: the equations are no MSO set.
    """
    rows = structure.rows(equations)
    masks = [structure.unknown_rows[row] for row in rows]
    matching = Matching(masks)
    if len(matching.free) != 1 or len(matching.over_determined()) != len(rows):
        raise ValueError(f"{', '.join(equations)}: no MSO set; give one of mso_sets")
    unknowns = structure.unknowns_in(equations)
    return {
        structure.equations[row]: _degree(structure, [r for r in rows if r != row], unknowns, "highest") for row in rows
    }


def _has_free_motion(structure: Structure, component: Part) -> bool:
    """Whether a Hall component's determinant, a polynomial in s, has more than one term."""
    rows = structure.rows(component.equations)
    lowest = _degree(structure, rows, component.unknowns, "lowest")
    return lowest < _degree(structure, rows, component.unknowns, "highest")


def _degree(
    structure: Structure, rows: Sequence[int], unknowns: Sequence[str], which: Literal["lowest", "highest"]
) -> int:
    """The extreme degree in s of a square, structurally regular pencil's determinant, by an assignment."""
    columns = [structure.unknowns.index(name) for name in unknowns]
    present = np.array([[structure.unknown_rows[row] >> x & 1 for x in columns] for row in rows])  # (n, n)
    order = np.array([[_state(structure, row) >> x & 1 for x in columns] for row in rows])  # (n, n)
    if not rows:
        return 0
    from scipy.optimize import linear_sum_assignment  # some 0.4 s, of `faultline structure` only

    never = len(rows) + 1.0
    weight = np.where(present, order if which == "highest" else -order, -never)
    chosen = linear_sum_assignment(weight, maximize=True)
    return int(order[chosen].sum())


def _differential(structure: Structure, row: int) -> bool:
    return structure.equations[row] in structure.differentials


def _state(structure: Structure, row: int) -> int:
    """The state of a differential constraint as a mask; 0 for an algebraic equation."""
    constraint = structure.differentials.get(structure.equations[row])
    return 0 if constraint is None else _positions(structure, [constraint.state])


def _positions(structure: Structure, names: Sequence[str]) -> int:
    return mask_of([structure.unknowns.index(name) for name in names])

"""The structural model as a picture: which equation contains which unknowns, faults and known signals."""

from collections.abc import Sequence

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.figure import Figure

from faultline.analysis.structure.matching import bits
from faultline.analysis.structure.pictures.grid import Group, grid
from faultline.analysis.structure.pictures.style import BLUE, GREEN, ORANGE, STYLE, VERMILION, finish, marker
from faultline.analysis.structure.structure import Structure


@mpl.rc_context(STYLE)
def draw_model(structure: Structure, name: str = "the model") -> Figure:
    """Equations against unknowns, faults and known signals; `name` is the model's in the title.

    A differential constraint has I at its state and D at the derivative (Frisk et al. 2012).
    """
    columns = {"unknowns": structure.unknowns, "faults": structure.faults, "known signals": structure.known}
    shown = [kind for kind, names in columns.items() if names]
    drawn = grid(structure.equations, [Group(f"{kind} ({len(columns[kind])})", columns[kind]) for kind in shown])
    handles: list[Artist] = []
    if structure.unknowns:
        inside = _cells(structure.unknown_rows)
        constraints = {structure.equations.index(e): d for e, d in structure.differentials.items()}
        drawn.mark([cell for cell in inside if cell[0] not in constraints], BLUE, "marks-unknowns")
        handles.append(marker(BLUE, "unknown in an algebraic equation"))
        differential = [cell for cell in inside if cell[0] in constraints]
        drawn.mark(differential, ORANGE, "marks-differential", size=0.86)
        for row, x in differential:
            drawn.letter(row, x, "I" if structure.unknowns[x] == constraints[row].state else "D")
        if differential:
            handles.append(marker(ORANGE, "in a differential constraint: I its state, D the derivative"))
    if structure.faults:
        cells = [(structure.fault_rows[fault], f) for f, fault in enumerate(structure.faults)]
        drawn.mark(cells, VERMILION, "marks-faults", group=shown.index("faults"), shape="D", size=0.52)
        handles.append(marker(VERMILION, "fault", "D"))
    if structure.known:
        group = shown.index("known signals")
        drawn.mark(_cells(structure.known_rows), GREEN, "marks-known", group=group, shape="o", size=0.66)
        handles.append(marker(GREEN, "known signal", "o"))
    counts = f"{len(structure.equations)} equations, {len(structure.unknowns)} unknowns"
    return finish(drawn.figure, f"Structural model of {name}: {counts}", handles)


def _cells(rows: Sequence[int]) -> list[tuple[int, int]]:
    return [(row, column) for row, mask in enumerate(rows) for column in bits(mask)]

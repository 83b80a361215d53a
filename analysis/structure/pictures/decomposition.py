"""The Dulmage-Mendelsohn decomposition as a picture: rows and columns in block order, parts outlined, faults marked.

The order makes the matrix block upper triangular: nothing is marked below the parts (Dulmage and Mendelsohn 1958). The
equivalence classes of M+ with several equations are shaded boxes over their private unknowns; every other equation of
M+ is a class of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from faultline.analysis.structure.decomposition import Decomposition
from faultline.analysis.structure.matching import bits
from faultline.analysis.structure.pictures.grid import Grid, Group, grid
from faultline.analysis.structure.pictures.style import (
    BLUE,
    GREEN,
    INK,
    POINTS_PER_INCH,
    PURPLE,
    SKY,
    STYLE,
    VERMILION,
    box,
    finish,
    marker,
    text_width,
    tint,
)
from faultline.analysis.structure.structure import Structure

Kind = Literal["under", "just", "over"]
PARTS: dict[Kind, tuple[str, str]] = {"under": ("M-", PURPLE), "just": ("M0", GREEN), "over": ("M+", BLUE)}
MEANING = {
    "M-": "M-: more unknowns than equations", "M0": "M0: as many; a shaded box is solved together",
    "M+": "M+: more equations than unknowns",
}  # fmt: skip


@dataclass(frozen=True)
class _Block:
    """Equations, and the unknowns below which they stand on the diagonal; in M+ an equivalence class."""

    kind: Kind
    equations: tuple[str, ...]
    unknowns: tuple[str, ...]

    @property
    def several(self) -> bool:
        """Whether it is an equivalence class to be shown as such."""
        return self.kind == "over" and len(self.equations) > 1


@mpl.rc_context(STYLE)
def draw_decomposition(structure: Structure, found: Decomposition, name: str = "the model") -> Figure:
    """The structure in the block order of its decomposition; `name` is the model's in the title."""
    blocks = _blocks(found)
    equations = [equation for block in blocks for equation in block.equations]
    unknowns = (*(unknown for block in blocks for unknown in block.unknowns), *found.shared)
    drawn = grid(equations, [Group("", unknowns)], names_right=False)
    row_of = {equation: row for row, equation in enumerate(structure.equations)}
    column_of = {unknown: column for column, unknown in enumerate(unknowns)}
    cells = [
        (row, column_of[structure.unknowns[x]])
        for row, equation in enumerate(equations)
        for x in bits(structure.unknown_rows[row_of[equation]])
    ]
    drawn.mark(cells, INK, "marks-unknowns", size=0.5)
    _boxes(drawn, blocks)
    _parts(drawn, blocks, equations, found.shared)
    _faults(drawn, structure, equations, _brackets(drawn, blocks))
    count = f"{len(found.classes)} equivalence {'class' if len(found.classes) == 1 else 'classes'} in M+"
    title = f"Dulmage-Mendelsohn decomposition of {name}: redundancy {found.redundancy}, {count}"
    return finish(drawn.figure, title, _legend(structure, blocks))


def _blocks(found: Decomposition) -> list[_Block]:
    """From top left to bottom right: the components of M0 backwards, as block upper triangular form has them."""
    under = [_Block("under", found.under.equations, found.under.unknowns)]
    just = [_Block("just", part.equations, part.unknowns) for part in reversed(found.just)]
    over = [_Block("over", part.equations, part.unknowns) for part in found.classes]
    return [block for block in [*under, *just, *over] if block.equations or block.unknowns]


def _legend(structure: Structure, blocks: Sequence[_Block]) -> list[Artist]:
    kinds = [kind for kind in PARTS if any(block.kind == kind for block in blocks)]
    handles: list[Artist] = [marker(INK, "unknown in an equation")]
    handles += [box("none", MEANING[PARTS[kind][0]], PARTS[kind][1]) for kind in kinds]
    if any(block.several for block in blocks):
        handles.append(box(tint(SKY, 0.6), "equivalence class of several equations, with its own unknowns"))
    if structure.faults:
        handles.append(marker(VERMILION, "fault in the equation", "D"))
    return handles


def _boxes(drawn: Grid, blocks: Sequence[_Block]) -> None:
    """A shaded box for every class of several equations and for every component of M0 its outline."""
    row = column = 0
    for block in blocks:
        if block.several:
            _rectangle(drawn, row, column, block, face=tint(SKY, 0.6), edge=BLUE, width=0.8).set_gid("class")
        elif block.kind == "just":
            _rectangle(drawn, row, column, block, face=tint(GREEN, 0.18), edge=GREEN, width=0.8).set_gid("component")
        row += len(block.equations)
        column += len(block.unknowns)


def _rectangle(
    drawn: Grid, row: int, column: int, block: _Block, *, face: object, edge: str, width: float
) -> Rectangle:
    patch = Rectangle(
        (column - 0.5, row - 0.5), len(block.unknowns), len(block.equations), facecolor=face, edgecolor=edge,
        linewidth=width, zorder=2, clip_on=False,
    )  # fmt: skip
    drawn.axes.add_patch(patch)
    return patch


def _parts(drawn: Grid, blocks: Sequence[_Block], equations: Sequence[str], shared: tuple[str, ...]) -> None:
    """The outlines of M-, M0 and M+, each with its name left of its rows."""
    away = max((text_width(name, drawn.points) for name in equations), default=0.0) + 0.2
    row = column = 0
    for kind, (label, colour) in PARTS.items():
        found = [block for block in blocks if block.kind == kind]
        if not found:
            continue
        rest = shared if kind == "over" else ()
        whole = _Block(
            kind, tuple(e for b in found for e in b.equations), (*(x for b in found for x in b.unknowns), *rest)
        )
        _rectangle(drawn, row, column, whole, face="none", edge=colour, width=2).set_gid(f"part-{kind}")
        middle = row + len(whole.equations) / 2 - 0.5 if whole.equations else row - 1  # no rows: above the first
        drawn.axes.annotate(
            f"{label}  {len(whole.equations)} x {len(whole.unknowns)}", (-0.5, middle),
            xytext=(-away * POINTS_PER_INCH, 0), textcoords="offset points", ha="right", va="center",
            fontsize=drawn.points + 1, fontweight="bold", color=colour, annotation_clip=False,
        )  # fmt: skip
        row += len(whole.equations)
        column += len(whole.unknowns)


def _brackets(drawn: Grid, blocks: Sequence[_Block]) -> float:
    """A bar right of the rows of every class of several equations, with its title; returns where the titles end."""
    row, number, end = 0, 0, drawn.right + 0.4
    for block in blocks:
        number += block.kind == "over"
        title = f"class {number}"
        if block.several:
            at = drawn.right + 0.5
            drawn.axes.plot(
                [at, at], [row - 0.35, row + len(block.equations) - 0.65], color=BLUE, linewidth=2.5, clip_on=False,
                solid_capstyle="butt",
            )  # fmt: skip
            middle = row + len(block.equations) / 2 - 0.5
            drawn.axes.text(at + 0.35, middle, title, fontsize=drawn.points, va="center_baseline", color=BLUE)
            end = max(end, at + 0.35 + text_width(title, drawn.points) / drawn.cell)
        row += len(block.equations)
    return end


def _faults(drawn: Grid, structure: Structure, equations: Sequence[str], left: float) -> None:
    """A mark and the names of the faults at the rows of their equations."""
    row_of = {equation: row for row, equation in enumerate(equations)}
    names: dict[int, list[str]] = {}
    for fault in structure.faults:
        names.setdefault(row_of[structure.equations[structure.fault_rows[fault]]], []).append(fault)
    at = left + 0.7
    if names:
        size = (0.5 * drawn.cell * POINTS_PER_INCH) ** 2
        drawn.axes.scatter(
            [at] * len(names), [*names], s=size, marker="D", color=VERMILION, linewidths=0, clip_on=False
        ).set_gid("marks-faults")
    for row, faults in names.items():
        drawn.axes.text(at + 0.6, row, ", ".join(faults), fontsize=drawn.points, va="center_baseline", color=INK)

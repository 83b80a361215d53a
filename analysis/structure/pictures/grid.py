"""A matrix to be marked: named rows against groups of named columns, with bands and lines to follow by eye."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from faultline.analysis.structure.pictures.style import BAND, INK, LINE, POINTS_PER_INCH, blank, text_width

SMALL, LARGE = 20, 100  # rows between which the cells shrink
LARGE_CELL, SMALL_CELL = 0.27, 0.175  # [in]
MOST_POINTS = 9.5  # of the names
BETWEEN = 1.5  # columns of empty space between two groups, at least
MANY = 40  # rows or columns from which names are written on both sides
BANDED = 5  # rows in a band


@dataclass(frozen=True)
class Group:
    """Columns that belong together."""

    heading: str
    columns: tuple[str, ...]


@dataclass(frozen=True)
class Grid:
    """Axes where row i is at y = i, downwards, and column k of group g at x = starts[g] + k.

    A cell is `cell` inches, names have `points`, and the last column ends at x = `right`.
    """

    figure: Figure
    axes: Axes
    starts: tuple[float, ...]
    right: float
    cell: float
    points: float

    def mark(
        self, cells: Iterable[tuple[int, int]], colour: str, name: str, *, group: int = 0, shape: str = "s",
        size: float = 0.62,
    ) -> None:  # fmt: skip
        """Draws a mark of `size` cells into each (row, column) of a group; `name` is the SVG group's id."""
        at = np.array([*cells], dtype=float).reshape(-1, 2)
        area = (size * self.cell * POINTS_PER_INCH) ** 2
        marks = self.axes.scatter(
            self.starts[group] + at[:, 1], at[:, 0], s=area, marker=shape, color=colour, linewidths=0, clip_on=False,
            zorder=3,
        )  # fmt: skip
        marks.set_gid(name)

    def letter(self, row: int, column: int, text: str, *, group: int = 0) -> None:
        """Writes a letter into a cell."""
        points = 0.55 * self.cell * POINTS_PER_INCH
        self.axes.text(
            self.starts[group] + column, row, text, ha="center", va="center_baseline", fontsize=points,
            fontweight="bold", color=INK, zorder=4,
        )  # fmt: skip


def grid(rows: Sequence[str], groups: Sequence[Group], *, names_right: bool = True, banded: bool = True) -> Grid:
    """An empty matrix; `names_right` allows row names on the right too, where there are many columns."""
    cell = float(np.interp(len(rows), [SMALL, LARGE], [LARGE_CELL, SMALL_CELL]))
    points = min(MOST_POINTS, 0.62 * cell * POINTS_PER_INCH)
    widths = [max(len(g.columns), text_width(g.heading, points + 1, bold=True) / cell + 0.3) + BETWEEN for g in groups]
    starts = tuple(accumulate(widths[:-1], initial=0.0)) if groups else ()
    right = starts[-1] + len(groups[-1].columns) - 0.5 if groups else 0.5
    across, down = max(right + 0.5, 1.0), max(len(rows), 1)
    figure, axes = blank(across * cell, down * cell)
    axes.set_xlim(-0.5, across - 0.5)
    axes.set_ylim(down - 0.5, -0.5)
    for start, group in zip(starts, groups, strict=True):
        _panel(axes, start, len(rows), len(group.columns), banded)
    _names(axes, rows, groups, starts, points, names_right)
    _headings(axes, groups, starts, points, above=len(rows) >= MANY)
    return Grid(figure, axes, starts, right, cell, points)


def _panel(axes: Axes, start: float, rows: int, columns: int, banded: bool) -> None:
    """Bands and lines of one group."""
    left, right = start - 0.5, start + columns - 0.5
    for top in range(BANDED, rows if banded else 0, 2 * BANDED):
        axes.fill_between([left, right], top - 0.5, min(top + BANDED, rows) - 0.5, color=BAND, linewidth=0, zorder=0)
    axes.hlines(np.arange(rows + 1) - 0.5, left, right, colors=LINE, linewidths=0.5, zorder=1, clip_on=False)
    axes.vlines(
        start + np.arange(columns + 1) - 0.5, -0.5, rows - 0.5, colors=LINE, linewidths=0.5, zorder=1, clip_on=False
    )


def _names(
    axes: Axes, rows: Sequence[str], groups: Sequence[Group], starts: Sequence[float], points: float, both: bool
) -> None:
    places = [start + k for start, group in zip(starts, groups, strict=True) for k in range(len(group.columns))]
    axes.set_xticks(places, [name for group in groups for name in group.columns], rotation=90, color=INK)
    axes.set_yticks(range(len(rows)), rows, color=INK)
    axes.tick_params(length=0, pad=3, labelsize=points)
    axes.tick_params(labeltop=len(rows) >= MANY, labelright=both and len(places) >= MANY)
    for label in axes.get_xticklabels(which="both"):
        label.set_rotation(90)


def _headings(axes: Axes, groups: Sequence[Group], starts: Sequence[float], points: float, *, above: bool) -> None:
    """Over each group, above the column names where these are on top."""
    names = max((text_width(name, points) for g in groups for name in g.columns), default=0.0) if above else 0.0
    for start, group in zip(starts, groups, strict=True):
        axes.annotate(
            group.heading, (start - 0.5, -0.5), xytext=(0, names * POINTS_PER_INCH + 6), textcoords="offset points",
            fontsize=points + 1, fontweight="bold", color=INK, annotation_clip=False,
        )  # fmt: skip

"""Figures share colours, grids of axes, lines over time, and the fault-free recording that they compare with."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import TypeVar

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from faultline.analysis.evaluation.measure.facts import Facts
from faultline.analysis.evaluation.report.histograms import NARROWEST
from faultline.analysis.evaluation.story import Array, Story
from faultline.service.bundle.load import Bundle
from faultline.service.core.signals.values import Mask

MEASURED, PREDICTED, FREE, FAULTY = "#1f4e79", "#d55e00", "#0072b2", "#d55e00"
OTHERS = ("#009e73", "#cc79a7", "#7a5c00", "#56b4e9", "#7f7f7f")
SENSITIVE = "#e4e6e9"
ROWS = 10
"""A picture has so many rows at most; what is more goes into another one."""

Drawn = tuple[Figure, str, str]
"""A figure, what it says to who cannot see it, and its caption."""

Part = TypeVar("Part")

Pair = tuple[Story, Facts]
"""A recording that is drawn: all that happened inside, and what is counted of it."""


def pieces(of: Sequence[Part], most: int) -> Iterator[Sequence[Part]]:
    """Pieces of a sequence, in its order, each of `most` at the most.

    >>> [*pieces("abcde", 2)]
    ['ab', 'cd', 'e']
    """
    return (of[start : start + most] for start in range(0, len(of), most))


def by_graph(bundle: Bundle) -> list[tuple[str, list[int]]]:
    """Return the graphs of a bundle, each with the rows of its generators: equations and networks are apart."""
    rows = range(len(bundle.manifest.generators))
    return [(graph, [*of]) for graph, of in groupby(rows, key=lambda row: bundle.manifest.generators[row].graph)]


def grid(rows: int, columns: int, *, width: float, height: float) -> tuple[Figure, npt.NDArray[np.object_]]:
    """Return a figure of rows and columns of axes, each so wide and high with what is around it [inches].

    Margins are given, as a layout that is found takes as long as all else together.
    """
    left, right, top, bottom, apart = 0.85, 0.1, 0.55, 0.5, 0.6
    width = max(width, (NARROWEST - left - right) / columns)
    wide, high = left + right + width * columns, top + bottom + height * rows
    figure = Figure(figsize=(wide, high))
    axes = figure.subplots(rows, columns, squeeze=False)
    figure.subplots_adjust(
        left=left / wide,
        right=1.0 - right / wide,
        top=1.0 - top / high,
        bottom=bottom / high,
        wspace=apart / (width - apart),
        hspace=0.3 / (height - 0.3),
    )
    return figure, axes


def line(axes: Axes, t_s: Array, values: Array, where: Mask, colour: str, label: str = "") -> None:
    """Draw values over time where they can be told; gaps elsewhere."""
    axes.plot(t_s, np.where(where, values, np.nan), color=colour, linewidth=0.7, label=label)
    axes.margins(x=0)
    axes.tick_params(labelsize=7)


def fit(axes: Axes) -> None:
    """Set the limits to what 99 % of the values drawn need: a spike after a step would flatten all others."""
    drawn = np.concatenate([np.asarray(each.get_ydata(), dtype=np.float64) for each in axes.lines] or [np.zeros(0)])
    drawn = drawn[np.isfinite(drawn)]
    if drawn.size:
        low, high = np.quantile(drawn, [0.005, 0.995])
        room = 0.15 * (high - low) or 1.0
        axes.set_ylim(low - room, high + room)


def begins(axes: Axes, facts: Facts) -> None:
    """Draw the onset of a fault."""
    if facts.verdict.onset_s is not None:
        axes.axvline(facts.verdict.onset_s, color="#222222", linestyle="--", linewidth=0.9)


def reference(drawn: Sequence[Pair], facts: Facts) -> Story | None:
    """Return the fault-free recording to compare with, one of the same cycle before others; None: there is none."""
    free = [(story, one) for story, one in drawn if not one.case.faults]
    alike = [story for story, one in free if one.given.recording.cycle == facts.given.recording.cycle]
    return next(iter(alike or [story for story, _ in free]), None)

"""Measured and predicted signals with the residuals: over a cycle (thesis fig. 6.1, 6.8), under a fault (6.5, 6.12)."""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes

from faultline.analysis.evaluation.measure.signature import sensitive
from faultline.analysis.evaluation.report.document import Evaluation
from faultline.analysis.evaluation.report.figures.axes import (
    FAULTY,
    FREE,
    MEASURED,
    PREDICTED,
    ROWS,
    Drawn,
    Pair,
    begins,
    by_graph,
    fit,
    grid,
    line,
    pieces,
    reference,
)
from faultline.analysis.evaluation.story import Story


def over_cycle(e: Evaluation, drawn: Sequence[Pair]) -> Iterator[Drawn]:
    """Every generator over the first fault-free recording; none where there is no such recording."""
    free = [(story, one) for story, one in drawn if not one.case.faults]
    if not free:
        return
    story, one = free[0]
    for graph, rows in by_graph(story.bundle):
        for some in pieces(rows, ROWS):
            figure, axes = grid(len(some), 2, width=6.0, height=1.5)
            for (left, right), row in zip(axes, some, strict=True):
                _measured(left, e, story, row)
                _residual(right, e, story, row, FREE)
                left.set_ylabel(f"{e.tests[row].generator}\n{left.get_ylabel()}", fontsize=7)
            _titles(axes, "measured (blue) and predicted (orange)", "residual: measured less predicted")
            names = ", ".join(e.tests[row].generator for row in some)
            alt = f"Measured, predicted and residual of {names} over {one.verdict.recording}, without a fault."
            caption = (
                f"{one.verdict.recording} (cycle {one.given.recording.cycle}), without a fault: what each generator of "
                f"the graph {graph!r} predicts, and its residual. Gaps: it cannot tell. A good residual is noise "
                "around zero in every mode; one that moves with dose or pressure shows what the model misses."
            )
            yield figure, alt, caption


def most_moved(e: Evaluation, drawn: Sequence[Pair]) -> Iterator[Drawn]:
    """Each fault as the generator sees it that it moves most, over the fault-free residual; a picture a graph."""
    faulty = [(story, one) for story, one in drawn if one.case.faults]
    if not faulty:
        return
    for graph, rows in by_graph(faulty[0][0].bundle):
        chosen = [(pair, row) for pair in faulty if (row := _most_moved(e, pair, rows)) is not None]
        for some in pieces(chosen, ROWS):
            figure, axes = grid(len(some), 2, width=6.0, height=1.5)
            for (left, right), ((story, one), row) in zip(axes, some, strict=True):
                _measured(left, e, story, row)
                if (free := reference(drawn, one)) is not None:
                    _residual(right, e, free, row, FREE)
                _residual(right, e, story, row, FAULTY)
                right.set_xlim(story.t_s[0], story.t_s[-1])
                left.set_ylabel(f"{one.case.label}\n{e.tests[row].generator} {left.get_ylabel()}", fontsize=7)
                for panel in (left, right):
                    begins(panel, one)
            _titles(axes, "measured (blue) and predicted (orange)", "residual: with the fault (orange), without (blue)")
            said = ", ".join(f"{one.case.label} by {e.tests[row].generator}" for (_, one), row in some)
            caption = (
                f"Of each fault the generator of the graph {graph!r} that it moves most, in spreads of its fault-free "
                "residual. Dashed: the onset. The fault-free recording is one of the same cycle where there is one; "
                "else compare sizes and not times."
            )
            yield figure, f"Measured, predicted and residual: {said}.", caption


def _most_moved(e: Evaluation, pair: Pair, rows: Sequence[int]) -> int | None:
    """Return the row, of those sensitive to the fault where it is known, of the largest mean residual after onset."""
    story, one = pair
    known = [*e.faults]
    sees = [row for row in rows if sensitive(e.tests[row], one.case.faults, known) is not False]
    after = story.t_s >= (one.verdict.onset_s or 0.0)
    told = {row: after & story.usable[:, row] for row in sees}
    means = {row: abs(np.mean(story.standardised[ticks, row])) for row, ticks in told.items() if ticks.any()}
    return max(means, key=lambda row: float(means[row]), default=None)


def _measured(axes: Axes, e: Evaluation, story: Story, row: int) -> None:
    shown = e.tests[row].shown(np.inf)
    every = np.ones(len(story.t_s), dtype=np.bool_)
    line(axes, story.t_s, shown.scaled(story.y_hat[:, row] + story.r[:, row]), every, MEASURED)
    line(axes, story.t_s, shown.scaled(story.y_hat[:, row]), story.usable[:, row], PREDICTED)
    fit(axes)
    axes.set_ylabel(f"{e.tests[row].predicts} [{shown.unit}]", fontsize=7)


def _residual(axes: Axes, e: Evaluation, story: Story, row: int, colour: str) -> None:
    shown = e.tests[row].shown(e.tests[row].rms or 0.0)
    line(axes, story.t_s, story.r[:, row] / shown.size, story.usable[:, row], colour)
    fit(axes)
    axes.axhline(0.0, color="#444444", linewidth=0.5)
    axes.set_ylabel(f"[{shown.unit}]", fontsize=7)


def _titles(axes: np.ndarray[tuple[int, int], np.dtype[np.object_]], left: str, right: str) -> None:
    axes[0, 0].set_title(left, fontsize=9)
    axes[0, 1].set_title(right, fontsize=9)
    for panel in axes[-1]:
        panel.set_xlabel("log time [s]", fontsize=8)

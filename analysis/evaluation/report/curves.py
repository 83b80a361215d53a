"""ROC of every generator: a curve for each fault that the test is sensitive to, grey ones for those it decouples."""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from faultline.analysis.evaluation.blocks import joined
from faultline.analysis.evaluation.measure.facts import Facts
from faultline.analysis.evaluation.measure.roc import Array, curve
from faultline.analysis.evaluation.report.document import Evaluation

ACROSS = 5
COLOURS = tuple(f"C{number}" for number in (0, 1, 2, 3, 4, 5, 6, 8, 9))
STYLES = ("-", "--", ":")
DECOUPLED = "#b5b9be"

Drawn = tuple[Figure, str, str]


def draw(e: Evaluation, of: Sequence[Facts]) -> Iterator[Drawn]:
    """One picture; none where no recording has a fault."""
    cases = [*dict.fromkeys(one.case for one in of if one.case.faults)]
    if not cases:
        return
    seen = {cell.case for cell in e.cells if cell.sensitive}
    faults = [*dict.fromkeys(case.faults for case in cases if case.label in seen)]
    colours = {names: COLOURS[number % len(COLOURS)] for number, names in enumerate(faults)}
    order = {case: [c for c in cases if c.faults == case.faults].index(case) for case in cases}
    down = -(-len(e.tests) // ACROSS)
    figure = Figure(figsize=(12.5, 2.6 * down + 0.9), layout="constrained")
    axes = figure.subplots(down, ACROSS, squeeze=False, sharex=True, sharey=True).ravel()
    free = joined([one.blocks for one in of])
    sees = {(cell.generator, cell.case): cell.sensitive for cell in e.cells}
    for column, test in enumerate(e.tests):
        quiet = free.scores[~free.faulty, 0, column]
        decoupled = [case for case in cases if not sees[test.generator, case.label]]
        for case in [*decoupled, *(case for case in cases if case not in decoupled)]:
            here = joined([one.blocks for one in of if one.case == case])
            loud = here.scores[here.faulty, 0, column]
            colour = DECOUPLED if case in decoupled else colours[case.faults]
            _line(axes[column], quiet, loud, colour, STYLES[min(order[case], 2)])
        axes[column].set_title(test.generator, fontsize=9)
        axes[column].plot([0, 1], [0, 1], color="#444444", linewidth=0.6, linestyle=":")
    for spare in axes[len(e.tests) :]:
        spare.set_visible(False)
    figure.supxlabel("share of fault-free blocks above the threshold", fontsize=9)
    figure.supylabel("share of faulty blocks above it", fontsize=9)
    handles = [Line2D([], [], color=colours[names], label="+".join(names)) for names in faults]
    handles.append(Line2D([], [], color=DECOUPLED, label="decoupled or not known"))
    figure.legend(handles=handles, loc="outside upper center", ncols=6, fontsize=8, frameon=False)
    alt = f"ROC curves of {', '.join(test.generator for test in e.tests)} for each fault; the areas are in the tables."
    caption = (
        "Receiver operating characteristic over blocks; the score is the absolute mean of the standardised residual, "
        "without edges. Coloured: faults that the test is sensitive to by structure; a line style for each size in the "
        "order of the recordings (full, dashed, dotted). A grey curve should stay on the diagonal."
    )
    yield figure, alt, caption


def _line(axes: Axes, free: Array, faulty: Array, colour: str, style: str) -> None:
    if not np.isfinite(free).any() or not np.isfinite(faulty).any():
        return
    x, y = curve(free, faulty)
    axes.plot(x, y, color=colour, linestyle=style, linewidth=0.6 if colour == DECOUPLED else 1.3)
    axes.set_xlim(-0.02, 1.02)
    axes.set_ylim(-0.02, 1.02)

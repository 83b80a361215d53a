"""Histograms of the residuals, fault-free against faulty: generators down, faults across (thesis fig. 6.2, 6.9)."""

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from faultline.analysis.evaluation.measure.facts import BINS, LARGEST, Facts
from faultline.analysis.evaluation.measure.signature import sensitive
from faultline.analysis.evaluation.report.document import Evaluation

ROWS, COLUMNS = 10, 10
"""Of a picture: what is more goes into another one."""

NARROWEST = 8.0
"""Inches: the page shows every picture as wide as itself, and a narrow one would be metres high."""

FREE, FAULTY, SENSITIVE = "#0072b2", ("#d55e00", "#f0a03c", "#8a3b00"), "#e4e6e9"
TICKS = (-LARGEST, -10.0, 0.0, 10.0, LARGEST)

Drawn = tuple[Figure, str, str]


def draw(e: Evaluation, of: Sequence[Facts]) -> Iterator[Drawn]:
    """One picture for every `ROWS` generators and `COLUMNS` faults."""
    faults = [*dict.fromkeys(one.case.faults for one in of if one.case.faults)]
    for top in range(0, len(e.tests), ROWS):
        for left in range(0, len(faults), COLUMNS):
            yield _grid(e, of, list(range(top, min(top + ROWS, len(e.tests)))), faults[left : left + COLUMNS])


def _grid(e: Evaluation, of: Sequence[Facts], rows: list[int], faults: Sequence[tuple[str, ...]]) -> Drawn:
    tests = [e.tests[row] for row in rows]
    figure = Figure(figsize=(max(NARROWEST, 1.6 + 1.25 * len(faults)), 1.1 + 0.95 * len(rows)), layout="constrained")
    axes = figure.subplots(len(rows), len(faults), squeeze=False, sharex=True)
    free = np.sum([one.histogram[0] for one in of], axis=0)  # (T, BINS)
    for column, names in enumerate(faults):
        cases = [*dict.fromkeys(one.case for one in of if one.case.faults == names)]
        for line, row in enumerate(rows):
            counts = [np.sum([one.histogram[1, row] for one in of if one.case == case], axis=0) for case in cases]
            _cell(axes[line, column], free[row], counts, bool(sensitive(e.tests[row], names, [*e.faults])))
        sizes = ", ".join(case.size for case in cases if case.size)
        axes[0, column].set_title("+".join(names) + (f"\n{sizes}" if sizes else ""), fontsize=8)
    for line, test in enumerate(tests):
        axes[line, 0].set_ylabel(test.generator, fontsize=8, rotation=0, ha="right", va="center")
    figure.supxlabel("residual in fault-free spreads of its operating mode (scale: asinh)", fontsize=9)
    words = "blue: fault-free; orange: with the fault, a shade a size; grey: the test is sensitive by structure"
    figure.suptitle(words, fontsize=9)
    named = ", ".join("+".join(names) for names in faults)
    alt = f"Grid of histograms: {', '.join(test.generator for test in tests)} by {named}. {words}."
    caption = (
        "Share of the ticks at each value of the residual in which the generator can tell, as the detector sees it: "
        "off its fault-free offset, in spreads of its mode; what lies beyond the scale is in its last bin. A fault is "
        "seen where orange leaves blue; in a white cell it should not."
    )
    return figure, alt, caption


def _cell(axes: Axes, free: npt.NDArray[np.int64], faulty: Sequence[npt.NDArray[np.int64]], is_sensitive: bool) -> None:
    """One generator, one fault: a step line for every size."""
    edges = np.arange(BINS + 1)
    axes.set_facecolor(SENSITIVE if is_sensitive else "white")
    axes.stairs(free / max(free.sum(), 1), edges, fill=True, color=FREE, alpha=0.75)
    for shade, counts in zip(FAULTY, faulty, strict=False):
        axes.stairs(counts / max(counts.sum(), 1), edges, color=shade, linewidth=1.2)
    places = (np.arcsinh(TICKS) / np.arcsinh(LARGEST) + 1.0) * BINS / 2
    axes.set_xticks(places, [f"{tick:g}" for tick in TICKS], fontsize=6)
    axes.set_yticks([])
    axes.set_xlim(0, BINS)

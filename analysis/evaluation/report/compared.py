"""Measured, by equations and by a network of the same test, in the last mode (thesis fig. 6.17)."""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.figure import Figure

from faultline.analysis.evaluation.measure.facts import Facts
from faultline.analysis.evaluation.report.document import Evaluation
from faultline.analysis.evaluation.story import Story
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.time_scale import Span

AROUND = Span(settlings=3)
COLOURS = ("#d55e00", "#009e73", "#cc79a7")

Drawn = tuple[Figure, str, str]


def draw(e: Evaluation, drawn: Sequence[tuple[Story, Facts]]) -> Iterator[Drawn]:
    """One picture, of the first recording shown over time; none where each test has one generator alone."""
    names = [test.test for test in e.tests]
    several = [name for name in dict.fromkeys(names) if names.count(name) > 1]
    if not several or not drawn:
        return
    story, one = min(drawn, key=lambda pair: bool(pair[1].case.faults))  # a fault-free one where there is one
    figure = Figure(figsize=(13, 0.8 + 2.2 * len(several)), layout="constrained")
    axes = figure.subplots(len(several), 2, squeeze=False, sharex=True)
    part = _around(story)
    for (panel, errors), name in zip(axes, several, strict=True):
        rows = [row for row, test in enumerate(names) if test == name]
        shown = e.tests[rows[0]].shown(np.inf)
        measured = shown.scaled((story.y_hat + story.r)[part, rows[0]])
        panel.plot(story.t_s[part], measured, color="#1f4e79", linewidth=1.0, label="measured")
        for colour, row in zip(COLOURS, rows, strict=False):
            predicted = np.where(story.usable[part, row], shown.scaled(story.y_hat[part, row]), np.nan)
            panel.plot(story.t_s[part], predicted, color=colour, linewidth=1.0, label=e.tests[row].generator)
            errors.plot(story.t_s[part], measured - predicted, color=colour, linewidth=0.8)
        panel.set_ylabel(f"{e.tests[rows[0]].predicts} [{shown.unit}]", fontsize=8)
        panel.legend(loc="best", ncols=1, fontsize=7)
        errors.axhline(0.0, color="#444444", linewidth=0.6)
        for one_of in (panel, errors):
            one_of.margins(x=0)
            one_of.tick_params(labelsize=7)
    axes[0, 0].set_title("measured and predicted", fontsize=9)
    axes[0, 1].set_title("residual", fontsize=9)
    for panel in axes[-1]:
        panel.set_xlabel("log time [s]", fontsize=8)
    title = f"{one.verdict.recording}: {one.case.label}"
    figure.suptitle(title, fontsize=10, fontweight="bold", x=0.01, ha="left")
    alt = f"Measured signals and predictions of {', '.join(several)} by each method, {title}; errors are in the table."
    yield figure, alt, f"Measured and predicted around the longest stay in the last mode, and what is left, {title}."


def _around(story: Story) -> slice:
    """Six settling times around the middle of the longest stay in the last mode, or around the middle."""
    last = len(story.bundle.manifest.modes.names) - 1
    at = np.concatenate([[False], (story.mode == last) & (last != EDGE), [False]])
    starts, stops = np.flatnonzero(at[1:] & ~at[:-1]), np.flatnonzero(~at[1:] & at[:-1])
    longest = int(np.argmax(stops - starts)) if starts.size else None
    middle = len(story.mode) // 2 if longest is None else int(starts[longest] + stops[longest]) // 2
    ticks = story.bundle.manifest.time.ticks(AROUND)
    return slice(max(middle - ticks, 0), middle + ticks)

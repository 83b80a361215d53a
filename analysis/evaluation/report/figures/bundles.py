"""One recording by several bundles: trainings of one network (thesis fig. 5.13), or other training data (6.16)."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from faultline.analysis.evaluation.report.document import Evaluation
from faultline.analysis.evaluation.report.figures.axes import (
    MEASURED,
    OTHERS,
    PREDICTED,
    ROWS,
    Drawn,
    Pair,
    begins,
    fit,
    grid,
    line,
    pieces,
)
from faultline.analysis.evaluation.story import Story


def draw(e: Evaluation, drawn: Sequence[Pair], beside: Mapping[str, Sequence[Story]]) -> Iterator[Drawn]:
    """Each recording, a row a generator of which another bundle predicts something else.

    `beside` are the stories of each other bundle, by its name.
    """
    for story, one in drawn:
        others = {name: told for name, of in beside.items() for told in of if told.recording == story.recording}
        differ = [row for row in range(len(e.tests)) if any(_differs(story, row, told) for told in others.values())]
        for rows in pieces(differ, ROWS):
            figure, axes = grid(len(rows), 2, width=6.0, height=1.6)
            for (left, right), row in zip(axes, rows, strict=True):
                test, shown = e.tests[row], e.tests[row].shown(np.inf)
                fine = test.shown(test.rms or 0.0)
                measured = shown.scaled(story.y_hat[:, row] + story.r[:, row])
                line(left, story.t_s, measured, np.ones(len(story.t_s), dtype=np.bool_), MEASURED, "measured")
                every = [(e.bundle, story, row), *((name, told, _row(told, test.generator)) for name, told in
                         others.items())]  # fmt: skip
                for colour, (name, told, column) in zip((PREDICTED, *OTHERS), every, strict=False):
                    if column is None:
                        continue
                    usable = told.usable[:, column]
                    line(left, told.t_s, shown.scaled(told.y_hat[:, column]), usable, colour, name)
                    line(right, told.t_s, told.r[:, column] / fine.size, usable, colour)
                left.set_ylabel(f"{test.generator}\n{test.predicts} [{shown.unit}]", fontsize=7)
                right.set_ylabel(f"[{fine.unit}]", fontsize=7)
                for panel in (left, right):
                    fit(panel)
                    begins(panel, one)
            axes[0, 0].legend(fontsize=7, ncols=3, loc="best")
            axes[0, 0].set_title("measured and predicted", fontsize=9)
            axes[0, 1].set_title("residuals", fontsize=9)
            for panel in axes[-1]:
                panel.set_xlabel("log time [s]", fontsize=8)
            figure.suptitle(
                f"{one.verdict.recording}: {one.case.label}", fontsize=10, fontweight="bold", y=1.0, va="top"
            )
            names = ", ".join(others)
            alt = f"{one.verdict.recording}, {one.case.label}: predictions of {e.bundle} beside those of {names}."
            caption = (
                f"{one.verdict.recording}, {one.case.label}: each generator by bundle {e.bundle} and by {names}. Where "
                "trainings of one network come apart, the recording that they learnt from did not say what happens "
                "there. No bundle was made from this recording."
            )
            yield figure, alt, caption


def _differs(story: Story, row: int, told: Story) -> bool:
    """Return whether another bundle has the generator and predicts something else: equations may be the same."""
    column = _row(told, story.bundle.manifest.generators[row].name)
    if column is None:
        return False
    ticks = min(len(story.t_s), len(told.t_s))
    return not np.allclose(story.y_hat[:ticks, row], told.y_hat[:ticks, column])


def _row(told: Story, generator: str) -> int | None:
    names = [one.name for one in told.bundle.manifest.generators]
    return names.index(generator) if generator in names else None

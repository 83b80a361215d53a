"""Residuals and detectors: generators down, recordings across (thesis fig. 6.4, 6.6, 6.7, 6.11, 6.13, 6.14)."""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes

from faultline.analysis.evaluation.measure.signature import sensitive
from faultline.analysis.evaluation.report.document import Evaluation
from faultline.analysis.evaluation.report.figures.axes import (
    FAULTY,
    FREE,
    ROWS,
    SENSITIVE,
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
from faultline.analysis.evaluation.story import Array, Story
from faultline.service.core.signals.values import Mask

ACROSS = 5
"""Recordings of a picture: what is more goes into another one."""
BEYOND = 2.2
"""Axes end there, in parts of a detector's threshold; its sums end at 2."""
GREY = "grey: the test is sensitive to the fault by structure"


def residuals(e: Evaluation, drawn: Sequence[Pair]) -> Iterator[Drawn]:
    """The residual of every generator under every fault, over the fault-free one."""
    faulty = [pair for pair in drawn if pair[1].case.faults]
    for rows, pairs in _pictures(drawn, faulty):
        figure, axes = grid(len(rows), len(pairs), width=2.5, height=1.15)
        for line_, row in enumerate(rows):
            shown = e.tests[row].shown(e.tests[row].rms or 0.0)
            for column, (story, one) in enumerate(pairs):
                panel = axes[line_, column]
                if (free := reference(drawn, one)) is not None:
                    line(panel, free.t_s, free.r[:, row] / shown.size, free.usable[:, row], FREE)
                line(panel, story.t_s, story.r[:, row] / shown.size, story.usable[:, row], FAULTY)
                fit(panel)
                panel.set_xlim(story.t_s[0], story.t_s[-1])
                begins(panel, one)
                _shade(panel, e, row, one.case.faults)
            axes[line_, 0].set_ylabel(f"{e.tests[row].generator}\n[{shown.unit}]", fontsize=7)
        _heads(axes, pairs, "log time [s]")
        alt = f"Residuals of {_named(e, rows)} under {_cases(pairs)}, each over the fault-free one. {GREY}."
        caption = (
            "Residuals with a fault (orange) over those without (blue), which are of the same cycle where the set has "
            f"one. Dashed: the onset; {GREY}. In a white panel orange should stay on blue: what leaves it there is no "
            "sign of this fault, but of what the model misses."
        )
        yield figure, alt, caption


def detectors(e: Evaluation, drawn: Sequence[Pair], mode: str | None = None) -> Iterator[Drawn]:
    """The detector of every generator over every recording, in parts of its threshold; in one `mode` alone, or all."""
    free = [pair for pair in drawn if not pair[1].case.faults][:1]
    faulty = [pair for pair in drawn if pair[1].case.faults]
    for rows, some in _pictures(drawn, faulty or free):
        pairs = [*free, *some] if faulty else some
        figure, axes = grid(len(rows), len(pairs), width=2.2, height=1.15)
        for line_, row in enumerate(rows):
            for column, (story, one) in enumerate(pairs):
                panel = axes[line_, column]
                when, there = _ticks(story, mode)
                tells = story.usable[there, row]
                line(panel, when, abs(story.sums[there, row]), tells, "#333333")
                line(panel, when, abs(story.sums[there, row]), tells & story.fired[there, row], FAULTY)
                panel.axhline(1.0, color="black", linestyle="--", linewidth=0.8)
                panel.set_ylim(0.0, BEYOND)
                if one.verdict.onset_s is not None:
                    at = int(np.searchsorted(story.t_s[there], one.verdict.onset_s))
                    panel.axvline(when[min(at, len(when) - 1)] if len(when) else 0.0, color="#222222", linestyle=":")
                _shade(panel, e, row, one.case.faults)
            axes[line_, 0].set_ylabel(e.tests[row].generator, fontsize=7)
        _heads(axes, pairs, "log time [s]" if mode is None else f"time in mode {mode} [s]")
        where = "in all modes" if mode is None else f"in mode {mode} alone"
        alt = f"Detectors of {_named(e, rows)} {where}, over {_cases(pairs)}. {GREY}."
        caption = (
            f"Detectors {where}, in parts of their thresholds (dashed); orange: alarm; dotted: the onset; {GREY}. "
            + ("" if mode is None else "The time in the mode is drawn without what lies between. ")
            + "A grey panel should alarm after the onset and a white one never. Thresholds and offsets are those of "
            "each operating mode (docs/decisions/003)."
        )
        yield figure, alt, caption


def _pictures(drawn: Sequence[Pair], across: Sequence[Pair]) -> Iterator[tuple[Sequence[int], Sequence[Pair]]]:
    """Rows of generators, a graph at a time, and recordings, of one picture after the other."""
    for _, rows in by_graph(drawn[0][0].bundle) if drawn else ():
        for some in pieces(rows, ROWS):
            for pairs in pieces(across, ACROSS):
                yield some, pairs


def _ticks(story: Story, mode: str | None) -> tuple[Array, Mask]:
    """The time to draw [s] and which ticks: of all, or of a mode, put together."""
    if mode is None:
        return story.t_s, np.ones(len(story.t_s), dtype=np.bool_)
    there = np.asarray(story.mode == story.bundle.manifest.modes.names.index(mode))
    return np.arange(int(there.sum()), dtype=np.float64) * story.bundle.manifest.period_s, there


def _shade(panel: Axes, e: Evaluation, row: int, faults: tuple[str, ...]) -> None:
    sees = bool(faults) and bool(sensitive(e.tests[row], faults, [*e.faults]))
    panel.set_facecolor(SENSITIVE if sees else "white")


def _heads(axes: np.ndarray[tuple[int, int], np.dtype[np.object_]], pairs: Sequence[Pair], below: str) -> None:
    for column, (_, one) in enumerate(pairs):
        axes[0, column].set_title(one.case.label, fontsize=8)
        axes[-1, column].set_xlabel(below, fontsize=7)


def _named(e: Evaluation, rows: Sequence[int]) -> str:
    return ", ".join(e.tests[row].generator for row in rows)


def _cases(pairs: Sequence[Pair]) -> str:
    return ", ".join(f"{one.case.label} ({story.recording})" for story, one in pairs)

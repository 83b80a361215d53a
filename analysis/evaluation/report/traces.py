"""Residual and detector over a recording, a row a generator, with the operating mode behind (thesis fig. 6.6, 6.13)."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from faultline.analysis.evaluation.measure.facts import Facts
from faultline.analysis.evaluation.measure.signature import sensitive
from faultline.analysis.evaluation.picture import told
from faultline.analysis.evaluation.report.document import Evaluation
from faultline.analysis.evaluation.story import Array, Story
from faultline.service.core.detectors.kinds import kind_of
from faultline.service.core.signals.values import Mask

SHADES, EDGE_SHADE = ("#dcefe3", "#ffffff", "#fbe3cf", "#e3e0f3", "#f6f0cd"), "#d3d6da"
RESIDUAL, ALARM, ONSET = "#1f4e79", "#c62828", "#222222"

Drawn = tuple[Figure, str, str]


def draw(e: Evaluation, story: Story, one: Facts) -> Drawn:
    """One recording, and below what was told of it; of numerically the same signals the first generator alone."""
    rows = [row for row, test in enumerate(e.tests) if test.equals == test.generator]
    figure = Figure(figsize=(13, 2.7 + 1.35 * len(rows)), layout="constrained")
    grid = figure.add_gridspec(len(rows) + 1, 2, height_ratios=[1.0] * len(rows) + [1.2])
    last = figure.add_subplot(grid[-1, :])
    told(last, story, story.events, "")
    last.set_xlim(story.t_s[0], story.t_s[-1])
    last.tick_params(labelsize=7)
    last.yaxis.label.set_fontsize(8)
    axes = [[figure.add_subplot(grid[line, column], sharex=last) for column in (0, 1)] for line in range(len(rows))]
    for line, row in enumerate(rows):
        test, (left, right) = e.tests[row], axes[line]
        shown = test.shown(test.rms or 0.0)
        tells, alarm = story.usable[:, row], story.alarm[:, row]
        _trace(left, story.t_s, np.where(tells, story.r[:, row] / shown.size, np.nan), alarm)
        _trace(right, story.t_s, abs(story.sums[:, row]), alarm)
        right.axhline(1.0, color="black", linestyle="--", linewidth=0.9)
        right.set_ylim(0.0, 2.2)
        left.set_ylabel(f"{test.generator}\n[{shown.unit}]", fontsize=8)
        sees = bool(sensitive(test, one.case.faults, [*e.faults])) if one.case.faults else False
        for panel in (left, right):
            _behind(panel, story, one.verdict.onset_s)
            panel.tick_params(labelsize=7, labelbottom=line == len(rows) - 1)
            for spine in panel.spines.values():
                spine.set_linewidth(2.2 if sees else 0.6)
    detectors = _detectors(story)
    axes[0][0].set_title("residual", fontsize=9)
    axes[0][1].set_title(f"{detectors} in parts of its threshold", fontsize=9)
    for panel in (*axes[-1], last):
        panel.set_xlabel("log time [s]", fontsize=8)
    if one.verdict.onset_s is not None:
        last.axvline(one.verdict.onset_s, color=ONSET, linestyle="--", linewidth=1)
    handles = [
        Patch(color=shade, label=mode)
        for mode, shade in zip(story.bundle.manifest.modes.names, _shades(story), strict=True)
    ]
    handles.append(Patch(color=ALARM, label="alarm"))
    figure.legend(handles=handles, loc="outside upper right", ncols=4, fontsize=8, frameon=False)
    name, case = one.verdict.recording, one.case.label
    figure.suptitle(f"{name}: {case}", fontsize=10, fontweight="bold", x=0.01, ha="left")
    alarmed = [e.tests[row].generator for row in rows if story.alarm[:, row].any()]
    alt = f"Residuals and detectors ({detectors}) of {name}, {case}; alarms of {', '.join(alarmed) or 'no generator'}."
    left_out = ", ".join(f"{test.generator} (as {test.equals})" for test in e.tests if test.equals != test.generator)
    caption = (
        f"{name}, {case}. Dashed: threshold and onset; red: alarm; gaps: cannot tell; behind: operating "
        "mode. A thick frame: the test is sensitive to the fault by structure. Below: what was told, dark "
        "while of rank 1." + (f" Not drawn, being the same signal as another: {left_out}." if left_out else "")
    )
    return figure, alt, caption


def _detectors(story: Story) -> str:
    """The kinds of what tests the levels, in words."""
    kinds = dict.fromkeys(kind_of(detector) for detector in story.bundle.manifest.detectors[: story.r.shape[1]])
    return ", ".join("CUSUM" if kind == "cusum" else kind for kind in kinds)


def _trace(axes: Axes, t_s: Array, values: Array, alarm: Mask) -> None:
    axes.plot(t_s, values, color=RESIDUAL, linewidth=0.7)
    axes.plot(t_s, np.where(alarm, values, np.nan), color=ALARM, linewidth=0.9)
    axes.margins(x=0)


def _shades(story: Story) -> list[str]:
    """A colour of every operating mode."""
    return [EDGE_SHADE, *(SHADES[k % len(SHADES)] for k in range(len(story.bundle.manifest.modes.steady)))]


def _behind(axes: Axes, story: Story, onset_s: float | None) -> None:
    """Operating modes as shades, and the onset."""
    shades = _shades(story)
    edges = np.flatnonzero(np.diff(story.mode)) + 1
    for start, stop in zip([0, *edges], [*edges, len(story.mode)], strict=True):
        axes.axvspan(story.t_s[start], story.t_s[stop - 1], color=shades[story.mode[start]], linewidth=0, zorder=0)
    if onset_s is not None:
        axes.axvline(onset_s, color=ONSET, linestyle="--", linewidth=1)

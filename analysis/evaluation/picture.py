"""The story of a recording at a glance: signals, residuals, CUSUM and what was told, over one time axis."""

from collections.abc import Sequence
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from faultline.analysis.evaluation.judge import Verdict
from faultline.analysis.evaluation.story import Story
from faultline.service.core.display import display_of
from faultline.service.core.records.event import Event
from faultline.writing import write_file

MEASURED, PREDICTED = ("#1f4e79", "#5b9bd5", "#12355b"), ("#e07b00", "#f4b183", "#8a4b00")
ALARM, ONSET, INPUTS = "#c62828", "#444444", ("#6a4c93", "#2e7d32")
SPREADS = 12  # where a residual leaves its row of the picture
APART = 3.0
"""Signals whose medians are this many times apart are drawn in different panels."""


def draw(story: Story, live: Sequence[Event] | None, verdict: Verdict, path: Path) -> None:
    """Writes the picture as a PNG; `live` are the events of a bus, where those are judged and not the log's own."""
    mpl.use("Agg")
    together = _together(story)
    heights = [*(2 if len(columns) > 1 else 1.4 for columns in together), 1, 2, 2, 1.3]
    figure = Figure(figsize=(13, 1.24 * sum(heights)), layout="constrained")
    rows = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    for axes, columns in zip(rows, together, strict=False):
        _signals(axes, story, columns)
    if verdict.onset_s is not None:
        place = (verdict.onset_s, rows[0].get_ylim()[0])
        rows[0].annotate("fault begins", place, xytext=(4, 6), textcoords="offset points", color=ONSET)
    _inputs(rows[-4], story)
    _residuals(rows[-3], story)
    _sums(rows[-2], story)
    told(rows[-1], story, story.events if live is None else live, "offline" if live is None else "over the bus")
    for axes in rows:
        axes.grid(visible=True, alpha=0.25)
        axes.margins(x=0)
        if verdict.onset_s is not None:
            axes.axvline(verdict.onset_s, color=ONSET, linestyle="--", linewidth=1)
    rows[-1].set_xlabel("log time [s]")
    figure.suptitle(_title(verdict, story.source), fontsize=13, fontweight="bold")
    png = BytesIO()
    figure.savefig(png, format="png", dpi=110)
    write_file(path, png.getvalue())


def _title(v: Verdict, source: str | None) -> str:
    """Return the title: what was found, and the source that the recording names."""
    origin = f" ({source})" if source else ""
    if not v.faults:
        return f"{v.recording}{origin}: fault-free, {v.false_alarms} false alarms"
    found = (
        f"detected after {v.delay_s:g} s, isolated to {{{', '.join(v.isolated)}}}, first {', '.join(v.first)}"
        if v.detected
        else "not detected"
    )
    fault = f"{', '.join(v.faults)} from {v.onset_s:g} s"
    return f"{v.recording}{origin}: {fault}\n{found}; {v.false_alarms} false alarms before"


def _together(story: Story) -> list[list[int]]:
    """The columns of z that tests predict, largest signals first, in panels of those of like size and unit."""
    inputs = story.bundle.manifest.inputs
    predicted = {generator.predicts for generator in story.bundle.manifest.generators}
    columns = [column for column, channel in enumerate(inputs) if channel.signal in predicted]
    middle = np.median(np.abs(np.nan_to_num(story.z)), axis=0)
    panels: list[list[int]] = []
    for column in sorted(columns, key=lambda column: (inputs[column].unit, -middle[column])):
        first = panels[-1][0] if panels else None
        like = first is not None and inputs[first].unit == inputs[column].unit
        if first is None or not like or middle[first] > APART * middle[column]:
            panels.append([])
        panels[-1].append(column)
    return [sorted(panel) for panel in panels]


def _signals(axes: Axes, story: Story, columns: Sequence[int]) -> None:
    """Measured signals, and what the first test that predicts each of them says while it can tell."""
    inputs, generators = story.bundle.manifest.inputs, story.bundle.manifest.generators
    shown = display_of(inputs[columns[0]])
    drawn = shown.scaled(story.z[:, columns])
    drawn = drawn[np.isfinite(drawn)]
    if drawn.size:
        low, high = drawn.min(), drawn.max()
        if low < np.median(drawn) / 2:  # what comes up at the start would flatten all that follows
            low = np.quantile(drawn, 0.1)
        axes.set_ylim(low - 0.25 * (high - low), high + 0.1 * (high - low) + 1e-9)
    else:
        axes.text(0.5, 0.5, "never received", transform=axes.transAxes, ha="center", va="center")
    for number, column in enumerate(columns):
        signal, shade = inputs[column].signal, number % len(MEASURED)
        label, measured = f"{signal} measured", shown.scaled(story.z[:, column])
        axes.plot(story.t_s, measured, color=MEASURED[shade], linewidth=0.8, label=label)
        row = next(k for k, generator in enumerate(generators) if generator.predicts == signal)
        label = f"predicted by {generators[row].test}"
        told = np.where(story.usable[:, row], shown.scaled(story.y_hat[:, row]), np.nan)
        axes.plot(story.t_s, told, color=PREDICTED[shade], linewidth=0.8, label=label)
    axes.set_ylabel(f"[{shown.unit}]")
    axes.legend(loc="lower right", ncols=len(columns), fontsize=8)


def _inputs(axes: Axes, story: Story) -> None:
    """The first signal that the operating mode follows, and another one that no test predicts."""
    manifest = story.bundle.manifest
    predicted = {generator.predicts for generator in manifest.generators}
    names = [channel.signal for channel in manifest.inputs]
    of_modes = [name for mode in manifest.modes.steady for name in mode.where]
    shown = dict.fromkeys([*of_modes, *(name for name in names if name not in predicted)])
    for number, name in enumerate([*shown][:2]):
        column = names.index(name)
        unit = display_of(manifest.inputs[column])
        side = axes if number == 0 else axes.twinx()
        side.plot(story.t_s, unit.scaled(story.z[:, column]), color=INPUTS[number], linewidth=0.9 - 0.2 * number)
        side.set_ylabel(f"{name} [{unit.unit}]", color=INPUTS[number])


def _residuals(axes: Axes, story: Story) -> None:
    """In parts of each test's fault-free spread, cut off at `SPREADS`, a row a test."""
    detectors, modes = story.bundle.manifest.detectors, story.bundle.manifest.modes
    rest = modes.names.index(next(mode.name for mode in modes.steady if not mode.where))
    names = [generator.name for generator in story.bundle.manifest.generators]
    for row in range(len(names)):
        trace = (story.r[:, row] / detectors[row].scale[rest]).clip(-SPREADS, SPREADS) / (2 * SPREADS)
        trace[~story.usable[:, row]] = float("nan")
        axes.plot(story.t_s, trace - row, linewidth=0.6, color="#333333")
        trace[~story.fired[:, row]] = float("nan")
        axes.plot(story.t_s, trace - row, linewidth=0.8, color=ALARM)
    axes.set_yticks([-row for row in range(len(names))], names, fontsize=8)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(0.6 - len(names), 0.6)
    axes.set_ylabel("residuals\n(red: alarm)")


def _sums(axes: Axes, story: Story) -> None:
    for row, generator in enumerate(story.bundle.manifest.generators):
        axes.plot(story.t_s, abs(story.sums[:, row]), linewidth=1, label=generator.name)
    axes.axhline(1.0, color=ALARM, linestyle=":", linewidth=1.2)
    axes.set_ylabel("detector / J")
    axes.set_ylim(0, 2.6)  # sums end at 2 J; the room above is the legend's
    axes.legend(loc="upper left", ncols=10, fontsize=8, handlelength=1)


def told(axes: Axes, story: Story, events: Sequence[Event], where: str) -> None:
    """The diagnosis as told: a bar for each fault while it is an explanation, dark where it is ranked first."""
    faults: dict[str, int] = {}
    for event, following in zip(events, [*events[1:], None], strict=True):
        start = min(story.origin_s + event.t_s, story.end_s)
        stop = min(story.origin_s + following.t_s, story.end_s) if following else story.end_s
        for diagnosis in event.diagnoses:
            for fault in diagnosis.faults or ["unknown"]:
                row = faults.setdefault(fault, len(faults))
                axes.barh(
                    row, stop - start, left=start, color=ALARM, alpha=1.0 if diagnosis.rank == 1 else 0.3, height=0.7
                )
    axes.set_yticks(range(len(faults)), list(faults))
    axes.set_ylim(max(len(faults), 1) - 0.4, -0.6)
    axes.set_ylabel(f"told {where}".strip() + "\n(dark: rank 1)")
    if not faults:
        axes.text(0.5, 0.5, f"no alarm was told {where}".strip(), transform=axes.transAxes, ha="center", va="center")
    ends = [*(min(story.origin_s + event.t_s, story.end_s) for event in events), story.end_s]
    for event, (start, stop) in zip(events, pairwise(ends), strict=True):
        blind = len(event.cannot_tell) / len({generator.test for generator in story.bundle.manifest.generators})
        axes.axvspan(start, stop, color=ONSET, alpha=0.3 * blind, linewidth=0, zorder=0)
    words = "grey: tests that cannot tell, the more the darker"
    axes.text(0.005, 0.04, words, transform=axes.transAxes, ha="left", fontsize=8, color=ONSET)  # bars stand at the end

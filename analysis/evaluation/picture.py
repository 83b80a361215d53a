"""The story of a recording at a glance: pressures, residuals, CUSUM and what was told, over one time axis."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.evaluation.judge import Verdict
from analysis.evaluation.story import Story
from service.core.events import Event
from service.core.modes import PARTIAL

BAR = 1e5  # Pa
MEASURED, PREDICTED, ALARM, ONSET = "#1f4e79", "#e07b00", "#c62828", "#444444"
SPREADS = 12  # where a residual leaves its row of the picture
SHOWN = {"y_p_ap": "after the pump", "y_p_du": "dosing unit", "y_p_tp": "before the pump"}


def draw(story: Story, live: Sequence[Event] | None, verdict: Verdict, path: Path) -> None:
    """Writes the picture as a PNG; `live` are the events of a bus, where those are judged and not the log's own."""
    mpl.use("Agg")
    figure = Figure(figsize=(13, 12), layout="constrained")
    rows = figure.subplots(6, 1, sharex=True, height_ratios=[2, 1.4, 1, 2, 2, 1.3])
    _pressures(rows[0], story, ["y_p_ap", "y_p_du"], verdict)
    _pressures(rows[1], story, ["y_p_tp"], verdict)
    _inputs(rows[2], story)
    _residuals(rows[3], story)
    _sums(rows[4], story)
    _told(rows[5], story, live)
    for axes in rows:
        axes.grid(visible=True, alpha=0.25)
        axes.margins(x=0)
        if verdict.onset_s is not None:
            axes.axvline(verdict.onset_s, color=ONSET, linestyle="--", linewidth=1)
    rows[-1].set_xlabel("log time [s]")
    figure.suptitle(_title(verdict), fontsize=13, fontweight="bold")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _title(v: Verdict) -> str:
    if not v.faults:
        return f"{v.recording} (simulated): fault-free, {v.false_alarms} false alarms"
    found = (
        f"detected after {v.delay_s:g} s, isolated to {{{', '.join(v.isolated)}}}, first {', '.join(v.first)}"
        if v.detected
        else "not detected"
    )
    fault = f"{', '.join(v.faults)} from {v.onset_s:g} s"
    return f"{v.recording} (simulated): {fault}\n{found}; {v.false_alarms} false alarms before"


def _pressures(axes: Axes, story: Story, signals: Sequence[str], verdict: Verdict) -> None:
    """Measured pressures, and what the first test that predicts each of them says."""
    names = [channel.signal for channel in story.bundle.manifest.inputs]
    shown = story.z[:, [names.index(signal) for signal in signals]] / BAR
    low, high = shown.min(), shown.max()
    if low < np.median(shown) / 2:  # building up pressure at the start would flatten all that follows
        low = np.quantile(shown, 0.1)
    axes.set_ylim(low - 0.25 * (high - low), high + 0.1 * (high - low))
    for number, signal in enumerate(signals):
        measured = story.z[:, names.index(signal)] / BAR
        shade = (MEASURED, "#5b9bd5")[number]
        axes.plot(story.t_s, measured, color=shade, linewidth=0.8, label=f"{signal} measured, {SHOWN[signal]}")
        row = next((k for k, g in enumerate(story.bundle.manifest.generators) if g.predicts == signal), None)
        if row is not None:
            test = story.bundle.manifest.generators[row].test
            shade = (PREDICTED, "#f4b183")[number]
            axes.plot(story.t_s, story.y_hat[:, row] / BAR, color=shade, linewidth=0.8, label=f"predicted by {test}")
    axes.set_ylabel("pressure [bar]")
    if verdict.onset_s is not None and signals[0] == "y_p_ap":
        axes.annotate(
            "fault begins",
            (verdict.onset_s, axes.get_ylim()[0]),
            xytext=(4, 6),
            textcoords="offset points",
            color=ONSET,
        )
    axes.legend(loc="lower right", ncols=2, fontsize=8)


def _inputs(axes: Axes, story: Story) -> None:
    names = [channel.signal for channel in story.bundle.manifest.inputs]
    axes.plot(story.t_s, 100 * story.z[:, names.index("dc_dose")], color="#6a4c93", linewidth=0.9)
    axes.set_ylabel("dose [%]")
    speed = axes.twinx()
    speed.plot(story.t_s, story.z[:, names.index("n_p")], color="#2e7d32", linewidth=0.7)
    speed.set_ylabel("pump [rev/s]", color="#2e7d32")


def _residuals(axes: Axes, story: Story) -> None:
    """In parts of each test's fault-free spread, cut off at `SPREADS`, a row a test."""
    detectors = story.bundle.manifest.detectors
    for row, generator in enumerate(story.bundle.manifest.generators):
        trace = (story.r[:, row] / detectors[row].scale[PARTIAL]).clip(-SPREADS, SPREADS) / (2 * SPREADS)
        trace[~story.usable[:, row]] = float("nan")
        axes.plot(story.t_s, trace - row, linewidth=0.6, color="#333333")
        trace[abs(story.sums[:, row]) < detectors[row].J] = float("nan")
        axes.plot(story.t_s, trace - row, linewidth=0.8, color=ALARM)
        axes.text(story.t_s[0], -row, f"{generator.test} ", ha="right", va="center", fontsize=8)
    axes.set_yticks([])
    axes.set_ylabel("residuals\n(red: alarm)", labelpad=28)


def _sums(axes: Axes, story: Story) -> None:
    for row, generator in enumerate(story.bundle.manifest.generators):
        parts = abs(story.sums[:, row]) / story.bundle.manifest.detectors[row].J
        axes.plot(story.t_s, parts, linewidth=1, label=generator.test)
    axes.axhline(1.0, color=ALARM, linestyle=":", linewidth=1.2)
    axes.set_ylabel("CUSUM / J")
    axes.set_ylim(0, 2.6)  # sums end at 2 J; the room above is the legend's
    axes.legend(loc="upper left", ncols=10, fontsize=8, handlelength=1)


def _told(axes: Axes, story: Story, live: Sequence[Event] | None) -> None:
    """The diagnosis as told: a bar for each fault while it is an explanation, dark where it is ranked first."""
    faults: dict[str, int] = {}
    events = story.events if live is None else live
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
    where = "offline" if live is None else "over the bus"
    axes.set_ylabel(f"told {where}\n(dark: rank 1)")
    if not faults:
        axes.text(0.5, 0.5, f"no alarm was told {where}", transform=axes.transAxes, ha="center", va="center")
    ends = [*(min(story.origin_s + event.t_s, story.end_s) for event in events), story.end_s]
    for event, (start, stop) in zip(events, pairwise(ends), strict=True):
        blind = len(event.cannot_tell) / len(story.bundle.manifest.generators)
        axes.axvspan(start, stop, color=ONSET, alpha=0.3 * blind, linewidth=0, zorder=0)
    words = "grey: tests that cannot tell, the more the darker"
    axes.text(0.995, 0.04, words, transform=axes.transAxes, ha="right", fontsize=8, color=ONSET)

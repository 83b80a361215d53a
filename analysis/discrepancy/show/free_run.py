"""The held-out free run as a picture: measured and predicted, before and after, and what is left of every sensor."""

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from faultline.analysis.calibration.sections import Section
from faultline.analysis.calibration.validate import STEADY
from faultline.analysis.discrepancy.add.held_out import FreeRun, Shown
from faultline.analysis.discrepancy.show.document import Document
from faultline.analysis.discrepancy.show.drawing import (
    AFTER,
    BAND,
    BEFORE,
    INK,
    IS,
    QUIET,
    WAS,
    png,
    simulated,
    with_effects,
)
from faultline.analysis.model import Model

Array = npt.NDArray[np.float64]

SHOWN = 15.0
"""Settling times. More of it is no longer read."""

SMOOTH = 5.0
"""Periods over which residuals are drawn as means: of the valve's pulses no model of mean flows knows."""


def free_run(shown: Shown, document: Document, model: Model) -> bytes:
    """Measured and predicted of the output with the widest gap, and what is left of every output, held out."""
    widest = shown.widest.output
    outputs = [widest, *(name for name in shown.before.agreement if name != widest)]
    rows = [2.6] + [1.3] * len(outputs) + [1.0]
    figure = Figure(figsize=(11, 1.35 * sum(rows)), layout="constrained")
    grid = figure.subplots(len(rows), 1, sharex=True, height_ratios=rows)
    section = shown.after.sections[0]
    shown_s = SHOWN * section.time.settling_s
    begin = section.start_s + min(float(s.t[0]) for s in section.samples.values()) - 5.0
    last = min(_end(shown.after), begin + shown_s)
    _run(grid[0], shown, document, widest, model)
    for axes, name in zip(grid[1:-1], outputs, strict=True):
        _left(axes, shown, document, name, model)
    _inputs(grid[-1], shown.after, document, model)
    for axes in grid:
        axes.set_xlim(begin, last)
        axes.grid(visible=True, alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    note = (
        "left: means of a second; grey: twice the error that the noise of sensors and inputs lets expect, in steady "
        "operation"
    )
    cut = f"; the first {shown_s:.0f} s of {_end(shown.after) - begin:.0f} s" if _end(shown.after) > last else ""
    grid[-1].set_xlabel(f"log time [s]{cut}\n{note}", fontsize=9)
    many = len(document.origin.held_out) > 1
    recording = f"{document.origin.held_out[0]}{', the first held-out recording' if many else ', held out'}"
    figure.suptitle(f"Free run on the inputs alone ({recording}{simulated(document)})", fontweight="bold")
    return png(figure)


def _run(axes: Axes, shown: Shown, document: Document, name: str, model: Model) -> None:
    shown_in = document.units.of(model.known[name].unit, signal=name)
    for k, section in enumerate(_first(shown.after)):
        s = section.samples[name]
        label = None if k else "measured"
        values = shown_in.scaled(s.value + shown.after.zeros[0].get(name, 0.0))
        axes.plot(section.start_s + s.t, values, ".", color=QUIET, markersize=2.5, label=label)
    for found, color, title in _models(shown, document):
        for k, section in enumerate(_first(found)):
            inside = section.t > section.samples[name].t[0]
            y = shown_in.scaled(found.trajectories[k].outputs()[name][inside] + found.zeros[0].get(name, 0.0))
            axes.plot(section.start_s + section.t[inside], y, color=color, linewidth=1.4, label=None if k else title)
    axes.set_ylabel(f"{name} [{shown_in.unit}]")
    axes.legend(loc="upper left", ncols=3, fontsize=9)
    axes.margins(y=0.18)


def _left(axes: Axes, shown: Shown, document: Document, name: str, model: Model) -> None:
    largest = max(float(np.quantile(np.abs(errors[name]), 0.99)) for errors in shown.before.errors)
    unit = document.units.of(model.known[name].unit, largest, name)
    for found, color, _ in _models(shown, document):
        for section, errors in zip(_first(found), found.errors, strict=False):
            t, e = _means(section.samples[name].t / (SMOOTH * section.time.period_s), errors[name] / unit.size)
            axes.plot(section.start_s + t, e, color=color, linewidth=1.1)
    expected = 2.0 * _of_means(shown, name) / unit.size
    if np.isfinite(expected):
        axes.axhspan(-expected, expected, color=BAND, linewidth=0, zorder=0)
    axes.axhline(0.0, color=INK, linewidth=0.6)
    axes.set_ylabel(f"left of\n{name} [{unit.unit}]", fontsize=9)


def _of_means(shown: Shown, name: str) -> float:
    """The error to expect of means: the floor averages, what the inputs' noise does hardly."""
    gaps = {gap.mode: gap for gap in shown.gaps if gap.output == name}
    a = gaps.get(STEADY, next(iter(gaps.values()))).after
    section = shown.after.sections[0]
    count = SMOOTH * section.time.period_s / float(np.median(np.diff(section.samples[name].t)))
    return float(np.sqrt(a.expected**2 - a.floor**2 * (1.0 - 1.0 / max(count, 1.0))))


def _means(t: Array, e: Array) -> tuple[Array, Array]:
    """Means over times `t` (N,) from one whole number to the next, with a gap (NaN) where nothing was compared."""
    cell = np.floor(t).astype(np.int64)
    number, first, count = np.unique(cell, return_index=True, return_counts=True)
    middle, mean = np.add.reduceat(t, first) / count, np.add.reduceat(e, first) / count
    gap = np.flatnonzero(np.diff(number) > 1) + 1
    return np.insert(middle, gap, np.nan), np.insert(mean, gap, np.nan)


def _inputs(axes: Axes, found: FreeRun, document: Document, model: Model) -> None:
    names = [name for name in found.trajectories[0].system.inputs if name in model.known]
    for k, (name, color) in enumerate(zip(names, ("#444444", "#7b3fa0"), strict=False)):
        side, unit = axes if k == 0 else axes.twinx(), document.units.of(model.known[name].unit, signal=name)
        for section in _first(found):
            value = unit.scaled(section.drive.inputs[:, k])
            side.plot(section.start_s + section.t, value, color=color, linewidth=0.9)
        side.set_ylabel(f"{name} [{unit.unit}]", color=color, fontsize=9)


def _models(shown: Shown, document: Document) -> list[tuple[FreeRun, str, str]]:
    if shown.after is shown.before:
        return [(shown.after, AFTER, IS)]
    return [(shown.before, BEFORE, WAS), (shown.after, AFTER, with_effects(document))]


def _first(found: FreeRun) -> list[Section]:
    """The sections of the first recording."""
    ends = [k for k, section in enumerate(found.sections) if k and section.number == 0]
    return list(found.sections[: ends[0] if ends else None])


def _end(found: FreeRun) -> float:
    last = _first(found)[-1]
    return float(last.start_s + last.t[-1])

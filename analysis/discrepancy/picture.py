"""What a discovery shows in a review: the held-out gap, the error by regime, the unknown input, the evidence.

Each is a PNG; the same discovery gives the same bytes. `page` puts them into one file.
"""

import io
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import StrMethodFormatter

from analysis.calibration.sections import Section
from analysis.calibration.validate import STEADY
from analysis.discrepancy.abscissa import Abscissa
from analysis.discrepancy.document import Course, Document, Regime
from analysis.discrepancy.operating_space import UNITS
from analysis.discrepancy.show import FreeRun, Shown
from analysis.model import Model
from service.core.manifest import MODES

Array = npt.NDArray[np.float64]

# Okabe and Ito, Color universal design (2008): told apart with every kind of colour blindness.
BEFORE, AFTER, ALSO, INK, QUIET, BAND = "#D55E00", "#0072B2", "#56B4E9", "#222222", "#9a9a9a", "#e4e4e4"

SHOWN_S = 300.0
"""Of the free run: more is no longer read."""

SMOOTH_S = 1.0
"""Over which residuals are drawn as means: of the valve's pulses no model of mean flows knows."""

MANY = 16
"""Entries with bars."""

IS, WAS = "model as it is", "model as it was"

SMALL_PA = 4e3
"""Pressures that keep within this are drawn in mbar."""


def free_run(shown: Shown, document: Document, model: Model) -> bytes:
    """Measured and predicted of the output with the widest gap, and what is left of every output, held out."""
    widest = shown.widest.output
    outputs = [widest, *(name for name in shown.before.agreement if name != widest)]
    rows = [2.6] + [1.3] * len(outputs) + [1.0]
    figure = Figure(figsize=(11, 1.35 * sum(rows)), layout="constrained")
    grid = figure.subplots(len(rows), 1, sharex=True, height_ratios=rows)
    section = shown.after.sections[0]
    begin = section.start_s + min(float(s.t[0]) for s in section.samples.values()) - 5.0
    _run(grid[0], shown, document, widest, model)
    for axes, name in zip(grid[1:-1], outputs, strict=True):
        _left(axes, shown, document, name, model)
    _inputs(grid[-1], shown.after, model)
    for axes in grid:
        axes.set_xlim(begin, min(_end(shown.after), begin + SHOWN_S))
        axes.grid(visible=True, alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    note = (
        "means of a second; grey: twice the error that the noise of sensors and inputs lets expect, in steady operation"
    )
    grid[-2].annotate(note, (0.995, 0.04), xycoords="axes fraction", ha="right", fontsize=8, color=INK)
    grid[-1].set_xlabel("log time [s]")
    many = len(document.origin.held_out) > 1
    recording = f"{document.origin.held_out[0]}{', the first held-out recording' if many else ', held out'}"
    figure.suptitle(f"Free run on the inputs alone ({recording}{_simulated(document)})", fontweight="bold")
    return _png(figure)


def _run(axes: Axes, shown: Shown, document: Document, name: str, model: Model) -> None:
    one, unit = _unit(model.known[name].unit, np.inf)
    for k, section in enumerate(_first(shown.after)):
        s = section.samples[name]
        label = None if k else "measured"
        told = (s.value + shown.after.zeros[0].get(name, 0.0)) / one
        axes.plot(section.start_s + s.t, told, ".", color=QUIET, markersize=2.5, label=label)
    for found, color, title in _models(shown, document):
        for k, section in enumerate(_first(found)):
            inside = section.t > section.samples[name].t[0]
            y = (found.trajectories[k].outputs()[name][inside] + found.zeros[0].get(name, 0.0)) / one
            axes.plot(section.start_s + section.t[inside], y, color=color, linewidth=1.4, label=None if k else title)
    axes.set_ylabel(f"{name} [{unit}]")
    axes.legend(loc="upper left", ncols=3, fontsize=9)
    axes.margins(y=0.18)


def _left(axes: Axes, shown: Shown, document: Document, name: str, model: Model) -> None:
    largest = max(float(np.quantile(np.abs(errors[name]), 0.99)) for errors in shown.before.errors)
    one, unit = _unit(model.known[name].unit, largest)
    for found, color, _ in _models(shown, document):
        for section, errors in zip(_first(found), found.errors, strict=False):
            t, e = _means(section.samples[name].t, errors[name] / one)
            axes.plot(section.start_s + t, e, color=color, linewidth=1.1)
    expected = 2.0 * _of_means(shown, name) / one
    if np.isfinite(expected):
        axes.axhspan(-expected, expected, color=BAND, linewidth=0, zorder=0)
    axes.axhline(0.0, color=INK, linewidth=0.6)
    axes.set_ylabel(f"left of\n{name} [{unit}]", fontsize=9)


def _of_means(shown: Shown, name: str) -> float:
    """The error to expect of means: the floor averages, what the inputs' noise does hardly."""
    gaps = {gap.mode: gap for gap in shown.gaps if gap.output == name}
    a = gaps.get(STEADY, next(iter(gaps.values()))).after
    count = SMOOTH_S / float(np.median(np.diff(shown.after.sections[0].samples[name].t)))
    return float(np.sqrt(a.expected**2 - a.floor**2 * (1.0 - 1.0 / max(count, 1.0))))


def _means(t: Array, e: Array) -> tuple[Array, Array]:
    """Means over `SMOOTH_S`, with a gap (NaN) where nothing was compared."""
    cell = np.floor(t / SMOOTH_S).astype(np.int64)
    number, first, count = np.unique(cell, return_index=True, return_counts=True)
    middle, mean = np.add.reduceat(t, first) / count, np.add.reduceat(e, first) / count
    gap = np.flatnonzero(np.diff(number) > 1) + 1
    return np.insert(middle, gap, np.nan), np.insert(mean, gap, np.nan)


def _inputs(axes: Axes, found: FreeRun, model: Model) -> None:
    names = [name for name in found.trajectories[0].system.inputs if name in model.known]
    for k, (name, color) in enumerate(zip(names, ("#444444", "#7b3fa0"), strict=False)):
        side = axes if k == 0 else axes.twinx()
        for section in _first(found):
            side.plot(section.start_s + section.t, section.drive.inputs[:, k], color=color, linewidth=0.9)
        side.set_ylabel(f"{name} [{model.known[name].unit}]", color=color, fontsize=9)


def regimes(document: Document) -> bytes:
    """The free run's RMS error in every operating mode, before and after, with the floor, by output."""
    outputs = list(dict.fromkeys(regime.output for regime in document.regimes))
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    grid = figure.subplots(1, len(outputs), squeeze=False)[0]
    for axes, name in zip(grid, outputs, strict=True):
        _bars(axes, [regime for regime in document.regimes if regime.output == name], document)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    figure.suptitle(f"Held-out free run, RMS error by operating mode{_simulated(document)}", fontweight="bold")
    return _png(figure)


def _bars(axes: Axes, of: Sequence[Regime], document: Document) -> None:
    changed = bool(document.strengths)
    one, unit = _unit(of[0].unit, max(regime.rms_before for regime in of))
    of = sorted(of, key=lambda regime: [*MODES, STEADY].index(regime.mode))
    place, width = np.arange(len(of)), 0.36 if changed else 0.6
    was, now = (np.array([getattr(regime, name) for regime in of]) / one for name in ("rms_before", "rms_after"))
    shift = 0.5 * width if changed else 0.0
    color, label = (BEFORE, WAS) if changed else (AFTER, IS)
    axes.bar(place - shift, was, width, color=color, label=label)
    if changed:
        axes.bar(place + shift, now, width, color=AFTER, label=_with(document))
    for k, (name, style, label) in enumerate(
        (("floor", "-", "noise floor of the sensor"), ("expected", ":", "with the inputs' noise"))
    ):
        level = np.array([np.nan if (v := getattr(regime, name)) is None else v / one for regime in of])
        axes.hlines(level, place - 0.45, place + 0.45, color=INK, linestyle=style, linewidth=1.6 - 0.3 * k, label=label)
    axes.set_xticks(place, [f"{regime.mode}\n{regime.samples}" for regime in of], fontsize=8)
    axes.set_title(f"{of[0].output} [{unit}], and samples", fontsize=10)
    axes.grid(visible=True, axis="y", alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def unknown_input(document: Document, abscissa: Abscissa | None) -> bytes | None:
    """What the worst equation misses, over time and over what it depends on; None if nothing is missing."""
    before, after = document.located.course, document.left.course
    if before is None or after is None or not document.located.equations:
        return None
    changed = bool(document.strengths)
    courses = ((before, BEFORE, WAS), *(((after, AFTER, _with(document)),) if changed else ()))
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    for course, color, title in courses:
        scale, unit = _amount(course)
        t, value, sd = (np.array(part) for part in (course.t_s, course.value, course.sd))
        t, value, sd = _broken(t, scale * value, 2.0 * scale * sd)
        left.fill_between(t, value - sd, value + sd, color=color, alpha=0.2, linewidth=0)
        left.plot(t, value, color=color, linewidth=1.2, label=title)
        left.set_ylabel(f"what {course.equation} misses [{unit}]")
        if abscissa is not None and len(abscissa.value) == len(course.value):
            value, sd = scale * np.array(course.value), 2.0 * scale * np.array(course.sd)
            right.errorbar(
                abscissa.value, value, sd, fmt="o", color=color, markersize=3.5, elinewidth=0.8, alpha=0.6, label=title
            )
    left.set_xlabel("log time of the training recordings [s]")
    right.set_xlabel(abscissa.words if abscissa else "")
    for axes in (left, right):
        axes.axhline(0.0, color=INK, linewidth=0.7)
        axes.grid(visible=True, alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    left.legend(loc="best", fontsize=9)
    right.set_visible(abscissa is not None)
    figure.suptitle(f"The unknown input of {before.equation}, with 2 standard deviations", fontweight="bold")
    return _png(figure)


def evidence(document: Document) -> bytes | None:
    """What every entry that was fitted brings, the verdict's in colour; None if none was."""
    fitted = [entry for entry in document.entries if entry.gain is not None]
    if not fitted:
        return None
    shown, v = fitted[:MANY], document.verdict
    figure = Figure(figsize=(11, 1.5 + 0.3 * len(shown)), layout="constrained")
    axes = figure.subplots()
    chosen = {c.name: k for k, place in enumerate(v.places) for c in place.candidates} if v.kind != "unnamed" else {}
    for row, entry in enumerate(shown):
        gain, place = entry.gain or 0.0, chosen.get(entry.name, -1)
        axes.barh(row, gain, color=(AFTER, ALSO)[min(place, 1)] if place >= 0 else QUIET, height=0.7)
        besides = f", {v.places[place].gain:.0f} beside the other" if place > 0 else ""
        axes.annotate(f" {gain:.0f}{besides}", (max(gain, 0.0), row), va="center", fontsize=8.5, color=INK)
    axes.set_yticks(range(len(shown)), [entry.name for entry in shown], fontsize=9)
    for label, entry in zip(axes.get_yticklabels(), shown, strict=True):
        label.set_fontweight("bold" if entry.name in chosen else "normal")
    axes.invert_yaxis()
    axes.axvline(v.threshold, color=INK, linestyle="--", linewidth=1.2)
    axes.annotate(
        "chance", (v.threshold, 0.0), xycoords=("data", "axes fraction"), xytext=(3, 3), textcoords="offset points",
        fontsize=8, color=INK,
    )  # fmt: skip
    if max(entry.gain or 0.0 for entry in shown) > 30.0 * v.threshold:
        axes.set_xscale("symlog", linthresh=4.0 * v.threshold)
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.margins(x=0.08)
    rest = sum(entry.gain is None and entry.no_place is None for entry in document.entries)
    more = f"; {rest} more did less in their first steps" if rest else ""
    axes.set_xlabel(f"evidence against the model as it was [nats], alone in the model{more}")
    axes.grid(visible=True, axis="x", alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    coloured = " (blue: the verdict)" if chosen else " (what they leave is not noise: none is its name)"
    coloured = coloured if v.kind != "nothing missing" else ""
    figure.suptitle(f"Evidence for the entries of the library{coloured}", fontweight="bold")
    return _png(figure)


def _models(shown: Shown, document: Document) -> list[tuple[FreeRun, str, str]]:
    if shown.after is shown.before:
        return [(shown.after, AFTER, IS)]
    return [(shown.before, BEFORE, WAS), (shown.after, AFTER, _with(document))]


def _with(document: Document) -> str:
    return "with the nearest effects" if document.verdict.kind == "unnamed" else "with the effect"


def _first(found: FreeRun) -> list[Section]:
    """The sections of the first recording."""
    ends = [k for k, section in enumerate(found.sections) if k and section.number == 0]
    return list(found.sections[: ends[0] if ends else None])


def _end(found: FreeRun) -> float:
    last = _first(found)[-1]
    return float(last.start_s + last.t[-1])


def _amount(course: Course) -> tuple[float, str]:
    """Factor and unit in which an unknown input is drawn: a part of what it adds to, where that has a size."""
    if course.variable and course.size > 0.0:
        return 100.0 / course.size, f"% of {course.variable}"
    return UNITS.get(course.unit, (1.0, course.unit))


def _broken(t: Array, *values: Array) -> tuple[Array, ...]:
    """With a gap where time goes back: another recording begins."""
    back = np.flatnonzero(np.diff(t) <= 0.0) + 1
    return tuple(np.insert(part, back, np.nan) for part in (t, *values))


def _unit(unit: str, size: float) -> tuple[float, str]:
    """How much one of the drawn unit is, and its name, for values up to `size`."""
    if unit == "Pa":
        return (1e2, "mbar") if size < SMALL_PA else (1e5, "bar")
    return 1.0, unit


def _simulated(document: Document) -> str:
    return "; simulated data" if document.simulated else ""


def _png(figure: Figure) -> bytes:
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    return buffer.getvalue()


def pictures(document: Document, shown: Shown, model: Model, abscissa: Abscissa | None) -> Mapping[str, bytes]:
    """All that there are, by name."""
    found = {
        "free-run": free_run(shown, document, model),
        "regimes": regimes(document),
        "unknown-input": unknown_input(document, abscissa),
        "evidence": evidence(document),
    }
    return {name: png for name, png in found.items() if png is not None}

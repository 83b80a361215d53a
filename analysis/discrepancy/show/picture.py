"""What a discovery shows in a review: the held-out gap, the error by regime, the unknown input, the evidence.

Each is a PNG; the same discovery gives the same bytes. `page` puts them into one file.
"""

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import StrMethodFormatter

from faultline.analysis.discrepancy.add.held_out import Shown
from faultline.analysis.discrepancy.show.abscissa import Abscissa
from faultline.analysis.discrepancy.show.document import Course, Document, Regime
from faultline.analysis.discrepancy.show.drawing import (
    AFTER,
    ALSO,
    BEFORE,
    INK,
    IS,
    QUIET,
    WAS,
    png,
    simulated,
    with_effects,
)
from faultline.analysis.discrepancy.show.free_run import free_run
from faultline.analysis.model import Model

Array = npt.NDArray[np.float64]

TOLD = 2.0
"""Times the usual standard deviation, above which a cell's unknown input is not drawn over what it depends on."""

MANY = 16
"""Entries with bars."""


def regimes(document: Document) -> bytes:
    """The free run's RMS error in every operating mode, before and after, with the floor, by output."""
    outputs = list(dict.fromkeys(regime.output for regime in document.regimes))
    figure = Figure(figsize=(11, 3.4), layout="constrained")
    grid = figure.subplots(1, len(outputs), squeeze=False)[0]
    for axes, name in zip(grid, outputs, strict=True):
        _bars(axes, [regime for regime in document.regimes if regime.output == name], document)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    figure.suptitle(f"Held-out free run, RMS error by operating mode{simulated(document)}", fontweight="bold")
    return png(figure)


def _bars(axes: Axes, of: Sequence[Regime], document: Document) -> None:
    changed = bool(document.strengths)
    shown = document.units.of(of[0].unit, max(regime.rms_before for regime in of), of[0].output)
    place, width = np.arange(len(of)), 0.36 if changed else 0.6
    was, now = (np.array([getattr(regime, name) for regime in of]) / shown.size for name in ("rms_before", "rms_after"))
    shift = 0.5 * width if changed else 0.0
    color, label = (BEFORE, WAS) if changed else (AFTER, IS)
    axes.bar(place - shift, was, width, color=color, label=label)
    if changed:
        axes.bar(place + shift, now, width, color=AFTER, label=with_effects(document))
    for k, (name, style, label) in enumerate(
        (("floor", "-", "noise floor of the sensor"), ("expected", ":", "with the inputs' noise"))
    ):
        level = np.array([np.nan if (v := getattr(regime, name)) is None else v / shown.size for regime in of])
        axes.hlines(level, place - 0.45, place + 0.45, color=INK, linestyle=style, linewidth=1.6 - 0.3 * k, label=label)
    axes.set_xticks(place, [f"{regime.mode}\n{regime.samples}" for regime in of], fontsize=8)
    axes.set_title(f"{of[0].output} [{shown.unit}], and samples", fontsize=10)
    axes.grid(visible=True, axis="y", alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def unknown_input(document: Document, abscissa: Abscissa | None) -> bytes | None:
    """What the worst equation misses, over time and over what it depends on; None if nothing is missing."""
    before, after = document.located.course, document.left.course
    if before is None or after is None or not document.located.equations:
        return None
    changed = bool(document.strengths)
    courses = ((before, BEFORE, WAS), *(((after, AFTER, with_effects(document)),) if changed else ()))
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
    for course, color, title in courses:
        scale, unit = _amount(document, course)
        t, value, sd = (np.array(part) for part in (course.t_s, course.value, course.sd))
        t, value, sd = _broken(t, scale * value, 2.0 * scale * sd)
        left.fill_between(t, value - sd, value + sd, color=color, alpha=0.2, linewidth=0)
        left.plot(t, value, color=color, linewidth=1.2, label=title)
        left.set_ylabel(f"what {course.equation} misses [{unit}]")
        if abscissa is not None and len(abscissa.value) == len(course.value):
            _over(right, abscissa.value, course, np.array(before.sd), color, scale)
    left.set_xlabel("log time of the training recordings [s]")
    if abscissa is not None:
        right.set_xlabel(textwrap.fill(abscissa.words, 48))
    for axes in (left, right):
        axes.axhline(0.0, color=INK, linewidth=0.7)
        axes.grid(visible=True, alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    left.legend(loc="best", fontsize=9)
    right.set_visible(abscissa is not None)
    figure.suptitle(f"The unknown input of {before.equation}, with 2 standard deviations", fontweight="bold")
    return png(figure)


def _over(axes: Axes, x: Array, course: Course, usual: Array, color: str, scale: float) -> None:
    """The cells that the data tell of, by their `usual` standard deviations: not those of the model's warm-up."""
    certain = usual <= TOLD * np.median(usual)
    y, sd = scale * np.array(course.value)[certain], 2.0 * scale * np.array(course.sd)[certain]
    axes.errorbar(x[certain], y, sd, fmt="o", color=color, markersize=3.5, elinewidth=0.8, alpha=0.6)


def evidence(document: Document) -> bytes | None:
    """What every entry that was fitted brings, the verdict's in colour; None if none was."""
    fitted = [entry for entry in document.entries if entry.gain is not None]
    if not fitted:
        return None
    v = document.verdict
    chosen = {c.name: k for k, place in enumerate(v.places) for c in place.candidates} if v.kind != "unnamed" else {}
    later = [entry for entry in document.entries if entry.gain is None and entry.name in chosen]
    shown = [*fitted[:MANY], *later]
    figure = Figure(figsize=(11, 1.5 + 0.3 * len(shown)), layout="constrained")
    axes = figure.subplots()
    others = "the others" if len(v.places) > 2 else "the other"
    for row, entry in enumerate(shown):
        place = chosen.get(entry.name, -1)
        beside = f"{v.places[place].gain:.0f} beside {others}" if place > 0 else ""
        gain = v.places[place].gain if entry.gain is None else entry.gain
        alone = "" if entry.gain is None else f"{gain:z.0f}"
        axes.barh(row, gain, color=(AFTER, ALSO)[min(place, 1)] if place >= 0 else QUIET, height=0.7)
        axes.annotate(
            f" {', '.join(filter(None, (alone, beside)))}", (max(gain, 0.0), row), va="center", fontsize=8.5, color=INK
        )
    axes.set_yticks(range(len(shown)), [entry.name for entry in shown], fontsize=9)
    for label, entry in zip(axes.get_yticklabels(), shown, strict=True):
        label.set_fontweight("bold" if entry.name in chosen else "normal")
    axes.invert_yaxis()
    axes.axvline(v.threshold, color=INK, linestyle="--", linewidth=1.2)
    axes.annotate(
        "asked for", (v.threshold, 0.0), xycoords=("data", "axes fraction"), xytext=(3, 3), textcoords="offset points",
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
    return png(figure)


def _amount(document: Document, course: Course) -> tuple[float, str]:
    """Factor and unit in which an unknown input is drawn: a part of what it adds to, where that has a size."""
    if course.variable and course.size > 0.0:
        return 100.0 / course.size, f"% of the RMS {course.variable}"
    shown = document.units.of(course.unit)
    return 1.0 / shown.size, shown.unit


def _broken(t: Array, *values: Array) -> tuple[Array, ...]:
    """With a gap where time goes back: another recording begins."""
    back = np.flatnonzero(np.diff(t) <= 0.0) + 1
    return tuple(np.insert(part, back, np.nan) for part in (t, *values))


def pictures(document: Document, shown: Shown, model: Model, abscissa: Abscissa | None) -> Mapping[str, bytes]:
    """All that there are, by name."""
    found = {
        "free-run": free_run(shown, document, model),
        "regimes": regimes(document),
        "unknown-input": unknown_input(document, abscissa),
        "evidence": evidence(document),
    }
    return {name: picture for name, picture in found.items() if picture is not None}

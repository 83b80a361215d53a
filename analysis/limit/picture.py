"""The picture of the limits: the smallest size of each fault that could be found within a time."""

from io import BytesIO
from math import ceil, inf
from pathlib import Path

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from faultline.analysis.limit.limits import Limits, Smallest
from faultline.analysis.limit.table import Units
from faultline.service.core.manifest import Evidence
from faultline.writing import write_file

COLUMNS = 4
COLOURS = ("#1f4e79", "#e07b00", "#2e7d32")


def draw(found: Limits, evidence: Evidence, path: Path) -> None:
    """Write a panel for each fault as a PNG: size over time, both logarithmic; median, and 0.1 to 0.9 of the onsets."""
    mpl.use("Agg")
    units, faults = Units(evidence), list(dict.fromkeys(each.fault for each in found.smallest))
    rows = ceil(len(faults) / COLUMNS)
    figure = Figure(figsize=(3.6 * COLUMNS, 2.9 * rows), layout="constrained")
    panels = figure.subplots(rows, COLUMNS, sharex=True, squeeze=False).ravel()
    for axes, fault in zip(panels, faults, strict=False):
        for each, colour in zip(_forms(found, fault), COLOURS, strict=False):
            _line(axes, found.times_s, each, units, colour)
        axes.set(xscale="log", yscale="log", title=fault, xticks=found.times_s)
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(_plain)
        axes.yaxis.set_minor_formatter(_plain if min(axes.get_ylim()) * 2.0 > max(axes.get_ylim()) else NullFormatter())
        axes.grid(visible=True, which="both", alpha=0.2)
        forms = _forms(found, fault)
        if len(forms) > 1:
            axes.legend(fontsize="x-small")
        else:
            axes.set_ylabel(units.named(fault, forms[0].share_of), fontsize="small")
    for axes in panels[len(faults) :]:
        axes.set_axis_off()
    for axes in panels[max(len(faults) - COLUMNS, 0) : len(faults)]:
        axes.set_xlabel("found within [s]")
        axes.tick_params(labelbottom=True)
    title = f"smallest size that any detector could find: one alarm in {found.every_h:g} h without a fault"
    figure.suptitle(f"{title}; {', '.join(found.drives)}")
    png = BytesIO()
    figure.savefig(png, format="png", dpi=110)
    write_file(path, png.getvalue())


def _forms(found: Limits, fault: str) -> list[Smallest]:
    """The forms of a fault; of both signs, which mirror each other, one."""
    forms = {each.share_of: each for each in found.smallest if each.fault == fault}
    return [*forms.values()]


def _plain(value: float, _position: int) -> str:
    return f"{value:g}"


def _line(axes: Axes, times_s: list[float], each: Smallest, units: Units, colour: str) -> None:
    low, middle, high = (
        [inf if of is None else units.read(each.fault, each.share_of, abs(of)) for of in column]
        for column in zip(*each.size, strict=True)
    )
    axes.plot(times_s, middle, color=colour, marker="o", markersize=3, label=units.named(each.fault, each.share_of))
    known = [k for k, value in enumerate(high) if value < inf]
    at, best, worst = ([column[k] for k in known] for column in (times_s, low, high))
    axes.fill_between(at, best, worst, color=colour, alpha=0.2)

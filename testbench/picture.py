"""The picture of a recording, as thesis fig. 5.8: pressures, pump speed and dose over time, with the faults shaded."""

from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from faultline.testbench.errors import RigError
from faultline.testbench.faults import Fault
from faultline.testbench.recorded import Recorded, read_toml
from faultline.testbench.units import BAR
from faultline.writing import write_file

PANELS = (
    (("y_p_tp",), "bar", 1 / BAR),
    (("y_p_ap", "y_p_du"), "bar", 1 / BAR),
    (("n_p",), "rev/s", 1.0),
    (("dc_dose",), "%", 100.0),
)
"""What is drawn together, from top to bottom: signals, their unit, and how many of it one is."""
COLOURS = {"y_p_tp": "#2e7d32", "y_p_ap": "#e07b00", "y_p_du": "#1f4e79", "n_p": "#6a4c93", "dc_dose": "#444444"}
FAULT = "#c62828"
GRID_S = 0.1  # of the shading


def draw(recorded: Recorded, truth: Path | None, path: Path) -> None:
    """Writes the picture as a PNG; `truth` is the recording's truth file.

    Raises:
        RigError: the truth is about another recording, or a file cannot be read.
    """
    mpl.use("Agg")
    about = _about(truth, recorded.id) if truth else {}
    given = [{key: value for key, value in fault.items() if key != "unit"} for fault in about.get("fault", ())]
    faults = [Fault(**fault) for fault in given]
    figure = Figure(figsize=(11, 8), layout="constrained")
    rows = figure.subplots(len(PANELS), 1, sharex=True, height_ratios=(1.2, 2, 1.2, 1))
    for axes, (signals, unit, scale) in zip(rows, PANELS, strict=True):
        _signals(axes, recorded, signals, scale)
        axes.set_ylabel(f"{', '.join(signals)} [{unit}]")
        axes.grid(visible=True, alpha=0.25)
        axes.set_xmargin(0.01)
        clock = about.get("logger") if all(signal in recorded.external for signal in signals) else None
        _shade(axes, faults, recorded, clock)
    rows[-1].set_xlabel(_time(recorded))
    told = ", ".join(f"{f.name} {f.size:g} from {f.onset_s:g} s ({f.profile})" for f in faults) or "no fault"
    figure.suptitle(f"{recorded.id} (simulated)" + (f"\n{told}" if truth else ""))
    png = BytesIO()
    figure.savefig(png, dpi=110, format="png")
    write_file(path, png.getvalue())


def _about(path: Path, recording: str) -> dict[str, Any]:
    about = read_toml(path)
    if about.get("recording") != recording:
        raise RigError(f"{path}: is about {about.get('recording')!r}, not about {recording!r}; give its own truth")
    return about


def _signals(axes: Axes, recorded: Recorded, signals: tuple[str, ...], scale: float) -> None:
    for signal in signals:
        track = recorded.external.get(signal) or recorded.bus.get(signal)
        if track is None:
            continue
        where = ", second logger" if signal in recorded.external else ""
        style = "steps-post" if signal == "dc_dose" else "default"
        axes.plot(
            track.t,
            scale * track.value,
            color=COLOURS[signal],
            linewidth=0.7,
            drawstyle=style,
            label=f"{signal}{where}",
        )
    if axes.lines:
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=2, fontsize="small", frameon=False)


def _time(recorded: Recorded) -> str:
    if not recorded.external:
        return "time after the first CAN frame [s]"
    theirs = ", ".join(recorded.external)
    return f"time [s]: {theirs} on the second logger's own clock, the others after the first CAN frame"


def _shade(axes: Axes, faults: list[Fault], recorded: Recorded, clock: dict[str, float] | None) -> None:
    """Shades when faults are there: in CAN time, or on the second logger's clock where that is given."""
    end = max(track.t[-1] for track in recorded.bus.values())
    t = np.arange(0.0, end, GRID_S)
    there = np.array([any(fault.strength(time) for fault in faults) for time in t.tolist()])
    if clock:
        t = (t - clock["offset_s"]) / (1.0 + clock["drift"])
    axes.fill_between(t, 0, 1, where=there, transform=axes.get_xaxis_transform(), color=FAULT, alpha=0.1, linewidth=0)

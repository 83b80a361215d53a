"""The synchronisation at a glance: both pressures before and after, the windows' offsets, the correlation."""

import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from faultline.analysis.model.bench import BenchSetup
from faultline.analysis.recordings.band import gridded
from faultline.analysis.recordings.clock import Clock
from faultline.analysis.recordings.track import Track

REFERENCE, FOLLOWER, LINE, QUIET = "#1f4e79", "#e07b00", "#c62828", "#8a8a8a"
SECTION_S = 40.0
NEAR_S = 15.0  # around the peak of the correlation


def picture(follower: Track, reference: Track, clock: Clock, setup: BenchSetup, name: str) -> bytes:
    """A PNG; the same input gives the same bytes. `follower` is on the logger's clock."""
    figure = Figure(figsize=(12, 7.5), layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.subplots(2, 2)
    aligned = follower._replace(t=clock.can_time(follower.t))
    begin = _telling(aligned, reference)
    rows[0, 0].set_title("before: the second logger's time as if it were CAN time")
    rows[0, 1].set_title("after: aligned")
    _overlay(rows[0, 0], follower, reference, begin, setup)
    _overlay(rows[0, 1], aligned, reference, begin, setup)
    _offsets(rows[1, 0], clock)
    _correlation(rows[1, 1], clock)
    for axes in rows.flat:
        axes.grid(visible=True, alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    error = "given by hand" if clock.error_s is None else f"standard error {1e3 * clock.error_s:.0f} ms"
    figure.suptitle(
        f"{name}: offset {clock.offset_s:+.3f} s, drift {clock.drift * 1e6:+.1f} ppm ({error})", fontweight="bold"
    )
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100, metadata={"Software": None})
    return buffer.getvalue()


def _telling(aligned: Track, reference: Track) -> float:
    """When the section begins [s] in which the reference, known to both, moves most."""
    grid = gridded(reference, 0.2).fast(1.0)
    moves = np.abs(grid.value) * aligned.known(grid.t)
    width = min(round(SECTION_S / 0.2), len(moves))
    sums = np.convolve(moves, np.ones(width), mode="valid")
    return float(grid.t[int(np.argmax(sums))])


def _overlay(axes: Axes, follower: Track, reference: Track, begin: float, setup: BenchSetup) -> None:
    for track, color, label in (
        (reference, REFERENCE, f"{setup.reference} (CAN)"),
        (follower, FOLLOWER, f"{setup.follower} (second logger)"),
    ):
        inside = (track.t >= begin) & (track.t <= begin + SECTION_S)
        axes.plot([], [], ".-", color=color, label=label)
        for piece in Track(track.t[inside], track.value[inside]).pieces() if inside.any() else []:
            axes.plot(piece.t, piece.value / 1e5, ".-", color=color, markersize=3, linewidth=1)
    axes.set(xlabel="CAN time [s]", ylabel="pressure [bar]", xlim=(begin, begin + SECTION_S))
    if not (follower.known(np.array([begin, begin + SECTION_S]))).any():
        axes.annotate(
            "the second logger has nothing here", (0.5, 0.06), xycoords="axes fraction", ha="center", color=FOLLOWER
        )
    axes.legend(loc="best", frameon=False)


def _offsets(axes: Axes, clock: Clock) -> None:
    axes.set(title="offset in windows of 40 s, and the line through them", xlabel="CAN time [s]")
    if not clock.windows:
        axes.annotate("the clock was given", (0.5, 0.5), xycoords="axes fraction", ha="center", color=QUIET)
        return
    t, offset, sd = (np.array(column) for column in zip(*clock.windows, strict=True))
    slope = 1.0 - 1.0 / (1.0 + clock.drift)
    ends = np.array([t[0] - 20.0, t[-1] + 20.0])
    level = clock.offset_s * (1.0 - slope)
    middle = float(level + slope * t.mean())
    axes.errorbar(t, 1e3 * (offset - middle), 1e3 * sd, fmt="o", color=REFERENCE, markersize=4, linewidth=1)
    axes.plot(ends, 1e3 * (level + slope * ends - middle), color=LINE, linewidth=1.5)
    if clock.straying:
        stray = np.array([(o.t, 1e3 * (o.offset - middle)) for o in clock.straying]).T
        axes.plot(*stray, "x", color=QUIET, markersize=5, label="disagree")
        axes.legend(loc="best", frameon=False)
    axes.set_ylabel(f"offset less {middle:.3f} s [ms]")


def _correlation(axes: Axes, clock: Clock) -> None:
    axes.set(title="correlation of the high-passed pressures over the lag", xlabel="CAN time less logger time [s]")
    if clock.likeness is None:
        axes.annotate("the clock was given", (0.5, 0.5), xycoords="axes fraction", ha="center", color=QUIET)
        return
    lag, r = clock.likeness.lag, clock.likeness.correlation
    known = np.isfinite(r)
    near = int(np.nanargmax(np.where(np.abs(lag - clock.offset_s) < NEAR_S, r, np.nan)))
    axes.plot(lag[known], r[known], color=REFERENCE, linewidth=0.8)
    axes.plot(lag[near], r[near], "o", color=LINE)
    axes.annotate(f"{lag[near]:.1f} s", (lag[near], r[near]), xytext=(8, -4), textcoords="offset points", color=LINE)
    axes.set_ylim(-1.05, 1.15)

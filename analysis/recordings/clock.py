"""Finds the second logger's clock on the CAN clock: the same pressure, seen by two sensors, must rise at the same time.

Thesis 5.8 aligns p_ap (second logger) with p_du (CAN) by cross-correlation, taking the hydraulics as instantaneous next
to the sample time. Here in three steps: the lag of the highest normalised cross-correlation of the high-passed signals;
in windows of 40 s the offset that lets p_ap, together with the dose, explain most of p_du; a robust line through these
offsets, whose slope is the drift. Times are in seconds after the first CAN frame and after the logger's own zero.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares
from scipy.signal import correlate

from service.core.errors import InputError
from service.core.signals import Vector

GRID_S = 0.02  # of the smoothed p_ap
COARSE = 5  # grid points per step of the coarse search: 0.1 s
SMOOTH_S = 0.1  # standard deviation of the kernel over p_ap, one sample of the second logger
SLOW_S = 3.0  # slower changes do not help to find a time
WINDOW_S = 40.0
SEARCH_S = 0.5  # around the coarse lag: its step, and 100 ppm over an hour
FLOOR_S = 0.002  # no window's offset is known better: the frames' jitter is not quite white
SLACK_S = 0.05  # a window that is less certain tells nothing
CLEAR = 8.0  # nor one whose best offset is not so much likelier (log) than half of the others
MINIMUM_CORRELATION = 0.7
MINIMUM_OVERLAP_S = 30.0


class ClockError(InputError):
    """The two logs cannot be aligned."""


class Clock(NamedTuple):
    """CAN time = `offset_s` + (1 + `drift`) * logger time.

    `correlation` is that of the high-passed pressures once aligned, `spread_s` the RMS of the windows' offsets around
    the line, `windows` how many of them had something to tell.
    """

    offset_s: float
    drift: float
    correlation: float
    spread_s: float
    windows: int

    def can_time(self, t: Vector) -> Vector:
        """Logger times [s] on the CAN clock."""
        return self.offset_s + (1.0 + self.drift) * t


class Track(NamedTuple):
    """A signal at times `t` (N,) [s], increasing, with values (N,)."""

    t: Vector
    value: Vector


def synchronise(p_ap: Track, p_du: Track, dose: Vector, where: str) -> Clock:
    """The clock of `p_ap` (logger time) on that of `p_du` and `dose` (CAN time, same samples).

    Raises:
        ClockError: the pressures do not resemble each other enough; the message starts with `where`.
    """
    smooth = _smooth(p_ap)
    lag = _coarse(smooth, p_du, where)
    offsets = _windows(smooth, p_du, dose, lag)
    line, spread = _line(offsets) if len(offsets) else ((lag, 0.0), 0.0)
    drift = 1.0 / (1.0 - line[1]) - 1.0  # the line runs over CAN time
    clock = Clock(line[0] * (1.0 + drift), drift, 0.0, spread, len(offsets))
    correlation = _correlation(Track(clock.can_time(smooth.t), smooth.value), p_du)
    if not correlation >= MINIMUM_CORRELATION:
        raise ClockError(_unlike(where, correlation))
    return clock._replace(correlation=correlation)


def _unlike(where: str, correlation: float) -> str:
    return (
        f"{where}: the second logger's y_p_ap does not follow the CAN log's y_p_du (correlation {correlation:.2f}, "
        f"{MINIMUM_CORRELATION} is needed); check the columns, that both files are of one drive, and that the pump ran"
    )


def _smooth(track: Track) -> Track:
    """On a uniform grid without what is faster than the sampling."""
    t = np.arange(track.t[0], track.t[-1], GRID_S)
    return Track(t, gaussian_filter1d(np.interp(t, *track), SMOOTH_S / GRID_S, mode="nearest"))


def _fast(value: Vector, step_s: float) -> Vector:
    """High-passed, zero-phase."""
    return np.asarray(value - gaussian_filter1d(value, SLOW_S / step_s, mode="nearest"))


def _coarse(smooth: Track, p_du: Track, where: str) -> float:
    """CAN time less logger time [s] at the highest correlation over all lags that leave half of the shorter log."""
    step = GRID_S * COARSE
    grid = np.arange(p_du.t[0], p_du.t[-1], step)
    x, y = _fast(np.interp(grid, *p_du), step), _fast(smooth.value[::COARSE], step)
    least = max(MINIMUM_OVERLAP_S / step, min(len(x), len(y)) / 2)
    if min(len(x), len(y)) < least:
        raise ClockError(f"{where}: the logs are shorter than {MINIMUM_OVERLAP_S:g} s; record for longer")
    overlap = np.round(correlate(np.ones_like(x), np.ones_like(y), method="fft"))
    power = correlate(x**2, np.ones_like(y), method="fft") * correlate(np.ones_like(x), y**2, method="fft")
    product = correlate(x, y, method="fft")
    likeness = np.where(overlap >= least, product / np.sqrt(np.maximum(power, power.max() * 1e-12)), -np.inf)
    return float(grid[0] - smooth.t[0] + (np.argmax(likeness) - (len(y) - 1)) * step)


class _Offset(NamedTuple):
    """What a window tells: its middle `t` (CAN time), the offset there and its standard deviation, all [s]."""

    t: float
    offset: float
    sd: float


def _windows(smooth: Track, p_du: Track, dose: Vector, lag: float) -> list[_Offset]:
    start, end = max(p_du.t[0], smooth.t[0] + lag + SEARCH_S), min(p_du.t[-1], smooth.t[-1] + lag - SEARCH_S)
    edges = np.linspace(start, end, max(1, round((end - start) / WINDOW_S)) + 1)
    shifts = np.arange(-SEARCH_S, SEARCH_S + GRID_S / 2, GRID_S)
    gain = _gain(smooth, p_du, dose, lag)
    found = []
    for low, high in pairwise(edges.tolist()):
        inside = (p_du.t >= low) & (p_du.t < high)
        if inside.sum() < WINDOW_S / 2:
            continue
        t, y, known = p_du.t[inside], p_du.value[inside], dose[inside]
        rest = [_unexplained(y - gain * np.interp(t - lag - shift, *smooth), known) for shift in shifts]
        cost = 0.5 * len(y) * np.log(rest)  # negative log likelihood
        best = int(np.argmin(cost))
        if 0 < best < len(cost) - 1 and np.median(cost) - cost[best] > CLEAR:
            offset, curvature = _vertex(shifts[best - 1 : best + 2], cost[best - 1 : best + 2])
            sd = max(FLOOR_S, 1.0 / np.sqrt(curvature)) if curvature > 0 else np.inf
            if sd < SLACK_S:
                found.append(_Offset(float(t.mean()), lag + offset, float(sd)))
    return found


def _gain(smooth: Track, p_du: Track, dose: Vector, lag: float) -> float:
    """Slope of p_du over p_ap at given dose, over the whole recording.

    In a window it could not be told from a delay: p_ap settles exponentially, and a late exponential is a scaled one.
    """
    A = np.column_stack([np.ones_like(dose), np.interp(p_du.t - lag, *smooth), dose])
    scale = np.maximum(np.sqrt((A**2).mean(axis=0)), 1e-9)
    return float(np.linalg.lstsq(A / scale, p_du.value, rcond=None)[0][1] / scale[1])


def _unexplained(drop: Vector, dose: Vector) -> float:
    """Mean square of the pressure drop (N,) that neither the dose nor a constant explains [Pa^2]."""
    A = np.column_stack([np.ones_like(drop), dose])
    return float(np.mean((drop - A @ np.linalg.lstsq(A, drop, rcond=None)[0]) ** 2)) + 1e-6


def _vertex(x: Vector, y: Vector) -> tuple[float, float]:
    """Place and second derivative of the parabola through three equidistant points."""
    step = x[1] - x[0]
    curvature = (y[0] - 2 * y[1] + y[2]) / step**2
    return float(x[1] - (y[2] - y[0]) / (2 * step) / curvature if curvature > 0 else x[1]), float(curvature)


def _line(offsets: list[_Offset]) -> tuple[tuple[float, float], float]:
    """Offset at CAN time 0 and slope, by a robust fit; and the RMS around it. One window has no slope."""
    t, offset, sd = (np.array(column) for column in zip(*offsets, strict=True))
    middle = float(np.average(t, weights=sd**-2.0))
    free = 2 if len(offsets) > 1 else 1

    def misfit(p: Vector) -> Vector:
        return np.asarray((offset - p[0] - (p[1] * (t - middle) if free == 2 else 0.0)) / sd)

    fit = least_squares(misfit, np.array([np.median(offset), 0.0])[:free], loss="soft_l1", x_scale=[1e-3, 1e-5][:free])
    slope = float(fit.x[1]) if free == 2 else 0.0
    level = float(fit.x[0])
    rest = offset - level - slope * (t - middle)
    return (level - slope * middle, slope), float(np.sqrt(np.mean(rest**2)))


def _correlation(aligned: Track, p_du: Track) -> float:
    """Of the high-passed signals, where both logs run."""
    inside = (p_du.t >= aligned.t[0]) & (p_du.t <= aligned.t[-1])
    grid = np.arange(p_du.t[inside][0], p_du.t[inside][-1], GRID_S * COARSE)
    x, y = (_fast(np.interp(grid, *track), GRID_S * COARSE) for track in (aligned, p_du))
    power = np.mean(x**2) * np.mean(y**2)
    return float(np.mean(x * y) / np.sqrt(power)) if power > 0 else 0.0

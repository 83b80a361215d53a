"""The line through the windows' offsets: two clocks that run at constant speeds differ by one."""

from typing import NamedTuple

import numpy as np

from faultline.analysis.recordings.windows import Window
from faultline.service.core.signals.values import FloatArray

STRAY = 12.0  # log likelihood: further from its best a window says no more than that it disagrees
CLEAR = 6.0  # log likelihood: a window whose best is not this far above its median tells nothing
NEAR_S = 0.1  # of the line: a window whose own best is further away disagrees
FLOOR_S = 0.008  # no window's offset is known better: valve and jitter are not quite white
DRIFT_SD = 150e-6  # of two ordinary quartzes
MOST_DRIFT = 400e-6


class Offset(NamedTuple):
    """What a window tells: its middle `t` [s, CAN time], the offset there and its standard deviation [s]."""

    t: float
    offset: float
    sd: float


class Line(NamedTuple):
    """Offset [s] = `level` + `slope` (t - `middle`) at CAN time t, with the covariance of level and slope.

    `agreeing` windows made it, `straying` ones were clear too but say something else (their `sd` is 0); `likelihood` is
    what it has over all windows.
    """

    middle: float
    level: float
    slope: float
    covariance: FloatArray
    agreeing: list[Offset]
    straying: list[Offset]
    likelihood: float

    def at(self, t: float) -> float:
        """The offset [s] at a CAN time [s]."""
        return self.level + self.slope * (t - self.middle)

    def sd(self, t: float) -> float:
        """Standard error of the offset there [s]."""
        a = np.array([1.0, t - self.middle])
        return float(np.sqrt(a @ self.covariance @ a))


def line(windows: list[Window], offsets: FloatArray) -> Line | None:
    """The line that is likeliest over all windows (offsets tried (S,), uniform); None where no window agrees with one.

    It is found on the grid, where a stray window counts no more than `STRAY`, then refined by least squares through the
    windows that agree with it.
    """
    if not windows:
        return None
    step = float(offsets[1] - offsets[0])
    t = np.array([window.t for window in windows])
    likelihood = np.array([window.likelihood for window in windows])  # (K, S)
    middle, level, slope = _coarse(t, likelihood, offsets, step)
    telling = likelihood.max(axis=1) - np.median(likelihood, axis=1) > CLEAR
    near = round(NEAR_S / step)
    agreeing, straying, total = [], [], 0.0
    for k in range(len(windows)):
        place = int(np.clip(round((level + slope * (t[k] - middle) - offsets[0]) / step), 0, len(offsets) - 1))
        total += float(likelihood[k, place])
        best = int(np.argmax(likelihood[k]))
        if telling[k] and abs(best - place) <= near and 0 < best < len(offsets) - 1:
            shift, sd = _vertex(likelihood[k, best - 1 : best + 2], step)
            agreeing.append(Offset(float(t[k]), float(offsets[best]) + shift, max(sd, FLOOR_S)))
        elif telling[k]:
            straying.append(Offset(float(t[k]), float(offsets[best]), 0.0))
    if not agreeing:
        return None
    return _refined(agreeing)._replace(straying=straying, likelihood=total)


def _coarse(t: FloatArray, likelihood: FloatArray, offsets: FloatArray, step: float) -> tuple[float, float, float]:
    """Middle [s], level [s] and slope of the likeliest line on the grid."""
    middle = 0.5 * float(t[0] + t[-1])
    reach = 0.5 * float(t[-1] - t[0])
    capped = np.maximum(likelihood - likelihood.max(axis=1, keepdims=True), -STRAY)
    steps = int(MOST_DRIFT * reach / step) + 1 if reach else 0
    best = (-np.inf, 0.0, 0.0)
    for slope in (np.arange(-steps, steps + 1) * step / max(reach, step)).tolist():
        places = np.round(slope * (t - middle) / step).astype(int)[:, None] + np.arange(len(offsets))
        outside = (places < 0) | (places >= len(offsets))
        values = np.take_along_axis(capped, np.clip(places, 0, len(offsets) - 1), axis=1)
        total = np.where(outside, -STRAY, values).sum(axis=0) - 0.5 * (slope / DRIFT_SD) ** 2
        place = int(np.argmax(total))
        best = max(best, (float(total[place]), float(offsets[place]), slope))
    return middle, best[1], best[2]


def _vertex(y: FloatArray, step: float) -> tuple[float, float]:
    """Of the parabola through three log likelihoods: its maximum beside the middle one, and the standard deviation."""
    curvature = float(2 * y[1] - y[0] - y[2]) / step**2
    if curvature <= 0:
        return 0.0, step
    return float(y[2] - y[0]) / (2 * step) / curvature, float(curvature**-0.5)


def _refined(offsets: list[Offset]) -> Line:
    """Least squares, with what is known of drifts; the scatter of the windows widens the covariance."""
    t, offset, sd = (np.array(column) for column in zip(*offsets, strict=True))
    middle = float(np.average(t, weights=sd**-2.0))
    A = np.column_stack([np.ones(len(t)), t - middle]) / sd[:, None]
    normal = A.T @ A + np.diag([0.0, DRIFT_SD**-2.0])
    level, slope = np.linalg.solve(normal, A.T @ (offset / sd))
    rest = (offset - level - slope * (t - middle)) / sd
    scatter = float(np.sum(rest**2) + 2.0) / len(t)  # as if two more windows scattered as they should
    return Line(middle, float(level), float(slope), np.linalg.inv(normal) * max(scatter, 1.0), offsets, [], 0.0)

"""Finds the second logger's clock on the CAN clock: the same pressure, seen by two sensors, must rise at the same time.

Thesis 5.8 aligns the follower (second logger) with the reference (CAN) by cross-correlation, and by steps of the
pressure where that is not clear, taking the hydraulics as instantaneous next to the sample time. Here: candidate lags
of the highest correlation (`lags`); at each, offsets in windows (`windows`) and the likeliest line through them, whose
slope is the drift (`line`); the candidate that explains most of the reference, or shares most steps (`steps`). Times
are in seconds after the first CAN frame and after the logger's own zero.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from faultline.analysis.model.bench import BenchSetup
from faultline.analysis.recordings.band import gridded
from faultline.analysis.recordings.lags import MINIMUM_OVERLAP_S, Likeness, correlation, likeness
from faultline.analysis.recordings.line import MOST_DRIFT, Line, Offset, line
from faultline.analysis.recordings.steps import shared
from faultline.analysis.recordings.track import Track
from faultline.analysis.recordings.windows import STEP_S, Pressures, pressures
from faultline.service.core.errors import InputError
from faultline.service.core.signals.values import FloatArray

REACH_S = 0.5  # of the coarse lag, besides the drift
PROBES_S = (0.2, 0.4)
OTHERS_S = (0.1, 0.3, 0.55, 0.75, 1.0, 1.4)
"""Time constants that the reference's sensor is tried with, the others where a probe helps: slow is not late."""
CALM_S = 0.2  # standard deviation of the bell over the follower that leaves little of its noise
MAYBE = 1.025  # how much likelier a slow sensor has to make the reference to be suspected
SLOWER = 1.04  # and to be believed

MINIMUM_CORRELATION = 0.7
CLOSE = 0.93  # of the best likelihood: a second alignment this good makes the first doubtful
CLEARLY = 0.1  # part of all steps that the better of two close alignments shares more
SET_WINDOWS = 4
"""So many windows on end that stray are no accident of their own: nearly three minutes."""
AGREEMENT = 0.5  # of the windows that tell something
SYSTEMATIC_S = 0.01  # what every window has in common: age of the controller's value, valve, filter
ENOUGH_S = 0.022  # standard error that still keeps 50 ms in all but one of some forty


class ClockError(InputError):
    """The two logs cannot be aligned."""


class Clock(NamedTuple):
    """CAN time = `offset_s` + (1 + `drift`) * logger time.

    `error_s` is the standard error of the alignment where it is largest in the time that both logs cover, None for a
    clock given by hand; `doubt` is why the alignment may be wrong, empty where it is `confident`. `slow_s` is the time
    constant that the reference's sensor seems to have, `windows` the offsets that the line was laid through, `straying`
    those that say something else, `likeness` the correlation over the lag.
    """

    offset_s: float
    drift: float
    correlation: float
    error_s: float | None = None
    doubt: str = ""
    slow_s: float = 0.0
    windows: tuple[Offset, ...] = ()
    straying: tuple[Offset, ...] = ()
    likeness: Likeness | None = None

    @property
    def confident(self) -> bool:
        """Whether the alignment is known to be right."""
        return not self.doubt

    def can_time(self, t: FloatArray) -> FloatArray:
        """Logger times [s] on the CAN clock."""
        return self.offset_s + (1.0 + self.drift) * t


class _Fit(NamedTuple):
    """The line near a candidate lag [s], and the time constant [s] of the reference's sensor that goes with it."""

    lag: float
    slow_s: float
    line: Line


def given(follower: Track, reference: Track, offset_s: float, drift: float) -> Clock:
    """The clock that somebody else has found."""
    clock = Clock(offset_s, drift, 0.0)
    return clock._replace(correlation=correlation(_moved(follower, clock), reference))


def synchronise(follower: Track, reference: Track, command: Track, setup: BenchSetup, where: str) -> Clock:
    """The clock of `follower` (logger time) on that of `reference` and `command` (CAN time), and whether to believe it.

    Raises:
        ClockError: there is no alignment at all; the message starts with `where`.
    """
    found = likeness(follower, reference)
    if not np.isfinite(found.correlation).any():
        raise ClockError(
            f"{where}: the loggers have less than {MINIMUM_OVERLAP_S:g} s in common at any offset, with both pressures "
            "known and moving; record for longer, or give the clock with --offset SECONDS"
        )
    ready = pressures(follower, reference, command, setup)
    span = float(min(np.ptp(follower.t), np.ptp(reference.t)))
    fits = [fit for lag in found.candidates() if (fit := _fit(ready, lag, 0.0, span)) is not None]
    if not fits:
        raise ClockError(
            f"{where}: the second logger's {setup.follower} does not follow the CAN log's {setup.reference} at any "
            "offset; check the columns, that both files are of one drive, and that the system ran; or give the clock "
            "with --offset SECONDS"
        )
    best, doubt = _chosen(fits, follower, reference, setup)
    calm = pressures(follower, reference, command, setup, CALM_S)
    best, lagging = _with_sensor(ready, calm, best, span, setup)
    slope = best.line.slope
    drift = 1.0 / (1.0 - slope) - 1.0  # the line runs over CAN time
    clock = Clock((best.line.level - slope * best.line.middle) * (1.0 + drift), drift, 0.0)
    aligned = _moved(follower, clock)
    ends = max(aligned.t[0], reference.t[0]), min(aligned.t[-1], reference.t[-1])
    clock = clock._replace(
        correlation=correlation(_felt(aligned, best.slow_s), reference),
        error_s=float(np.hypot(max(best.line.sd(float(t)) for t in ends), SYSTEMATIC_S)),
        slow_s=best.slow_s,
        windows=tuple(best.line.agreeing),
        straying=tuple(best.line.straying),
        likeness=found,
    )
    return clock._replace(doubt=doubt or lagging or _doubt(clock, setup))


def _moved(follower: Track, clock: Clock) -> Track:
    return follower._replace(t=clock.can_time(follower.t))


def _felt(follower: Track, slow_s: float) -> Track:
    """What a sensor with this time constant [s] makes of it."""
    grid = gridded(follower, STEP_S).slowed(slow_s)
    known = grid.known
    return Track(grid.t[known], grid.value[known])


def _fit(ready: Pressures, lag: float, slow_s: float, span: float) -> _Fit | None:
    """None where the follower explains nothing of the reference."""
    reach = round((REACH_S + MOST_DRIFT * span / 2) / STEP_S)
    offsets: FloatArray = lag - slow_s + np.arange(-reach, reach + 1) * np.float64(STEP_S)
    found = line(ready.windows(offsets, slow_s), offsets)
    return None if found is None or found.likelihood <= 0 else _Fit(lag, slow_s, found)


def _chosen(fits: list[_Fit], follower: Track, reference: Track, setup: BenchSetup) -> tuple[_Fit, str]:
    """The likeliest; of several about as likely the one that shares most steps; and why that may be wrong."""
    best = max(fits, key=lambda fit: fit.line.likelihood)
    close = [fit for fit in fits if fit.line.likelihood >= CLOSE * best.line.likelihood]
    if len(close) == 1:
        return best, ""
    by_steps = sorted(((shared(follower, reference, fit.lag, setup), fit) for fit in close), key=lambda pair: -pair[0])
    (most, best), (next_most, other) = by_steps[:2]
    if most - next_most >= CLEARLY:
        return best, ""
    return best, f"offsets of {best.lag:.1f} s and {other.lag:.1f} s fit about as well, as in a cycle that repeats"


def _with_sensor(ready: Pressures, calm: Pressures, best: _Fit, span: float, setup: BenchSetup) -> tuple[_Fit, str]:
    """The fit with the likeliest time constant of the reference's sensor, and why that may be wrong.

    Whether there is one is asked of the follower without noise (`calm`), since to be slow is also to be less noisy; how
    long it is of the follower as it is (`ready`), since to be calm is also to be slow.
    """

    def likelihoods(which: Pressures, times: Iterable[float]) -> dict[float, float]:
        fits = {slow_s: _fit(which, best.lag, slow_s, span) for slow_s in times}
        return {slow_s: fit.line.likelihood for slow_s, fit in fits.items() if fit is not None}

    of_calm = likelihoods(calm, (0.0, *PROBES_S))
    gain = max(of_calm.values()) / of_calm[0.0] if of_calm.get(0.0, 0.0) > 0 else 1.0
    if gain < MAYBE:
        return best, ""
    found = likelihoods(ready, sorted((0.0, *PROBES_S, *OTHERS_S)))
    times, values = list(found), list(found.values())
    k = int(np.argmax(values))
    if gain < SLOWER or k == 0:
        return best, f"the sensor of {setup.reference} may be slow, which cannot be told from a late clock here"
    near = slice(max(k - 1, 0), k + 2)
    a, b, _ = np.polyfit(times[near], values[near], 2) if 0 < k < len(times) - 1 else (0.0, 0.0, 0.0)
    return _fit(ready, best.lag, float(-b / (2 * a)) if a < 0 else times[k], span) or best, ""


def _doubt(clock: Clock, setup: BenchSetup) -> str:
    assert clock.error_s is not None
    if not clock.correlation >= MINIMUM_CORRELATION:
        return (
            f"{setup.follower} follows {setup.reference} with a correlation of {clock.correlation:.2f} only, "
            f"{MINIMUM_CORRELATION} is needed"
        )
    telling = len(clock.windows) + len(clock.straying)
    if len(clock.windows) < AGREEMENT * telling:
        return f"only {len(clock.windows)} of {telling} windows agree with one offset and drift"
    for run in _runs(clock):
        if len(run) >= SET_WINDOWS:
            other = float(np.median([offset.offset for offset in run]))
            return (
                f"from {run[0].t:.0f} to {run[-1].t:.0f} s the windows say another offset than the rest (about "
                f"{other:.1f} s), as if a clock had been set: split the recording there"
            )
    if clock.error_s > ENOUGH_S:
        return f"its standard error is {1e3 * clock.error_s:.0f} ms, {1e3 * ENOUGH_S:.0f} ms are needed"
    return ""


def _runs(clock: Clock) -> list[list[Offset]]:
    """The straying windows, cut where one that agrees is between them."""
    cuts = np.searchsorted([o.t for o in clock.windows], [o.t for o in clock.straying])
    return [[o for o, cut in zip(clock.straying, cuts, strict=True) if cut == place] for place in np.unique(cuts)]

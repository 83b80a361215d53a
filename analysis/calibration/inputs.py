"""How well a measured input is known at its samples and between them: what a free run integrates is its mean.

Four things make that mean uncertain: the noise of the samples, a jump between two of them at an instant that no sample
shows, a resolution so coarse that the reading stands still while the input does not, and a command's own timing, which
is no matter of this module. All are learnt from the samples; of the model comes only the sensor's noise.
"""

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq
from scipy.special import ndtr

from faultline.analysis.recordings.track import Track
from faultline.service.core.time_scale import TimeScale

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

STILL, LONG = 0.5, 5
"""An input that stands still for so many samples in a larger part of all is a command, or of a coarse resolution."""

RENEWED, MOST_HELD = 0.9, 10.0
"""Where so large a part of the stretches of equal readings has the usual length, give or take one, and that is no more
than so many samples, readings are sent more often than they are renewed."""

MANY_LEVELS, SMALL = 8, 2.0
"""So many levels, and moves that are mostly no larger than so many of the smallest: it is read, and no command."""

ROUGH = 3.0
"""Times the noise of its mode, from which an input's third difference is a jump: noise alone is one in 3 of 1,000."""

UNIFORM = 1.0 / np.sqrt(12.0)
"""Standard deviation of what lies anywhere within an interval of length one. So does the mean of an input that jumps at
an unknown instant, between its values before and after, and the input within the resolution of its reading.
"""

COARSE = 2.0
"""Times the noise of a sample, from which a resolution is coarse: the noise does not carry the reading to the next
level, and its error lasts as long as the reading."""

USUAL = 0.9
"""The part of all second differences that no step is in."""

SMALLEST, LARGEST = 0.2, 1e3
"""Standard deviations of a second difference, in steps of the resolution, between which noise is looked for: with less,
readings only tell that it is small."""

FAINT = 0.1
"""Of a sensor's noise: a smaller error of a mean does not show."""

PART = 0.25
"""Settling times: within a stretch of equal readings the error is another after so long, though related."""


def is_command(value: Array) -> bool:
    """Whether samples (N,) hold still between steps as a command does, and not as a reading of a coarse resolution."""
    moves = np.abs(np.diff(value))
    lengths = _lengths(value)
    if lengths[lengths >= LONG].sum() < STILL * len(value):
        return False
    moves = moves[moves > 0.0]
    return len(np.unique(value)) < MANY_LEVELS or float(np.median(moves)) > SMALL * resolution(value)


def renewed(track: Track) -> Track:
    """The samples at which a reading is another one, if it is sent more often than it is renewed; else all."""
    lengths = _lengths(track.value)
    usual = float(np.median(lengths))
    if not 1.0 < usual <= MOST_HELD or np.mean(np.abs(lengths - usual) <= 1.0) < RENEWED:
        return track
    first = np.diff(track.value, prepend=np.inf) != 0.0
    first |= np.arange(len(first)) - np.maximum.accumulate(np.where(first, np.arange(len(first)), 0)) >= 2.0 * usual
    return Track(track.t[first], track.value[first])


def _lengths(value: Array) -> Ints:
    """Of the stretches of equal samples (N,)."""
    first = np.flatnonzero(np.diff(value, prepend=np.inf) != 0.0)
    return np.diff(np.append(first, len(value)))


def resolution(value: Array) -> float:
    """The smallest difference between two values (N,) that differ by more than the rounding of numbers."""
    steps = np.diff(np.unique(value))
    steps = steps[steps > 1e-6 * max(float(np.ptp(value)), 1e-300)]
    return float(steps.min()) if len(steps) else 0.0


def sample_noise(noise: float, track: Track, t: Array, mode: Ints) -> Array:
    """The standard deviation (K,) of a sample at the times `t` in modes (K,), at least the sensor's `noise`.

    A speed that follows the valve's pulses, or what its own controller makes of noise, is sampled too seldom to be
    known in between: to a free run that is noise. It shows in second differences, where slower changes hardly do.
    """
    found = np.full(len(t), noise)
    middle = track.t[1:-1]
    inside = (middle >= t[0]) & (middle <= t[-1])
    flicker = np.abs(np.diff(track.value, 2))[inside] / np.sqrt(6.0)
    at = mode[np.searchsorted(t, middle[inside], side="right") - 1]
    for k in np.unique(at):
        found[mode == k] = max(by_median(flicker[at == k]), noise)
    return found


def uncertain(track: Track, t: Array, noise: Array, time: TimeScale) -> Array:
    """The intervals (J, 4) over which an input's mean has an error of its own, besides the noise (K,) at times `t`.

    Begin and end [s] after the first of the times, the standard deviation, and a number that those with a common error
    have in common. Intervals between samples in which it jumps: a jump's height is half the third difference around it,
    which is all of it after a jump, and nothing where the input bends slowly. And stretches of equal readings, where
    the resolution is coarse.
    """
    jumps, equal = _jumps(track, t, noise), _equal(track, float(np.median(noise)), time)
    equal[:, 3] += len(jumps)
    found = np.concatenate([jumps, equal])
    found = found[(found[:, 1] > t[0]) & (found[:, 0] < t[-1])]
    found[:, 3] = np.unique(found[:, 3], return_inverse=True)[1]
    return np.asarray(found - np.array([t[0], t[0], 0.0, 0.0]))


def _jumps(track: Track, t: Array, noise: Array) -> Array:
    begin, end, rough = track.t[1:-2], track.t[2:-1], np.abs(np.diff(track.value, 3))
    at = np.clip(np.searchsorted(t, begin, side="right") - 1, 0, len(t) - 1)
    jumps = rough > ROUGH * np.sqrt(20.0) * noise[at]
    return np.asarray(np.column_stack([begin, end, UNIFORM * rough / 2.0, np.arange(len(begin))])[jumps])


def _equal(track: Track, noise: float, time: TimeScale) -> Array:
    """Stretches of equal readings, and their parts, as the input may move within; none if the resolution is fine."""
    step = resolution(track.value)
    if step <= COARSE * noise:
        return np.zeros((0, 4))
    half = np.diff(track.t) / 2.0
    edges = np.concatenate([[track.t[0]], track.t[:-1] + half, [track.t[-1]]])
    other = np.diff(track.value, prepend=np.inf) != 0.0
    part = np.floor((track.t - track.t[0]) / (PART * time.settling_s))
    found, groups = [], 0
    for fresh in (other, other | (np.diff(part, prepend=-1.0) != 0.0)):
        first = np.flatnonzero(fresh)
        last = np.append(first[1:], len(track.t))
        own = groups + np.arange(len(first))
        found.append(np.column_stack([edges[first], edges[last], np.full(len(first), UNIFORM * step), own]))
        groups += len(first)
    return np.concatenate(found)


def misread(track: Track, noise: float, time: TimeScale) -> Array:
    """The intervals (J, 4) over which a reading's mean is off, as its `noise` does not carry it across its resolution.

    Of the error of quantisation that noise of a standard deviation s leaves in a mean, the largest part is q / pi times
    exp(-2 pi^2 s^2 / q^2) for a resolution q (Widrow and Kollar, Quantization Noise, 2008). It is a function of what is
    read: intervals with the same mean have it in common. As for `uncertain`, but times are the track's.
    """
    step = resolution(track.value)
    if not step:
        return np.zeros((0, 4))
    left = UNIFORM * step * np.exp(-2.0 * np.pi**2 * rounded_noise(track.value / step) ** 2)
    if left < FAINT * noise:
        return np.zeros((0, 4))
    part = np.floor(track.t / (PART * time.settling_s))
    number = np.unique(part, return_inverse=True)[1]
    mean = np.bincount(number, track.value) / np.bincount(number)
    group = np.unique(np.round(mean / (0.5 * step)), return_inverse=True)[1]
    begin = PART * time.settling_s * np.unique(part)
    return np.column_stack([begin, begin + PART * time.settling_s, np.full(len(begin), left), group])


def rounded_noise(value: Array) -> float:
    """The standard deviation of the noise that was in samples (N,) before they were rounded to integers.

    By the mean square of second differences, without the largest, which steps are in: as that of a normal variable that
    is rounded too. Rounding adds a variance of 1/12 to each sample (Sheppard).
    """
    square = np.sort(np.diff(value, 2) ** 2)
    seen = _usual(square, np.full(len(square), 1.0 / len(square)))
    if not _rounded_square(SMALLEST) < seen < _rounded_square(LARGEST):
        return 0.0 if seen < 1.0 else float(np.sqrt(seen / 6.0))
    sd = brentq(lambda sd: _rounded_square(sd) - seen, SMALLEST, LARGEST, xtol=1e-3)
    return float(np.sqrt(max((sd**2 + 1.0 / 12.0) / 6.0 - 1.0 / 12.0, 0.0)))


def _rounded_square(sd: float) -> float:
    """The mean of the usual squares of a normal variable that is rounded to integers."""
    k = np.arange(np.ceil(8.0 * sd) + 1.0)
    probability = np.diff(ndtr((np.append(k, k[-1] + 1.0) - 0.5) / sd)) * np.where(k > 0.0, 2.0, 1.0)
    return _usual(k**2, probability)


def _usual(square: Array, probability: Array) -> float:
    """The mean of the smallest values (N,) of which the probabilities (N,) make up the part that is usual."""
    before = np.cumsum(probability) - probability
    return float(square @ np.clip(USUAL - before, 0.0, probability)) / USUAL


def by_median(e: Array) -> float:
    """The standard deviation of (N,) zero-mean noise, or of its magnitudes, in which there may be steps."""
    return 1.4826 * float(np.median(np.abs(e)))


def interpolated(track: Track, t: Array, gap_s: float) -> Array:
    """The values of a measured input at times `t`: on a cubic spline, as chords flatten each swing."""
    near = (track.t > t[0] - gap_s) & (track.t < t[-1] + gap_s)
    return np.asarray(CubicSpline(track.t[near], track.value[near])(t))

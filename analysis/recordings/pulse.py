"""The actuator's pulses, which no message carries: their frequency and phase from the ripple of the pressures.

Thesis 5.8 makes a pulse-width modulated signal of the duty cycle, "using the right interval". Here that interval is
estimated. Over a period the actuator is on for the share d at the start; the first harmonic of that is
sin(pi d) cos(2 pi (f t + phase - d/2)), and the system integrates it, so that the follower shows

    -B sin(pi d) sin(2 pi (f t + phase - d/2)),  B > 0.

At 5 and 10 Hz a ripple of a few hertz is near or beyond the sampling's own limit, but the times are uneven and known,
and the term d/2 turns the other way for an alias: the frequency with the highest power over both pressures is the
right one.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from faultline.analysis.model.bench import BenchSetup
from faultline.analysis.recordings.track import Track
from faultline.service.core.errors import InputError
from faultline.service.core.signals.values import FloatArray

BETWEEN = (0.05, 0.95)  # commands with a ripple to speak of
LEAST_S = 20.0  # of such commands
NEIGHBOURS = 2  # samples each side, whose mean is what the ripple is about
LEAST_SHARE = 0.15  # of the variance about that mean, which the pulses have to explain


class PulseError(InputError):
    """The pulses cannot be made out."""


class Pulse(NamedTuple):
    """Pulses begin when `frequency_hz` t + `phase` is whole, t [s] on the log's clock.

    `explained` is the share of the follower's ripple that they explain.
    """

    frequency_hz: float
    phase: float
    explained: float

    def share(self, command: Track, t: FloatArray, period_s: float) -> FloatArray:
        """The share (K,) of the time from `t` - `period_s` to `t` (K,) [s] in which the actuator was on.

        A new duty cycle takes effect with the next pulse, as a timer's shadow register does.
        """
        first = np.floor(self.frequency_hz * (t[0] - period_s) + self.phase) - 1.0
        last = np.ceil(self.frequency_hz * t[-1] + self.phase)
        starts = (np.arange(first, last + 1.0) - self.phase) / self.frequency_hz
        duty = command.value[np.maximum(np.searchsorted(command.t, starts, side="right") - 1, 0)]
        width = np.clip(duty, 0.0, 1.0) / self.frequency_hz  # [s]
        before = np.concatenate([[0.0], np.cumsum(width)[:-1]])

        def opened(at: FloatArray) -> FloatArray:
            k = np.searchsorted(starts, at, side="right") - 1
            return np.asarray(before[k] + np.minimum(at - starts[k], width[k]))

        return np.asarray(np.clip((opened(t) - opened(t - period_s)) / period_s, 0.0, 1.0))


def estimate_pulse(
    follower: Track, reference: Track, command: Track, setup: BenchSetup, frequency_hz: float | None = None
) -> Pulse:
    """The pulses in a recording, of a given frequency or of the likeliest; all tracks on the log's clock.

    Raises:
        PulseError: there is too little time between off and full, or no ripple that pulses explain.
    """
    ripples = [_ripple(track, command) for track in (follower, reference)]
    length = len(ripples[0].t) * follower.period_s
    if length < LEAST_S:
        raise PulseError(
            f"no pulses of {setup.command} can be made out: {length:.0f} s of it between off and full, "
            f"{LEAST_S:g} s are needed"
        )
    if frequency_hz is None:
        span = max(float(np.ptp(ripple.t)) for ripple in ripples)
        grid = np.arange(*setup.pulse_hz, 0.2 / span)
        power = sum(_power(ripple, grid) for ripple in ripples)
        frequency_hz = float(grid[int(np.argmax(power))])
    theta = 2 * np.pi * (frequency_hz * ripples[0].t - ripples[0].duty / 2)
    A = np.sin(np.pi * ripples[0].duty)[:, None] * np.column_stack([np.cos(theta), np.sin(theta)])
    (a, b), *_ = np.linalg.lstsq(A, ripples[0].value, rcond=None)
    left = ripples[0].value - A @ np.array([a, b])
    explained = 1.0 - float(np.mean(left**2) / np.mean(ripples[0].value ** 2))
    if explained < LEAST_SHARE:
        raise PulseError(
            f"no pulses of {setup.command} can be made out: {frequency_hz:.3f} Hz explains {100 * explained:.0f} % of "
            f"{setup.follower}'s ripple, {100 * LEAST_SHARE:.0f} % are needed"
        )
    return Pulse(frequency_hz, float(np.mod(np.arctan2(-a, -b) / (2 * np.pi), 1.0)), explained)


class _Ripple(NamedTuple):
    """What a pressure has about its running mean [Pa], at times `t` [s] of commands `duty` (N,)."""

    t: FloatArray
    value: FloatArray
    duty: FloatArray


def _ripple(track: Track, command: Track) -> _Ripple:
    width = 2 * NEIGHBOURS + 1
    mean = np.convolve(track.value, np.ones(width) / width, mode="same")
    duty = command.value[np.clip(np.searchsorted(command.t, track.t, side="right") - 1, 0, None)]
    before = command.value[np.clip(np.searchsorted(command.t, track.t - 2.0, side="right") - 1, 0, None)]
    steady = (duty > BETWEEN[0]) & (duty < BETWEEN[1]) & (duty == before)
    steady &= track.known(track.t, NEIGHBOURS * track.period_s)
    return _Ripple(track.t[steady], (track.value - mean)[steady], duty[steady])


def _power(ripple: _Ripple, grid: FloatArray) -> FloatArray:
    """Share (F,) of the ripple that pulses of each frequency on the uniform grid (F,) [Hz] explain, nearly."""
    weight = np.sin(np.pi * ripple.duty)
    phasor: npt.NDArray[np.complex128] = (
        np.exp(-2j * np.pi * (grid[0] * ripple.t - ripple.duty / 2)) * weight * ripple.value
    )
    turn = np.exp(-2j * np.pi * (grid[1] - grid[0]) * ripple.t)
    power = np.empty(len(grid))
    for k in range(len(grid)):
        power[k] = abs(phasor.sum()) ** 2
        phasor *= turn
    return power / max(float(np.sum(weight**2) * np.sum(ripple.value**2)), 1e-9)

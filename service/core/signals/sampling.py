"""The one causal sampler: what was known of every signal at a tick.

A sample is the last value received at or before the tick, with its quality. The same object feeds tuning, training,
evaluation and the vehicle. State: what is known of every input (`core.signals.latest`).
"""

from collections.abc import Mapping, Sequence
from math import isfinite, isnan

import numpy as np

from faultline.service.core.manifest import Input
from faultline.service.core.signals.latest import DOUBTED_S, Latest
from faultline.service.core.signals.values import FloatArray, Qualities, Quality

_GOOD, _MISSING, _LATE, _DOUBTED = (int(one) for one in (Quality.GOOD, Quality.MISSING, Quality.LATE, Quality.DOUBTED))


class Sampler:
    """Holds the latest value of every input; `sample(t)` reads them all at a tick."""

    def __init__(self, inputs: Sequence[Input]) -> None:
        self.inputs = tuple(Latest(channel) for channel in inputs)
        self._by_signal = {latest.signal: latest for latest in self.inputs}
        self._new_doubts: dict[str, float] = {}

    @property
    def complete(self) -> bool:
        """Return True if every input has been received with a usable value at least once."""
        return not any(isnan(latest.value) for latest in self.inputs)

    def doubt(self, since: Mapping[str, float]) -> None:
        """Mark these signals, and no others, as `DOUBTED` whatever is received; `since` when each has been [s]."""
        for signal, t in since.items():
            if signal in self._by_signal and not self._by_signal[signal].is_doubted:
                self.note_doubt(signal, t)
        for latest in self.inputs:
            latest.is_doubted = latest.signal in since

    def note_doubt(self, signal: str, t: float) -> None:
        """A signal comes to be doubted from its sample at log time `t` [s] on."""
        self._new_doubts[signal] = min(t, self._new_doubts.get(signal, t))

    def new_doubts(self) -> Mapping[str, float]:
        """Return the signals that came to be doubted since the last call, and the time [s] of the first such sample."""
        found, self._new_doubts = self._new_doubts, {}
        return found

    def receive(self, signal: str, t: float, value: float, quality: Quality) -> None:
        """Take a decoded signal at log time `t` [s]; a value that is not good never replaces a number."""
        latest, worth = self._by_signal[signal], int(quality)
        if worth == _GOOD and (worth := latest.plausible(t, value)) == _GOOD:
            latest.value = value
        elif worth == _DOUBTED:  # and so is the sample before it: one of the two is another sender's
            if t >= latest.doubted_until:
                self.note_doubt(signal, latest.time if isfinite(latest.time) else t)
            latest.doubted_until = t + DOUBTED_S
            return
        elif latest.quality == _GOOD:
            latest.last_good = latest.time
        latest.time = t
        latest.quality = worth

    def sample(self, t: float) -> tuple[FloatArray, Qualities]:
        """Return values (nz,) [bundle units] and their quality (nz,) at log time `t` [s].

        A value that is not good is the last good one, or NaN where there never was one.
        """
        values, qualities = [], []
        for latest in self.inputs:
            quality = latest.quality
            if t - latest.time > latest.maximum_age and quality != _MISSING:
                quality = _LATE
            elif quality == _GOOD and (latest.is_doubted or t < latest.doubted_until):
                quality = _DOUBTED
            values.append(latest.value)
            qualities.append(quality)
        return np.array(values), np.array(qualities, dtype=np.int8)

    def ages(self, t: float) -> FloatArray:
        """Return the time from each value's frame to log time `t` (nz,) [s]; NaN where there never was one."""
        came = [latest.time if latest.quality == _GOOD else latest.last_good for latest in self.inputs]
        return np.asarray(t - np.array(came), dtype=np.float64)

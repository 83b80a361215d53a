"""The one causal sampler: what was known of every signal at a tick.

A sample is the last value received at or before the tick, with its quality. The same object feeds tuning, training,
evaluation and the vehicle.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from faultline.service.core.manifest import Input
from faultline.service.core.signals.values import FloatArray, Qualities, Quality

DOUBTED_S = 10.0
"""For so long after a frame that nobody knows whose it is, its signals are not believed [s]."""

_NO_NUMBER = (Quality.MISSING, Quality.NOT_AVAILABLE, Quality.ERROR, Quality.RESERVED)


class Sampler:
    """Holds the latest value of every input; `sample(t)` reads them all at a tick.

    State: two values, three times and one quality per input: constant memory.
    """

    def __init__(self, inputs: Sequence[Input]) -> None:
        self._column = {channel.signal: column for column, channel in enumerate(inputs)}
        self._inputs = tuple(inputs)
        self._maximum_age = np.array([channel.maximum_age_s for channel in inputs])
        self._value = np.full(len(inputs), np.nan)  # the last one that was good
        self._time = np.full(len(inputs), -np.inf)
        self._quality = np.full(len(inputs), Quality.MISSING, dtype=np.int8)
        self._heard = [np.nan] * len(inputs)  # the last number, believed or not
        self._changed = [-np.inf] * len(inputs)  # when it became another one, or came into the operating region
        self._doubted = np.zeros(len(inputs), dtype=np.bool_)
        self._doubted_until = np.full(len(inputs), -np.inf)
        self._new_doubts: dict[str, float] = {}

    @property
    def complete(self) -> bool:
        """Return True if every input has been received with a usable value at least once."""
        return not np.isnan(self._value).any()

    def doubt(self, since: Mapping[str, float]) -> None:
        """Mark these signals, and no others, as `DOUBTED` whatever is received; `since` when each has been [s]."""
        for signal, t in since.items():
            if signal in self._column and not self._doubted[self._column[signal]]:
                self._new_doubts[signal] = min(t, self._new_doubts.get(signal, t))
        self._doubted[:] = [channel.signal in since for channel in self._inputs]

    def new_doubts(self) -> Mapping[str, float]:
        """Return the signals that came to be doubted since the last call, and the time [s] of the first such sample."""
        found, self._new_doubts = self._new_doubts, {}
        return found

    def receive(self, signal: str, t: float, value: float, quality: Quality) -> None:
        """Take a decoded signal at log time `t` [s]; a value that is not good never replaces a number."""
        column = self._column[signal]
        if quality is Quality.DOUBTED:  # and so is the sample before it: one of the two is another sender's
            if t >= self._doubted_until[column]:
                before = float(self._time[column])
                self._new_doubts[signal] = min(before if np.isfinite(before) else t, self._new_doubts.get(signal, t))
            self._doubted_until[column] = t + DOUBTED_S
            return
        if quality is Quality.GOOD:
            quality = self._plausible(column, t, value)
        self._time[column] = t
        self._quality[column] = quality
        if quality is Quality.GOOD:
            self._value[column] = value

    def sample(self, t: float) -> tuple[FloatArray, Qualities]:
        """Return values (nz,) [bundle units] and their quality (nz,) at log time `t` [s].

        A value that is not good is the last good one, or NaN where there never was one.
        """
        late = (t - self._time > self._maximum_age) & (self._quality != Quality.MISSING)
        quality = np.where(late, np.int8(Quality.LATE), self._quality)
        doubted = (self._doubted | (t < self._doubted_until)) & (quality == Quality.GOOD)
        return self._value.copy(), np.where(doubted, np.int8(Quality.DOUBTED), quality)

    def _plausible(self, column: int, t: float, value: float) -> Quality:
        """Return the quality of a number after those before it.

        One that jumps is not believed until a second one is near it: a spike is none of the sensor's values, a step is.
        """
        channel, before = self._inputs[column], self._heard[column]
        self._heard[column] = value
        gap = t - self._time[column]
        away = gap > channel.maximum_age_s  # nobody knows what it was meanwhile
        unknown = away or self._quality[column] in _NO_NUMBER
        if value != before or unknown or not channel.lower < value < channel.upper:
            self._changed[column] = t
        if channel.frozen_s is not None and t - self._changed[column] > channel.frozen_s:
            return Quality.FROZEN
        step = channel.largest_step
        if step is not None and not away and self._quality[column] != Quality.MISSING:
            near = min(abs(value - before), abs(value - float(self._value[column])))
            if near > step:
                return Quality.JUMP
        return Quality.GOOD

"""The one causal sampler: what was known of every signal at a tick.

A sample is the last value received at or before the tick, with its age and quality. The same object feeds tuning,
training, evaluation and the vehicle.
"""

from collections.abc import Sequence

import numpy as np

from service.core.manifest import Input
from service.core.signals import Mask, Quality, Vector


class Sampler:
    """Holds the latest value of every input; `sample(t)` reads them all at a tick.

    State: one value, one time and one quality per input: constant memory.
    """

    def __init__(self, inputs: Sequence[Input]) -> None:
        self._column = {channel.signal: column for column, channel in enumerate(inputs)}
        self._maximum_age = np.array([channel.maximum_age_s for channel in inputs])
        self._value = np.full(len(inputs), np.nan)
        self._time = np.full(len(inputs), -np.inf)
        self._quality = np.full(len(inputs), Quality.MISSING, dtype=np.int8)

    @property
    def complete(self) -> bool:
        """Whether every input has been received with a usable value at least once."""
        return not np.isnan(self._value).any()

    def receive(self, signal: str, t: float, value: float, quality: Quality) -> None:
        """Takes a decoded signal at log time `t` [s]; a value that is not good never replaces a number."""
        column = self._column[signal]
        self._time[column] = t
        self._quality[column] = quality
        if quality is Quality.GOOD:
            self._value[column] = value

    def sample(self, t: float) -> tuple[Vector, Mask]:
        """Values (nz,) [bundle units] and whether each may be used (nz,) at log time `t` [s].

        A value that may not be used is the last good one, or NaN where there never was one.
        """
        fresh = t - self._time <= self._maximum_age
        return self._value.copy(), fresh & (self._quality == Quality.GOOD)

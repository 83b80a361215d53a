"""What a sensor's numbers are like without a fault: beyond that they are not believed on the vehicle.

How long a number ever rested, and how far two in a row ever were apart. A sensor whose last digits move with the noise
never rests for long; one that does, or a command, is no witness: it may rest for as long as it likes.
"""

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType

import msgspec
import numpy as np
import numpy.typing as npt

from faultline.service.core.manifest import Input
from faultline.service.core.signals.received import Signals
from faultline.service.core.signals.values import are_good

Array = npt.NDArray[np.float64]

NO_JITTER: Mapping[str, float] = MappingProxyType({})

RESTLESS = 10.0
"""Of its maximum age: a signal that never rested for so long is one whose rest means something."""
RESTS = 5.0
"""It is frozen after so many times its longest rest, and not before it is `RESTLESS`."""
STEPS = 2.0
"""It jumps by more than so many times its largest step."""


class _Range:
    """How long a signal ever rested [s] and its largest step, of the numbers so far. State: the last one, and since."""

    def __init__(self, channel: Input) -> None:
        self.rest, self.step = 0.0, 0.0
        self._channel = channel
        self._last, self._at, self._since = np.nan, -np.inf, -np.inf

    def take(self, t: Array, value: Array) -> None:
        """Take numbers (K,) that came at times `t` (K,) [s]."""
        if not len(t):
            return
        before, gap = np.concatenate([[self._last], value[:-1]]), np.diff(t, prepend=self._at)
        steps = np.abs(value - before)[gap <= self._channel.maximum_age_s]
        moves = (value != before) | ~((self._channel.lower < value) & (value < self._channel.upper))
        since = np.maximum.accumulate(np.concatenate([[self._since], np.where(moves, t, -np.inf)]))
        self.step = max(self.step, float(steps.max(initial=0.0)))
        self.rest = max(self.rest, float((t - since[1:]).max()))
        self._last, self._at, self._since = float(value[-1]), float(t[-1]), float(since[-1])

    def limited(self, *, steps: bool) -> Input:
        """The signal with the limits that its numbers set, that of its `steps` where they are judged."""
        restless_s = RESTLESS * self._channel.maximum_age_s
        return msgspec.structs.replace(
            self._channel,
            frozen_s=max(RESTS * self.rest, restless_s) if self.rest < restless_s else None,
            largest_step=STEPS * self.step if steps and self.step > 0.0 else None,
        )


def limited(
    inputs: Sequence[Input],
    signals: Signals,
    residuals: Collection[str] = (),
    jitter_s: Mapping[str, float] = NO_JITTER,
) -> list[Input]:
    """The inputs, each with the limits that its numbers in a log set.

    Of `residuals` that another tool computes any step is believed: a fault makes them jump. So it is of signals with a
    gate (`core.signals.gate`): a pulse of an actuator is larger where a filter is clogged. `jitter_s` [s] says by how
    much their frames have come too soon.
    """
    ranges = {channel.signal: _Range(channel) for channel in inputs}
    for piece in signals.pieces(judged=False):
        for signal, column in piece.columns.items():
            good = are_good(column.quality)
            ranges[signal].take(piece.time[column.row[good]], column.value[good])
    found = [
        ranges[channel.signal].limited(steps=channel.outlier is None and channel.signal not in residuals)
        for channel in inputs
    ]
    return [msgspec.structs.replace(each, jitter_s=jitter_s.get(each.signal)) for each in found]


def widest(limits: Sequence[Sequence[Input]]) -> list[Input]:
    """The inputs with limits that all of these recordings keep."""
    found = []
    for channels in zip(*limits, strict=True):
        rests = [channel.frozen_s for channel in channels]
        steps = [channel.largest_step for channel in channels]
        jitters = [channel.jitter_s for channel in channels if channel.jitter_s is not None]
        found.append(
            msgspec.structs.replace(
                channels[0],
                frozen_s=max((r for r in rests if r is not None), default=None) if None not in rests else None,
                largest_step=max((s for s in steps if s is not None), default=None) if None not in steps else None,
                jitter_s=max(jitters, default=None),
            )
        )
    return found

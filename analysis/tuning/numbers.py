"""What a sensor's numbers are like without a fault: beyond that they are not believed on the vehicle.

How long a number ever rested, and how far two in a row ever were apart. A sensor whose last digits move with the noise
never rests for long; one that does, or a command, is no witness: it may rest for as long as it likes.
"""

from collections.abc import Iterable, Sequence

import msgspec
import numpy as np
import numpy.typing as npt

from faultline.service.core.manifest import Input
from faultline.service.core.signals.decode import DecodeTable
from faultline.service.core.signals.values import Quality
from faultline.service.logs import Frame

Array = npt.NDArray[np.float64]

RESTLESS_S = 10.0
"""A signal that never rested for so long is one whose rest means something."""
RESTS, LEAST_REST_S = 5.0, 10.0
"""It is frozen after so many times its longest rest, and not before so long."""
STEPS = 2.0
"""It jumps by more than so many times its largest step."""


def limited(inputs: Sequence[Input], table: DecodeTable, frames: Iterable[Frame]) -> list[Input]:
    """The inputs, each with the limits that its numbers in these frames set."""
    column = {channel.signal: k for k, channel in enumerate(inputs)}
    shape = len(inputs)
    last, since, at = np.full(shape, np.nan), np.zeros(shape), np.full(shape, -np.inf)
    rest, step = np.zeros(shape), np.zeros(shape)
    for t, can_id, is_extended, data in frames:
        for signal, value, quality in table.decode(can_id, is_extended, data):
            if quality is not Quality.GOOD:
                continue
            k = column[signal]
            channel = inputs[k]
            if t - at[k] <= channel.maximum_age_s:
                step[k] = max(step[k], abs(value - last[k]))
            if value != last[k] or not channel.lower < value < channel.upper:
                since[k] = t
            rest[k] = max(rest[k], t - since[k])
            last[k], at[k] = value, t
    return [
        msgspec.structs.replace(
            channel,
            frozen_s=max(RESTS * float(rest[k]), LEAST_REST_S) if rest[k] < RESTLESS_S else None,
            largest_step=STEPS * float(step[k]) if step[k] > 0.0 else None,
        )
        for k, channel in enumerate(inputs)
    ]


def widest(limits: Sequence[Sequence[Input]]) -> list[Input]:
    """The inputs with limits that all of these recordings keep."""
    found = []
    for channels in zip(*limits, strict=True):
        rests = [channel.frozen_s for channel in channels]
        steps = [channel.largest_step for channel in channels]
        found.append(
            msgspec.structs.replace(
                channels[0],
                frozen_s=max((r for r in rests if r is not None), default=None) if None not in rests else None,
                largest_step=max((s for s in steps if s is not None), default=None) if None not in steps else None,
            )
        )
    return found

"""What is known of one input: its last value, when it came and what it is worth.

A sensor that stands still for longer, or jumps further, than was ever seen without a fault is not believed.
"""

from math import inf, nan

from faultline.service.core.manifest import Input
from faultline.service.core.signals.values import Quality

DOUBTED_S = 10.0
"""For so long after a frame that nobody knows whose it is, its signals are not believed [s]."""

NO_NUMBER = frozenset(int(one) for one in (Quality.MISSING, Quality.NOT_AVAILABLE, Quality.ERROR, Quality.RESERVED))

_GOOD, _MISSING, _FROZEN, _JUMP = (int(one) for one in (Quality.GOOD, Quality.MISSING, Quality.FROZEN, Quality.JUMP))


class Latest:
    """One input; `value` is the last one that was good, NaN before. `time` and `quality` are of the last one of all.

    `number` is the last one of which the frame said that it is good, believed or not; `changed` is when it became
    another one, or came into the operating region; `is_doubted` and `doubted_until` say whose nobody knows. Times are
    log times [s], values in the bundle's unit. `last_good` is when `value` came, as long as `quality` is not good;
    while it is, `time` is.
    """

    __slots__ = (
        "changed",
        "doubted_until",
        "frozen_s",
        "is_doubted",
        "largest_step",
        "last_good",
        "lower",
        "maximum_age",
        "number",
        "quality",
        "signal",
        "time",
        "upper",
        "value",
    )

    def __init__(self, channel: Input) -> None:
        self.signal = channel.signal
        self.maximum_age, self.lower, self.upper = channel.maximum_age_s, channel.lower, channel.upper
        self.frozen_s = inf if channel.frozen_s is None else channel.frozen_s
        self.largest_step = inf if channel.largest_step is None else channel.largest_step
        self.value, self.time = nan, -inf
        self.quality, self.last_good = _MISSING, nan
        self.number, self.changed = nan, -inf
        self.is_doubted, self.doubted_until = False, -inf

    def plausible(self, t: float, value: float) -> int:
        """Return whether a sensor gives such a number at `t` [s] after those before it: good, frozen or a jump.

        One that jumps is not believed until a second one is near it: a spike is none of the sensor's values, a step is.
        """
        before, self.number = self.number, value
        is_away = t - self.time > self.maximum_age  # nobody knows what it was meanwhile
        is_known = not is_away and self.quality not in NO_NUMBER
        if not (value == before and is_known and self.lower < value < self.upper):
            self.changed = t
        elif t - self.changed > self.frozen_s:
            return _FROZEN
        if not is_away and self.quality != _MISSING and abs(value - before) > self.largest_step:
            return _JUMP if abs(value - self.value) > self.largest_step else _GOOD
        return _GOOD

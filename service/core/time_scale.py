"""How long things last: in settling times of a system, in sampling periods or in seconds, and in ticks."""

from typing import NamedTuple


class Span(NamedTuple):
    """How long something lasts: the longest of so many settling times of a system, sampling periods and seconds."""

    settlings: float = 0.0
    periods: float = 0.0
    seconds: float = 0.0


class TimeScale(NamedTuple):
    """How long a tick and how long the system's settling time is [s]."""

    period_s: float
    settling_s: float

    def seconds(self, span: Span) -> float:
        """A span in seconds."""
        return max(span.settlings * self.settling_s, span.periods * self.period_s, span.seconds)

    def ticks(self, span: Span) -> int:
        """A span in ticks, one at least.

        >>> TimeScale(0.2, 20.0).ticks(Span(settlings=1.5)), TimeScale(60.0, 120.0).ticks(Span(periods=15, seconds=60))
        (150, 15)
        """
        return max(1, round(self.seconds(span) / self.period_s))


def ticks_of(seconds: float, period_s: float) -> int:
    """So many seconds in ticks."""
    return round(seconds / period_s)

"""The dosing valve: pulse-width modulation resolved inside a step, with the needle's own delays."""

from dataclasses import dataclass

FREQUENCY = 3.317
"""Pulses a second: a few hertz, and no simple ratio to the 5 Hz of the bus, so that samples meet all phases."""


@dataclass(frozen=True)
class Needle:
    """The needle opens `opens_after` and shuts `shuts_after` [s] the coil's current, as magnet and spring need.

    Held open through a whole period it lifts further and passes the fraction `full_lift` more.
    """

    opens_after: float = 0.0
    shuts_after: float = 0.0
    full_lift: float = 0.0


class PulseWidth:
    """Opens for the part `duty` at the start of every period. State: the phase [0..1) and the duty of this period.

    What its `needle` is now takes effect with the next period; it never shuts further than `stuck` [0..1].

    A new duty cycle takes effect with the next period, as a timer's shadow register does. A pulse shorter than the
    opening delay moves nothing; one that lasts through the period does not shut.
    """

    def __init__(self, needle: Needle = Needle(), frequency: float = FREQUENCY) -> None:
        self.needle, self.stuck = needle, 0.0
        self._frequency = frequency
        self._phase = 0.0
        self._opens, self._shuts, self._lift = 0.0, 0.0, 1.0  # of this period

    def opening(self, h: float, duty: float) -> float:
        """The part of the next `h` [s] (shorter than a period) in which the valve is open; above 1 in full lift."""
        step = h * self._frequency
        end = self._phase + step
        is_open = self._open(self._phase, end)
        if end >= 1.0:
            end -= 1.0
            was_open = self._shuts >= 1.0
            needle = self.needle
            self._opens = 0.0 if was_open else needle.opens_after * self._frequency
            self._shuts = 1.0 if duty >= 1.0 else duty + needle.shuts_after * self._frequency
            if duty <= self._opens:
                self._shuts = 0.0
            self._lift = 1.0 + needle.full_lift if duty >= 1.0 and was_open else 1.0
            is_open += self._open(0.0, end)
        self._phase = end
        return max(is_open / step, self.stuck)

    def _open(self, start: float, end: float) -> float:
        """The part of the period between two phases in which the valve is open, weighted with its lift."""
        if start >= self._shuts or end <= self._opens:
            return 0.0
        return self._lift * (min(end, self._shuts) - max(start, self._opens))

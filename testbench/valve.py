"""The dosing valve's pulse-width modulation, resolved inside a step."""

FREQUENCY = 3.317
"""Pulses a second: a few hertz, and no simple ratio to the 5 Hz of the bus, so that samples meet all phases."""


class PulseWidth:
    """Opens for the part `duty` at the start of every period. State: the phase [0..1) and the duty of this period.

    Opens and closes at once. A new duty cycle takes effect with the next period, as a timer's shadow register does.
    """

    def __init__(self, frequency: float = FREQUENCY) -> None:
        self._frequency = frequency
        self._phase = 0.0
        self._duty = 0.0

    def opening(self, h: float, duty: float) -> float:
        """The part [0..1] of the next `h` [s] (shorter than a period) in which the valve is open."""
        step = h * self._frequency
        end = self._phase + step
        is_open = max(min(end, self._duty) - self._phase, 0.0)
        if end >= 1.0:
            end -= 1.0
            self._duty = duty
            is_open += min(end, duty)
        self._phase = end
        return is_open / step

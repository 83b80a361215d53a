"""The dosing controller: holds the pressure by the pump's speed and doses by the valve's duty cycle.

A PI controller on its own pressure sensor, with conditional integration against wind-up, run every 20 ms. Dosing is cut
when the pressure has collapsed and returns when it has recovered (thesis fig. 5.9). Without its pressure sensor it
stops pump and dosing.
"""

import math
from dataclasses import dataclass

from faultline.testbench.units import ATMOSPHERE, BAR

PERIOD = 0.02  # s, a usual task of such a controller

# The hose integrates the pump's flow: 0.1 mL/rev on 0.35 mL/bar, 0.29 bar/s per rev/s. A gain of 6 rev/s/bar closes the
# loop at 1.7 rad/s; the integral time gives a damping of 0.8. Faster would follow the dosing valve's pulses.
GAIN = 6.0 / BAR  # rev/s/Pa
INTEGRAL_TIME = 1.6  # s
MAXIMUM_SPEED = 60.0  # rev/s, the motor's limit, nearly twice the speed at maximum dose
SETPOINT_RATE = 1.0 * BAR  # Pa/s: the hoses are pressurised in about ten seconds
CUT_BELOW = 7.0 * BAR  # Pa absolute: the spray no longer breaks up
RESUME_WITHIN = 0.3 * BAR  # Pa below the setpoint


@dataclass(frozen=True)
class Command:
    """What the controller orders: pump speed [rev/s] and duty cycle of the dosing valve [0..1]."""

    speed: float
    duty: float


class Ecu:
    """State: the ramped setpoint [Pa], the integral [rev/s], and whether dosing is allowed."""

    def __init__(self) -> None:
        self._setpoint = 0.0
        self._integral = 0.0
        self._may_dose = False

    def update(self, y_p_du: float, setpoint: float | None, request: float) -> Command:
        """One period: measured pressure [Pa], wanted pressure [Pa] (None: pump off) and dose [0..1] to commands."""
        if setpoint is None or not math.isfinite(y_p_du):  # blind, it stops rather than guess
            y_p_du = y_p_du if math.isfinite(y_p_du) else ATMOSPHERE
            self._setpoint, self._integral, self._may_dose = y_p_du, 0.0, False
            return Command(0.0, 0.0)
        change = SETPOINT_RATE * PERIOD
        self._setpoint += min(max(setpoint - self._setpoint, -change), change)
        error = self._setpoint - y_p_du
        wanted = GAIN * error + self._integral
        speed = min(max(wanted, 0.0), MAXIMUM_SPEED)
        if speed == wanted or (wanted > speed) != (error > 0.0):
            self._integral += GAIN * error * PERIOD / INTEGRAL_TIME
        if self._may_dose:
            self._may_dose = y_p_du > CUT_BELOW
        else:
            self._may_dose = y_p_du > max(setpoint - RESUME_WITHIN, CUT_BELOW)
        return Command(speed, request if self._may_dose else 0.0)

"""The pump: positive displacement with an internal leak and a relief valve, and the drive that turns it.

    q = D n filling(p_bp) - L (p_ap - p_bp) - relief(p_ap)       slot leakage is laminar: linear in the pressure
    2 pi J dn/dt = T - D (p_ap - p_bp) / (2 pi eta) - b n        T from a speed controller, limited

D [m^3/rev], n [rev/s], L [m^3/(s Pa)], J [kg m^2], T [N m]. Source: J. Ivantysyn, M. Ivantysynova, Hydrostatic Pumps
and Motors (2001), chapter on losses.
"""

from dataclasses import dataclass
from math import pi


@dataclass(frozen=True)
class PumpParameters:
    """Displacement, losses, filling and drive of the pump."""

    displacement: float = 0.1e-6  # m^3/rev: 21 rev/s idle and 33 at maximum dose, a quiet small motor
    # m^3/(s Pa): 5 % of the idle flow of 2.1 mL/s at the 9 bar across the pump.
    leakage: float = 0.05 * 2.1e-6 / 8.987e5
    slip: float = 0.0  # m^3/(s Pa^1.5): flow through gaps that the pressure widens
    unfilled: float = 0.0  # s^2/rev^2: chambers fill to 1 / (1 + unfilled n^2)
    # Pa absolute, thesis 4.2: a relief valve in the pump protects the parts; no cycle gets there while all is healthy.
    relief_pressure: float = 13.5e5
    relief_slope: float = 6e-11  # m^3/(s Pa): what the pump delivers at full speed within 1 bar, a short stiff spring
    # Pa absolute: chambers fill partly below `fills_above` and not at all at the vapour pressure of the solution (about
    # 2 kPa at 20 degC, and dissolved air comes out earlier). Far below what a healthy suction side reaches.
    fills_above: float = 25e3
    vapour: float = 5e3
    inertia: float = 5e-6  # kg m^2: rotor of a 30 W brushless motor with the eccentric
    mechanical_efficiency: float = 0.8  # small pumps: 0.7 to 0.9
    friction: float = 2e-5  # N m s/rev, bearings and shaft seal: 2 % of the load at 10 bar and 20 rev/s
    maximum_torque: float = 0.06  # N m: three times the load at 10 bar
    # The speed controller, laid out for about 3 Hz: stiff against the load, slow against the commutation.
    speed_gain: float = 6e-4  # N m s/rev
    speed_integral: float = 6e-3  # N m/rev

    def displaced(self, speed: float) -> float:
        """What full chambers would carry [m^3/s] at `speed` [rev/s]."""
        return self.displacement * speed / (1.0 + self.unfilled * speed * speed)

    def back(self, p_bp: float, p_ap: float, viscosity: float) -> float:
        """What flows back [m^3/s] from outlet to inlet [Pa]; `viscosity` is relative."""
        pressure = p_ap - p_bp
        back = self.leakage * pressure / viscosity
        if self.slip:
            back += self.slip * pressure * abs(pressure) ** 0.5
        if p_ap > self.relief_pressure:
            back += self.relief_slope * (p_ap - self.relief_pressure)
        return back

    def drawn(self, displaced: float, p_bp: float) -> tuple[float, float]:
        """The drawn flow as a + b p_bp around the inlet pressure `p_bp` [Pa]: (a [m^3/s], b [m^3/(s Pa)]).

        Below the vapour pressure the line goes on: no flow settles there, and the solver needs its slope.
        """
        if p_bp >= self.fills_above:
            return displaced, 0.0
        slope = displaced / (self.fills_above - self.vapour)
        return -slope * self.vapour, slope


class Drive:
    """The motor with its speed controller. State: speed [rev/s] and the controller's integral [N m].

    `torque` is the part of its largest torque that it has.
    """

    def __init__(self, parameters: PumpParameters) -> None:
        self.speed = 0.0
        self.torque = 1.0
        self._integral = 0.0
        self._pump = parameters
        self._turn, self._inertia = 2 * pi * parameters.mechanical_efficiency, 2 * pi * parameters.inertia

    def step(self, h: float, command: float, pressure: float) -> float:
        """The speed after `h` [s] with speed command `command` [rev/s] against `pressure` [Pa] across the pump."""
        pump = self._pump
        if command > 0.0:
            error = command - self.speed
            wanted = pump.speed_gain * error + self._integral
            torque = 0.0 if wanted < 0.0 else min(wanted, self.torque * pump.maximum_torque)
            if torque == wanted:  # else the integral would wind up
                self._integral += h * pump.speed_integral * error
        else:
            torque = self._integral = 0.0
        load = pump.displacement * pressure / self._turn + pump.friction * self.speed
        speed = self.speed + h * (torque - load) / self._inertia
        self.speed = max(speed, 0.0)  # the chambers' check valves do not let it turn back
        return self.speed

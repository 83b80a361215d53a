"""The pump's flow ripple as the sensor between the filters feels it.

    tank -[R_t]- p_tp -[R_p]- p_bp - i sin(w t)        C_tp at p_tp, C_bp at p_bp

The chambers draw in pulses: at p_bp acts a source of flow i, a fixed part of the flow that the pump draws. For small
pulsations a filter is its differential resistance R + 2 K |q|, so that an RC ladder is left; the amplitude at p_tp is

    |p_tp| = i / |Y_t + j w C_bp (1 + R_p Y_t)|,    Y_t = 1 / R_t + j w C_tp

A clogged pump filter has a larger R_p, and p_tp gets quieter (thesis 7.4). Source: hydraulic networks as electrical
ones, as in J. Ivantysyn, M. Ivantysynova, Hydrostatic Pumps and Motors (2001), chapter on pulsations.
"""

from math import pi

import numpy as np

from faultline.testbench.plant import Array, Plant
from faultline.testbench.sensors import STANDSTILL
from faultline.testbench.units import MBAR
from faultline.testbench.vehicles import Vehicle

PULSES = 6  # a revolution: three chambers; an odd number of chambers ripples twice as often as it has chambers
RATED_SPEED = 33.0  # rev/s, at maximum dose


def felt(R_t: float, R_p: float, C_t: float, C_b: float, w: float) -> float:
    """The amplitude at p_tp [Pa] for a source of 1 m^3/s: resistances [Pa s/m^3], compliances [m^3/Pa], w [rad/s]."""
    Y = 1.0 / R_t + 1j * w * C_t
    return 1.0 / abs(Y + 1j * w * C_b * (1.0 + R_p * Y))


def pulse(phases: Array) -> Array:
    """The ripple in parts of its amplitude at `phases` (n,) [0..1): a reading has any, its clock knows no pump."""
    return np.asarray(np.sin(2 * pi * phases))


class Pulsation:
    """Of one vehicle: `size` [mbar] is the amplitude at p_tp at rated flow and speed, its filters clean."""

    def __init__(self, vehicle: Vehicle, size: float) -> None:
        self._parameters, plant = vehicle.plant, vehicle.plant
        flow, w = vehicle.rated_flow, 2 * pi * PULSES * RATED_SPEED
        R_t, R_p = (f.R + 2.0 * f.K * flow for f in (plant.tank_filter, plant.pump_filter))
        self._part = size * MBAR / (flow * felt(R_t, R_p, plant.compliance_tp, plant.compliance_bp, w))

    def amplitude(self, plant: Plant, speed: float) -> float:
        """The amplitude at p_tp [Pa] now, at pump speed `speed` [rev/s]; 0 at standstill."""
        if self._part == 0.0 or speed <= STANDSTILL or plant.q_pump <= 0.0:
            return 0.0
        tank, pump, parameters = plant.tank_filter, plant.pump_filter, self._parameters
        R_t = plant.viscosity * tank.R + 2.0 * tank.K * abs(plant.q_tank)
        R_p = plant.viscosity * pump.R + 2.0 * pump.K * abs(plant.q_pump_filter)
        w = 2 * pi * PULSES * speed
        return self._part * plant.q_pump * felt(R_t, R_p, parameters.compliance_tp, parameters.compliance_bp, w)

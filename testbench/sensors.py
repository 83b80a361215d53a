"""Sensors: true value to what is read, by noise, range and resolution.

Noise is white and Gaussian: at 5 to 10 Hz a sensor's own dynamics (milliseconds) do not show.
"""

import math
from dataclasses import dataclass

import numpy as np

from faultline.testbench.plant import Array
from faultline.testbench.units import ATMOSPHERE, BAR, MBAR

STANDSTILL = 0.1  # rev/s: no edges of the hall sensor arrive within its time-out


@dataclass(frozen=True)
class EcuSensors:
    """The controller's own sensors: p_du through a 12 bit converter, speed from hall edges."""

    noise_p_du: float = 10 * MBAR  # Pa, sd: 0.06 % of the range, an automotive sensor
    noise_n_p: float = 0.05  # rev/s, sd: jitter of the edges at 30 rev/s
    range_p_du: float = 16 * BAR  # Pa: above the relief pressure of 13.5 bar (thesis 4.2)
    bits: int = 12  # usual microcontroller
    lag_p_du: float = 0.0  # s, time constant
    backlash_p_du: float = 0.0  # Pa, the band within which the membrane sticks
    scale_n_p: float = 1.0  # what is read of the true speed

    def p_du(self, true: float, noise: float) -> float:
        """The reading [Pa] of `true` [Pa] with `noise` in standard deviations."""
        step = self.range_p_du / (1 << self.bits)
        count = round((true + self.noise_p_du * noise) / step)
        return min(max(count, 0), (1 << self.bits) - 1) * step

    def n_p(self, true: float, noise: float) -> float:
        """The reading [rev/s] of `true` [rev/s] with `noise` in standard deviations; 0 at standstill."""
        return max(self.scale_n_p * true + self.noise_n_p * noise, 0.0) if true > STANDSTILL else 0.0


class Membrane:
    """How the pressure reaches the dosing unit's sensor. State: the pressure that it feels [Pa], once it felt any.

    `fouled` [s] is what its time constant has more than when it was new.
    """

    def __init__(self, sensors: EcuSensors, period: float) -> None:
        self._lag, self._period = sensors.lag_p_du, period
        self.fouled = 0.0
        self._band = sensors.backlash_p_du / 2
        self._slow = self._felt = math.nan

    def feel(self, true: float) -> float:
        """What it feels [Pa] one period later, at the pressure `true` [Pa]."""
        if math.isnan(self._felt):
            self._slow = self._felt = true
        lag = self._lag + self.fouled
        self._slow += (1.0 - math.exp(-self._period / lag) if lag else 1.0) * (true - self._slow)
        self._felt = min(max(self._felt, self._slow - self._band), self._slow + self._band)
        return self._felt


@dataclass(frozen=True)
class ExternalSensor:
    """An added pressure transmitter, read in volts by the second logger.

    `volts` and `pascal` are its datasheet's table; `zero_sd` [Pa] is the spread of the error that mounting and ageing
    leave, constant over a recording.
    """

    column: str
    volts: tuple[float, ...]
    pascal: tuple[float, ...]
    noise: float
    zero_sd: float
    bits: int = 14  # over 0..5 V, a usual data logger: steps of 0.2 mbar and 1.2 mbar, below the noise
    gain: float = 1.0  # of what is above atmospheric pressure

    def read(self, true: Array, offset: Array | float, rng: np.random.Generator) -> Array:
        """Volts for the true pressures `true` (n,) [Pa] with an added `offset` [Pa]."""
        zero = self.zero_sd * rng.standard_normal()
        return self.convert(true, offset + zero + self.noise * rng.standard_normal(len(true)))

    def convert(self, true: Array, error: Array | float) -> Array:
        """Volts for the true pressures `true` (n,) [Pa] felt with an `error` [Pa]."""
        seen = true + (self.gain - 1.0) * (true - ATMOSPHERE) + error
        step = 5.0 / 2**self.bits
        return np.asarray(np.round(np.interp(seen, self.pascal, self.volts) / step) * step)

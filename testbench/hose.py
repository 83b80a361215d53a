"""The hose after the pump: how much it takes in for a rise of pressure.

    C(p) = C0 exp(-s (p - p0) / p0) + V p_atm / p^2       rubber that stiffens; free air V in it (Boyle, isothermal)

Source: for the air, the isothermal limit of H. Gholizadeh, R. Burton, G. Schoenau, Fluid bulk modulus: comparison of
low pressure models (International Journal of Fluid Power, 2012); the exponential is a plain choice of ours.
"""

from dataclasses import dataclass
from math import exp

from faultline.testbench.units import ATMOSPHERE, BAR

RATED = 10 * BAR


@dataclass(frozen=True)
class Hose:
    """`rated` [m^3/Pa] at 10 bar, `stiffening` (s above, a number), free `air` [m^3] at atmospheric pressure."""

    rated: float
    stiffening: float = 0.0
    air: float = 0.0

    def compliance(self, p: float) -> float:
        """dV/dp [m^3/Pa] at `p` [Pa absolute]."""
        found = self.rated
        if self.stiffening:
            found *= exp(-self.stiffening * (p - RATED) / RATED)
        if self.air:
            found += self.air * ATMOSPHERE / (p * p)
        return found

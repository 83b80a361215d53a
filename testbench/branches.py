"""What may hang on the hose after the pump besides the dosing unit, each with the flow a + b p that it takes."""

from typing import Protocol

from faultline.testbench.restriction import Restriction
from faultline.testbench.units import ATMOSPHERE

SLIGHT_FLOW = 1e-9  # m^3/s: below this the tangent of an orifice is no help


class Branch(Protocol):
    """Takes flow out of the hose."""

    def linear(self, h: float, p: float) -> tuple[float, float]:
        """The flow in the step of `h` [s] from pressure `p` [Pa] on as a + b p_new: (a [m^3/s], b [m^3/(s Pa)])."""

    def took(self, h: float, flow: float) -> None:
        """Tells the flow [m^3/s] of the step, when its end is known."""


class Leak:
    """A hole to the surroundings: an orifice."""

    def __init__(self, hole: Restriction) -> None:
        self.hole = hole

    def linear(self, h: float, p: float) -> tuple[float, float]:
        """The tangent at `p`; a step changes the pressure little."""
        del h
        R, K, drop = self.hole.R, self.hole.K, p - ATMOSPHERE
        size = ((R * R + 4.0 * K * abs(drop)) ** 0.5 - R) / (2.0 * K)
        slope = 1.0 / (R + 2.0 * K * max(size, SLIGHT_FLOW))
        return (size if drop > 0.0 else -size) - slope * p, slope

    def took(self, h: float, flow: float) -> None:
        """A hole remembers nothing."""


class Relief:
    """A spring-loaded valve: opens above `cracks_at` [Pa] and then passes `slope` [m^3/(s Pa)]."""

    def __init__(self, cracks_at: float, slope: float) -> None:
        self.cracks_at, self.slope = cracks_at, slope

    def linear(self, h: float, p: float) -> tuple[float, float]:
        """Open or shut for the whole step."""
        del h
        return (-self.slope * self.cracks_at, self.slope) if p > self.cracks_at else (0.0, 0.0)

    def took(self, h: float, flow: float) -> None:
        """Neither does a spring."""


class Creep:
    """Rubber that goes on widening: it takes in `compliance` [m^3/Pa] with the time constant `tau` [s] (Kelvin).

    State: the volume stored [m^3], zero at atmospheric pressure.
    """

    def __init__(self, compliance: float, tau: float) -> None:
        self.compliance, self.tau, self.stored = compliance, tau, 0.0

    def linear(self, h: float, p: float) -> tuple[float, float]:
        """Backward Euler of tau dV/dt = C (p - p_atm) - V."""
        del p
        slope = self.compliance / (self.tau + h)
        return -slope * ATMOSPHERE - self.stored / (self.tau + h), slope

    def took(self, h: float, flow: float) -> None:
        """Stores it."""
        self.stored += h * flow

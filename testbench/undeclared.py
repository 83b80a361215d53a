"""Faults that no diagnosis model declares: what a vehicle may have besides the nine of the thesis.

Each is present from its onset on, as any fault, and says what its size means. What a diagnosis should say of them is
that the fault is unknown.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from faultline.testbench.branches import Relief
from faultline.testbench.plant import Plant, PlantParameters
from faultline.testbench.pump import Drive, PumpParameters
from faultline.testbench.restriction import TURBULENT, Restriction
from faultline.testbench.sensors import Membrane
from faultline.testbench.units import BAR, ML
from faultline.testbench.valve import Needle, PulseWidth

SUCTION = 0.1 * BAR
"""Below atmospheric pressure, at which a hole in the suction pipe is rated [Pa]."""
LATE = 0.03
"""By how much the valve's needle is later without any supply voltage, in proportion before [s]."""


class Acting(Protocol):
    """A fault with a name and a size at each time (`testbench.faults.Fault`)."""

    @property
    def name(self) -> str:
        """Its name."""

    def strength(self, t: float) -> float:
        """Return its size at `t` [s]."""


@dataclass(frozen=True)
class Undeclared:
    """One of them: what it is, what its size means, in which unit, one that shows, a severe one and the largest."""

    text: str
    meaning: str
    unit: str
    shows: float
    severe: float
    largest: float


UNDECLARED = {
    "air_tp": Undeclared(
        "air is drawn in between the filters", "mL/s of air at 0.1 bar of suction", "mL/s", 0.1, 1.0, 3.0
    ),
    "air_hose": Undeclared("free air in the hose", "mL at atmospheric pressure", "mL", 20.0, 60.0, 100.0),
    "return_kinked": Undeclared("return line kinked behind its orifice", "bar behind it", "bar", 0.5, 3.0, 6.0),
    "return_worn": Undeclared("return orifice worn", "fraction of the area gained", "1", 0.05, 0.5, 2.0),
    "nozzle_worn": Undeclared("dosing nozzle worn", "fraction of the area gained", "1", 0.05, 0.5, 2.0),
    "valve_open": Undeclared(
        "dosing valve does not shut", "fraction of its opening that stays, 0..1", "1", 0.03, 0.4, 1.0
    ),
    "inlet_sticks": Undeclared("inlet valve of the dosing unit sticks", "bar that open it", "bar", 0.1, 0.5, 2.0),
    "relief_low": Undeclared("relief valve opens too early", "bar below its 13.5", "bar", 3.7, 4.5, 6.0),
    "fluid": Undeclared("another fluid in the tank", "fraction of the density missing, 0..1", "1", 0.09, 0.25, 0.5),
    "supply_low": Undeclared(
        "supply voltage low: motor weak, valve late", "fraction of the voltage missing, 0..1", "1", 0.3, 0.75, 0.9
    ),
    "swapped": Undeclared("plugs of p_ap and p_du swapped", "1: from then on", "1", 1.0, 1.0, 1.0),
    "slow_p_du": Undeclared("membrane of p_du fouled: sensor slow", "time constant in s", "s", 0.5, 3.0, 10.0),
}


def swapped(faults: Sequence[Acting], t: float) -> bool:
    """Return True if at `t` [s] the plugs of the two sensors after the pump are swapped."""
    return any(fault.name == "swapped" and fault.strength(t) > 0.0 for fault in faults)


class Disturbances:
    """The parts of a run that these faults change; each is as the vehicle has it while none is there."""

    def __init__(self, faults: Sequence[Acting], pump: PumpParameters, needle: Needle) -> None:
        self._faults = [fault for fault in faults if fault.name in UNDECLARED]
        self._pump, self._needle = pump, needle

    def apply(
        self, plant: Plant, healthy: PlantParameters, drive: Drive, valve: PulseWidth, membrane: Membrane, t: float
    ) -> None:
        """Set all parts as they are at `t` [s]; what surrounds the plant was set for this time before."""
        if not self._faults:
            return
        size = dict.fromkeys(UNDECLARED, 0.0)
        for fault in self._faults:
            size[fault.name] += fault.strength(t)
        hole = size["air_tp"] * ML
        plant.air_hole = Restriction.rated(SUCTION, hole, TURBULENT) if hole else None
        plant.hose = replace(healthy.hose, air=healthy.hose.air + size["air_hose"] * ML)
        plant.p_return += size["return_kinked"] * BAR
        plant.inlet_spring += size["inlet_sticks"] * BAR
        self._widen(plant, size)
        plant.density = 1.0 - size["fluid"]
        plant.branches = [branch for branch in plant.branches if not isinstance(branch, _Early)]
        if size["relief_low"]:
            plant.branches.append(
                _Early(self._pump.relief_pressure - size["relief_low"] * BAR, self._pump.relief_slope)
            )
        drive.torque = 1.0 - size["supply_low"]
        valve.needle = replace(self._needle, opens_after=self._needle.opens_after + LATE * size["supply_low"])
        valve.stuck = size["valve_open"]
        membrane.fouled = size["slow_p_du"]

    def _widen(self, plant: Plant, size: dict[str, float]) -> None:
        """Make what has worn wider; surroundings and clogging have set both for this time."""
        if size["return_worn"]:
            plant.return_orifice = plant.return_orifice.blocked(-size["return_worn"])
        if size["nozzle_worn"]:
            plant.dosing_valve = plant.dosing_valve.blocked(-size["nozzle_worn"])


class _Early(Relief):
    """A relief valve that is a fault, and not a hidden effect."""

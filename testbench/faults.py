"""Faults by name, size and onset: the nine of the thesis (section 4.7), sensors that are off, and undeclared ones."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from faultline.testbench.branches import Leak
from faultline.testbench.bus import ERROR, NOT_AVAILABLE
from faultline.testbench.errors import RigError
from faultline.testbench.plant import SYSTEM_PRESSURE, Plant, PlantParameters
from faultline.testbench.restriction import TURBULENT, Restriction
from faultline.testbench.undeclared import UNDECLARED
from faultline.testbench.units import ATMOSPHERE, ML

RESTRICTIONS = {
    "fA_t": "tank_filter",
    "fA_p": "pump_filter",
    "fA_du": "du_filter",
    "fA_ori": "return_orifice",
    "fA_dos": "dosing_valve",
}
"""The restriction that each of the five clogging faults narrows."""

_AREA, _FLOW, _PASCAL = "fraction of the area lost, 0..1", "fraction of the flow lost, 0..1", "Pa added to the reading"
_LEAK = "mL/s that flow out at 10 bar"
_SILENT = "1: its messages say not available, 2: they say error"
_WIRE = "1: its wire is off (0 V; on CAN not available), 2: shorted to the supply (5 V; on CAN error)"

FAULTS = {
    "fA_t": ("tank filter clogged", _AREA),
    "fA_p": ("pump filter clogged", _AREA),
    "fA_du": ("dosing unit's inlet filter clogged", _AREA),
    "fA_ori": ("return orifice clogged", _AREA),
    "fA_dos": ("dosing nozzle clogged", _AREA),
    "fq_pump": ("pump delivers less", _FLOW),
    "fy_p_tp": ("sensor between the filters reads wrong", _PASCAL),
    "fy_p_ap": ("sensor after the pump reads wrong", _PASCAL),
    "fy_p_du": ("sensor in the dosing unit reads wrong", _PASCAL),
    "off_p_du": ("sensor in the dosing unit is off", _SILENT),
    "off_n_p": ("speed sensor is off", _SILENT),
    "off_p_tp": ("sensor between the filters is off", _WIRE),
    "off_p_ap": ("sensor after the pump is off", _WIRE),
    "leak_ap": ("leak after the pump, which no fault of the diagnosis model covers", _LEAK),
    **{name: (each.text, each.meaning) for name, each in UNDECLARED.items()},
}
"""Name of each fault: what it is, and what its size means."""

UNITS = {_AREA: "1", _FLOW: "1", _PASCAL: "Pa", _LEAK: "mL/s"} | {
    each.meaning: each.unit for each in UNDECLARED.values()
}
"""Of what a size means; a kind has none."""

LARGEST_LOSS = 0.98
"""Beyond this a restriction is a plug and a pump is stopped: neither is a fault of this kind."""
LARGEST_OFFSET = 5e5  # Pa, half the system pressure: beyond it the controller could not run at all
LARGEST_LEAK = 5.0  # mL/s: more than the pump delivers

CODES = {1.0: NOT_AVAILABLE, 2.0: ERROR}
"""What a controller or the sensor box has instead of a value, by the size of the fault that takes it away."""

Course = Literal["abrupt", "growing", "intermittent"]
GROWTH_S = 120.0
"""A growing fault has its size this long after its onset [s]: several doses later, and well within a recording."""
ON_S, PERIOD_S = 20.0, 60.0
"""An intermittent fault is there for so long in each period [s]: longer than a dose, gone before most are told."""


def limit(name: str) -> float:
    """The largest size of fault `name`."""
    if name in UNDECLARED:
        return UNDECLARED[name].largest
    return {_PASCAL: LARGEST_OFFSET, _LEAK: LARGEST_LEAK, _SILENT: max(CODES), _WIRE: max(CODES)}.get(
        FAULTS[name][1], LARGEST_LOSS
    )


@dataclass(frozen=True)
class Fault:
    """One fault: `size` as `FAULTS` says, present from `onset_s` [s after the first frame of the CAN log] on.

    It is there at once and for good (abrupt), grows in proportion to the time (growing), or comes and goes
    (intermittent).

    Raises:
        RigError: unknown name, or a size outside its range.
    """

    name: str
    size: float
    onset_s: float
    profile: Course = "abrupt"

    def __post_init__(self) -> None:
        if self.name not in FAULTS:
            raise RigError(f"there is no fault {self.name!r}; choose one of {', '.join(FAULTS)}")
        self._check_size(FAULTS[self.name][1])
        if self.profile not in get_args(Course):
            raise RigError(f"profile {self.profile!r} of {self.name} is not known; use {', '.join(get_args(Course))}")
        if FAULTS[self.name][1] in (_SILENT, _WIRE) and self.profile == "growing":
            raise RigError(f"profile growing of {self.name}: a sensor is on or off; use abrupt or intermittent")

    def _check_size(self, meaning: str) -> None:
        if meaning == _PASCAL:
            if not 0 < abs(self.size) <= LARGEST_OFFSET:
                raise RigError(
                    f"size {self.size:g} of {self.name} is not within +-{LARGEST_OFFSET:.0f} Pa and other than 0"
                )
        elif meaning in (_SILENT, _WIRE):
            if self.size not in CODES:
                raise RigError(f"size {self.size:g} of {self.name} is neither 1 nor 2 ({meaning})")
        elif not 0 < self.size <= limit(self.name):
            raise RigError(f"size {self.size:g} of {self.name} is not in 0..{limit(self.name):g} ({meaning})")

    def strength(self, t: float) -> float:
        """The fault's size at `t` [s], 0 before its onset."""
        since = t - self.onset_s
        if since < 0.0:
            return 0.0
        if self.profile == "growing":
            return self.size * min(since / GROWTH_S, 1.0)
        if self.profile == "intermittent":
            return self.size if math.fmod(since, PERIOD_S) < ON_S else 0.0
        return self.size


def strength(faults: Sequence[Fault], name: str, t: float) -> float:
    """The size of fault `name` at `t` [s], 0 where there is none."""
    return sum(fault.strength(t) for fault in faults if fault.name == name)


def reading(faults: Sequence[Fault], signal: str, value: float, t: float) -> float:
    """What a controller or the sensor box knows of `signal` at `t` [s]: the value, or why there is none."""
    code = strength(faults, f"off_{signal}", t)
    return CODES[code] if code else value


def apply(faults: Sequence[Fault], plant: Plant, healthy: PlantParameters, t: float) -> None:
    """Gives the plant the restrictions and the pump of time `t` [s]; sensor faults are the sensors' own matter."""
    for fault in faults:
        if fault.name in RESTRICTIONS:
            part = RESTRICTIONS[fault.name]
            setattr(plant, part, getattr(healthy, part).blocked(fault.strength(t)))
        elif fault.name == "fq_pump":
            plant.pump_loss = fault.strength(t)
        elif fault.name == "leak_ap":
            _leak(plant, fault.strength(t))


def _leak(plant: Plant, size: float) -> None:
    """The fault's leak is the last branch, and there only while it leaks."""
    plant.branches = [branch for branch in plant.branches if not isinstance(branch, Leaking)]
    if size > 0.0:
        plant.branches.append(Leaking(Restriction.rated(SYSTEM_PRESSURE - ATMOSPHERE, size * ML, TURBULENT)))


class Leaking(Leak):
    """A leak that is a fault, and not a hidden effect."""

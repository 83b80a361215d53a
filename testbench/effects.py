"""Hidden effects: physics that a diagnosis model of turbulent orifices lacks, each a switch with a size.

What each does is written here and in the parts that it changes, in forms of the rig's own. Set A is for development;
set B is run once, after a commit that says so, for the figures that are reported.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from faultline.testbench.branches import Branch, Creep, Leak, Relief
from faultline.testbench.day import CALM, Day
from faultline.testbench.errors import RigError
from faultline.testbench.plant import SYSTEM_PRESSURE, Plant, PlantParameters
from faultline.testbench.restriction import TURBULENT, Restriction
from faultline.testbench.units import ATMOSPHERE, BAR, MBAR, ML
from faultline.testbench.valve import Needle
from faultline.testbench.vehicles import Vehicle

LITRE = 1000 * ML
RATED_SPEED = 33.0  # rev/s, at maximum dose
CREEP_TIME = 5.0  # s, rubber after a step; longer than the loop's second, shorter than a dose of ten
WARM_UP_TIME = 600.0  # s, some litres of fluid beside a heated hose
LEVEL_TIME = 1800.0  # s, so that a recording of minutes shows a part of it, one of hours all
EXHAUST_SWING = 40.0  # s, period of the exhaust's pressure: a truck on hills, and no simple ratio to any cycle
ORIFICE_SHARE = 1 / 6  # a bore is less laminar than a filter


@dataclass(frozen=True)
class Effect:
    """One effect: what its size means, a size that logs plainly show, and the largest that still makes sense."""

    text: str
    unit: str
    typical: float
    largest: float
    set: Literal["A", "B"]


EFFECTS: dict[str, Effect] = {
    "laminar_filters": Effect("laminar share of the filters' drop at rated flow", "0..1", 0.4, 1.0, "A"),
    "full_lift": Effect("more flow through the dosing valve when it is held open", "fraction", 0.17, 0.5, "A"),
    "opening_delay": Effect("the dosing valve opens late", "s", 0.012, 0.05, "A"),
    "closing_delay": Effect("the dosing valve shuts late", "s", 0.012, 0.05, "A"),
    "entrained_air": Effect("free air in the hose, at atmospheric pressure", "mL", 15.0, 60.0, "A"),
    "stiff_hose": Effect("the hose stiffens with pressure: exponent for 10 bar", "1", 0.8, 3.0, "A"),
    "pump_slip": Effect("gaps in the pump that the pressure widens: flow lost at 10 bar", "mL/s", 0.15, 1.0, "A"),
    "incomplete_filling": Effect("displacement lost at 33 rev/s, growing with the speed", "0..1", 0.08, 0.4, "A"),
    "relief_valve": Effect("a relief valve that cracks at 9.7 bar: flow a bar above", "mL/s", 0.4, 3.0, "A"),
    "viscosity_drift": Effect("laminar parts grow by this over some ten minutes", "fraction", 1.0, 4.0, "A"),
    "cake_growth": Effect("drop of the dosing unit's filter grows with each litre", "fraction", 0.5, 4.0, "A"),
    "sensor_lag": Effect("the dosing unit's pressure sensor is slow: time constant", "s", 0.4, 1.5, "A"),
    "log_delay": Effect("what the controller says is old", "s", 0.3, 1.5, "A"),
    "suction_pulsation": Effect(
        "the pump's flow ripple at the sensor between the filters: amplitude at rated flow, pump filter clean",
        "mbar",
        10.0,
        40.0,
        "A",
    ),
    "leak": Effect("leak after the pump, at 10 bar", "mL/s", 0.15, 1.0, "B"),
    "creeping_hose": Effect("hose compliance that follows within seconds, of the rated one", "fraction", 0.6, 3.0, "B"),
    "back_pressure": Effect("exhaust behind the nozzle, swinging by half", "bar", 0.3, 2.0, "B"),
    "falling_level": Effect("head lost in the tank within half an hour", "mbar", 20.0, 100.0, "B"),
    "blocked_vent": Effect("suction in the tank for each decilitre dosed", "mbar", 30.0, 200.0, "B"),
    "inlet_spring": Effect("the dosing unit's inlet valve needs this to open", "bar", 0.1, 0.5, "B"),
    "sensor_gain": Effect("the sensor after the pump reads more", "fraction", 0.02, 0.1, "B"),
    "sensor_backlash": Effect("the dosing unit's pressure sensor sticks within this band", "bar", 0.1, 0.5, "B"),
    "speed_scale": Effect("the pump turns faster than it says", "fraction", 0.03, 0.1, "B"),
    "worn_return": Effect("the return orifice widens, each hour", "fraction", 0.1, 1.0, "B"),
    "nozzle_deposit": Effect("the dosing nozzle narrows with each decilitre dosed", "fraction", 0.1, 0.5, "B"),
}

PROFILES: dict[str, dict[str, float]] = {
    "ideal": {},
    # Filters and bores have some laminar part (Ergun 1952; Idelchik 1986).
    "realistic": {"laminar_filters": 0.06},
    # The same, and every recording has a day of its own (`day.py`).
    "everyday": {"laminar_filters": 0.06},
}
"""What is always there: `ideal` lies inside the diagnosis model's family, the others do not."""

PROFILE_TEXTS = {
    "ideal": "none: inside the diagnosis model's family",
    "realistic": "filters and bores have some laminar part",
    "everyday": "realistic, and every recording has its day: viscosity sd 5 %, zeros of y_p_tp, y_p_ap, y_p_du "
    "sd 1, 3, 3 mbar, tank level sd 5 mbar",
}


def checked(effects: Mapping[str, float]) -> dict[str, float]:
    """The effects in the catalogue's order; raises `RigError` for an unknown one, or a size out of range."""
    for name, size in effects.items():
        if name not in EFFECTS:
            raise RigError(f"there is no effect {name!r}; choose one of {', '.join(EFFECTS)}")
        effect = EFFECTS[name]
        if not 0.0 < size <= effect.largest:
            raise RigError(f"size {size:g} of {name} is not in 0..{effect.largest:g} {effect.unit}, 0 excluded")
    return {name: effects[name] for name in EFFECTS if name in effects}


def fitted(vehicle: Vehicle, effects: Mapping[str, float]) -> Vehicle:
    """The vehicle with the effects that are part of it; those that change with time are `Surroundings`."""
    size = dict.fromkeys(EFFECTS, 0.0) | dict(effects)
    plant, pump = vehicle.plant, vehicle.pump
    laminar, unfilled = size["laminar_filters"], size["incomplete_filling"]
    filters = {
        name: getattr(plant, name).rebalanced(laminar, vehicle.rated_flow)
        for name in ("tank_filter", "pump_filter", "du_filter")
    }
    bores = {
        name: getattr(plant, name).rebalanced(laminar * ORIFICE_SHARE, flow)
        for name, flow in (("return_orifice", vehicle.return_flow), ("dosing_valve", vehicle.dose_flow))
    }
    rise = SYSTEM_PRESSURE - ATMOSPHERE
    hose = replace(plant.hose, stiffening=size["stiff_hose"], air=size["entrained_air"] * ML)
    branches = [*vehicle.branches]
    if size["leak"]:
        hole = Restriction.rated(rise, size["leak"] * ML, TURBULENT)
        branches.append(lambda: Leak(hole))
    if size["relief_valve"]:
        slope = size["relief_valve"] * ML / BAR
        branches.append(lambda: Relief(9.7 * BAR, slope))
    if size["creeping_hose"]:
        compliance = size["creeping_hose"] * hose.rated
        branches.append(lambda: Creep(compliance, CREEP_TIME))
    after_pump = vehicle.external["y_p_ap"]
    return replace(
        vehicle,
        plant=replace(plant, **filters, **bores, hose=hose),
        pump=replace(
            pump,
            slip=size["pump_slip"] * ML / rise**1.5,
            unfilled=unfilled / (1.0 - unfilled) / RATED_SPEED**2,
        ),
        needle=Needle(size["opening_delay"], size["closing_delay"], size["full_lift"]),
        branches=tuple(branches),
        ecu_sensors=replace(
            vehicle.ecu_sensors,
            lag_p_du=size["sensor_lag"],
            backlash_p_du=size["sensor_backlash"] * BAR,
            scale_n_p=1.0 / (1.0 + size["speed_scale"]),
        ),
        external={**vehicle.external, "y_p_ap": replace(after_pump, gain=1.0 + size["sensor_gain"])},
        log_delay=size["log_delay"],
    )


class Surroundings:
    """What changes while the rig runs. State: what has gone through filter and nozzle [m^3]."""

    def __init__(self, effects: Mapping[str, float], day: Day = CALM) -> None:
        self._size, self._day = dict.fromkeys(EFFECTS, 0.0) | dict(effects), day
        self._filtered = self._dosed = 0.0

    def step(self, plant: Plant, healthy: PlantParameters, t: float, h: float) -> PlantParameters:
        """Sets the plant's surroundings at `t` [s]; returns what its restrictions have become without a fault.

        `h` [s] is the time since the step before.
        """
        size = self._size
        self._filtered += h * max(plant.q_du, 0.0)
        self._dosed += h * max(plant.q_dose, 0.0)
        drift = 1.0 + size["viscosity_drift"] * (1.0 - math.exp(-max(t, 0.0) / WARM_UP_TIME))
        plant.viscosity = self._day.viscosity * drift
        level = size["falling_level"] * MBAR * (1.0 - math.exp(-max(t, 0.0) / LEVEL_TIME))
        plant.p_return = ATMOSPHERE - size["blocked_vent"] * MBAR * self._dosed / (0.1 * LITRE)
        plant.p_tank = plant.p_return - level + self._day.level  # the return ends in the gas above the reductant
        swing = 1.0 + 0.5 * math.sin(2 * math.pi * t / EXHAUST_SWING)
        plant.p_nozzle = ATMOSPHERE + size["back_pressure"] * BAR * swing
        plant.inlet_spring = size["inlet_spring"] * BAR
        du_filter, return_orifice, dosing_valve = healthy.du_filter, healthy.return_orifice, healthy.dosing_valve
        if size["cake_growth"]:
            factor = 1.0 + size["cake_growth"] * self._filtered / LITRE
            du_filter = Restriction(R=du_filter.R * factor, K=du_filter.K * factor)
        if size["worn_return"]:
            return_orifice = return_orifice.blocked(-size["worn_return"] * max(t, 0.0) / 3600)
        if size["nozzle_deposit"]:
            dosing_valve = dosing_valve.blocked(min(size["nozzle_deposit"] * self._dosed / (0.1 * LITRE), 0.9))
        plant.du_filter, plant.return_orifice, plant.dosing_valve = du_filter, return_orifice, dosing_valve
        return replace(healthy, du_filter=du_filter, return_orifice=return_orifice, dosing_valve=dosing_valve)


def branches_of(vehicle: Vehicle) -> list[Branch]:
    """What hangs on the vehicle's hose, fresh for a run."""
    return [make() for make in vehicle.branches]

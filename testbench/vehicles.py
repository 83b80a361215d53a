"""Vehicles: a plant with its sensors, by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from faultline.testbench.branches import Branch
from faultline.testbench.errors import RigError
from faultline.testbench.hose import Hose
from faultline.testbench.plant import SYSTEM_PRESSURE, PlantParameters
from faultline.testbench.pump import PumpParameters
from faultline.testbench.restriction import TURBULENT, Restriction
from faultline.testbench.sensors import EcuSensors, ExternalSensor
from faultline.testbench.units import ATMOSPHERE, BAR, MBAR, ML
from faultline.testbench.valve import Needle

# Transmitters with 0.5..4.5 V ratiometric output. The tables bend by some tenths of a percent, as certificates show.
# Noise: 0.16 % and 0.05 % of the range, what such sensors show on a bench's wiring. Zero: 0.6 % and 0.2 % of the range,
# within the 1 % that their class allows; the thesis had to calibrate it away (5.8).
_VOLTS = (0.5, 1.5, 2.5, 3.5, 4.5)
P_TP = ExternalSensor(
    "p_tp_V", _VOLTS, (0.0, 62_100.0, 124_600.0, 187_300.0, 250_000.0), noise=4 * MBAR, zero_sd=15 * MBAR
)
P_AP = ExternalSensor(
    "p_ap_V", _VOLTS, (0.0, 398_000.0, 797_500.0, 1_198_500.0, 1_600_000.0), noise=8 * MBAR, zero_sd=30 * MBAR
)


RETURN_FLOW, DOSE_FLOW = 2.0 * ML, 1.2 * ML  # m^3/s at 10 bar
MAXIMUM_FLOW = 3.2 * ML  # m^3/s, return at 10 bar and the dosing valve open: what the filters are rated at

BENCH_PLANT = PlantParameters(
    # Tank strainer: large mesh area, 20 mbar at full flow keeps the suction side near 1 bar (thesis fig. 5.8). All
    # restrictions are turbulent here; how much is laminar is an effect (`effects.py`), small since the drop of filters
    # at working flow is mostly that of housings and fittings.
    tank_filter=Restriction.rated(20 * MBAR, MAXIMUM_FLOW, laminar_share=TURBULENT),
    # Main filter in the pump: finer than the strainer, twice its drop.
    pump_filter=Restriction.rated(40 * MBAR, MAXIMUM_FLOW, laminar_share=TURBULENT),
    # Inlet filter of the dosing unit: a small cartridge, the offset between p_ap and p_du of thesis fig. 5.8.
    du_filter=Restriction.rated(60 * MBAR, MAXIMUM_FLOW, laminar_share=TURBULENT),
    # Bore of 0.3 mm: 2 mL/s at 10 bar, Reynolds number about 6000.
    return_orifice=Restriction.rated(SYSTEM_PRESSURE - ATMOSPHERE, RETURN_FLOW, laminar_share=TURBULENT),
    # Nozzle of a heavy truck's dosing unit: 1.2 mL/s held open is 4.7 kg/h, in the middle of what such units dose.
    dosing_valve=Restriction.rated(SYSTEM_PRESSURE - ATMOSPHERE, DOSE_FLOW, laminar_share=TURBULENT),
    # Short moulded ducts of 6 and 8 mL; the fluid's 2.2 GPa softened by plastic walls to about 0.3 GPa.
    compliance_tp=6 * ML / 0.3e9,
    compliance_bp=8 * ML / 0.3e9,
    # Heated EPDM hose of 60 mL, taken to widen by 0.6 % of its volume a bar: with the return orifice it gives p_du its
    # time constant of 3 s and, pulsed at half dose, a ripple of 0.1 bar.
    hose=Hose(0.35 * ML / BAR),
    # Drilled metal block of 5 mL with plastic fittings and a sensor's membrane: 0.2 GPa.
    compliance_du=5 * ML / 0.2e9,
)


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """One vehicle or bench.

    `external` maps the signal's name to its sensor, `branches` make what hangs on the hose besides the dosing unit.
    Restrictions are rated at `rated_flow` (filters), `return_flow` and `dose_flow` [m^3/s]. What the controller logs
    is `log_delay` [s] old. `scatter` says how the vehicle differs from its kind: age [h] and factors.
    """

    name: str
    text: str
    plant: PlantParameters
    pump: PumpParameters
    ecu_sensors: EcuSensors
    external: Mapping[str, ExternalSensor]
    rated_flow: float = MAXIMUM_FLOW
    return_flow: float = RETURN_FLOW
    dose_flow: float = DOSE_FLOW
    needle: Needle = field(default_factory=Needle)
    branches: tuple[Callable[[], Branch], ...] = ()
    log_delay: float = 0.0
    scatter: Mapping[str, float] = field(default_factory=dict)


BENCH = Vehicle(
    name="bench",
    text="test bench: short hoses, two loggers, vented to the workshop",
    plant=BENCH_PLANT,
    pump=PumpParameters(),
    ecu_sensors=EcuSensors(),
    external={"y_p_tp": P_TP, "y_p_ap": P_AP},
)

TRUCK = replace(
    BENCH,
    name="truck",
    text="heavy truck: longer hoses, sensors as they come from the shelf; truck-1, truck-2 ... are a fleet",
    plant=replace(
        BENCH_PLANT,
        # The tank is behind the cab, the dosing unit at the exhaust: 1.5 m more suction line, 1 m more pressure hose.
        tank_filter=Restriction.rated(26 * MBAR, MAXIMUM_FLOW, TURBULENT),
        du_filter=Restriction.rated(70 * MBAR, MAXIMUM_FLOW, TURBULENT),
        compliance_tp=15 * ML / 0.3e9,
        hose=Hose(0.5 * ML / BAR),
    ),
    # Half as much noise again beside the truck's own electrics, and a zero error that nobody has trimmed.
    external={
        "y_p_tp": replace(P_TP, noise=6 * MBAR, zero_sd=25 * MBAR),
        "y_p_ap": replace(P_AP, noise=12 * MBAR, zero_sd=50 * MBAR),
    },
)

VEHICLES = {"bench": BENCH, "truck": TRUCK}

SCATTER = {
    # Standard deviations of logarithms: what production leaves.
    "tank_filter": 0.05, "pump_filter": 0.05, "du_filter": 0.05,  # area
    "return_orifice": 0.02, "dosing_valve": 0.02,  # area; calibrated bores
    "displacement": 0.02, "leakage": 0.3, "hose": 0.1,
}  # fmt: skip
LIFE = 8000.0  # h, of a truck's engine: half a million km
AGEING = {
    # What a life does to the same, as a logarithm: filters take up dirt, the pump wears, rubber hardens.
    "tank_filter": -0.15, "pump_filter": -0.15, "du_filter": -0.15,
    "return_orifice": 0.02, "dosing_valve": -0.02,
    "displacement": 0.0, "leakage": 1.0, "hose": -0.15,
}  # fmt: skip


def vehicle(name: str) -> Vehicle:
    """The vehicle called `name`; raises `RigError` if there is none. truck-1, truck-2 ... differ and have aged."""
    if name in VEHICLES:
        return VEHICLES[name]
    number = name.removeprefix(f"{TRUCK.name}-")
    if number == name or not number.isdecimal() or str(int(number)) != number:
        raise RigError(f"there is no vehicle {name!r}; choose one of {', '.join(VEHICLES)}, or a truck-1, truck-2 ...")
    return _of_fleet(name, np.random.default_rng([int(number), 1]))


def _of_fleet(name: str, rng: np.random.Generator) -> Vehicle:
    """A truck with its own tolerances and age [h]."""
    age = rng.uniform(0.0, LIFE)
    factor = {part: float(np.exp(rng.normal(0.0, sd) + AGEING[part] * age / LIFE)) for part, sd in SCATTER.items()}
    plant = TRUCK.plant
    return replace(
        TRUCK,
        name=name,
        text=f"a truck of the fleet after {age:.0f} h",
        plant=replace(
            plant,
            tank_filter=plant.tank_filter.blocked(1 - factor["tank_filter"]),
            pump_filter=plant.pump_filter.blocked(1 - factor["pump_filter"]),
            du_filter=plant.du_filter.blocked(1 - factor["du_filter"]),
            return_orifice=plant.return_orifice.blocked(1 - factor["return_orifice"]),
            dosing_valve=plant.dosing_valve.blocked(1 - factor["dosing_valve"]),
            hose=replace(plant.hose, rated=plant.hose.rated * factor["hose"]),
        ),
        pump=replace(
            TRUCK.pump,
            displacement=TRUCK.pump.displacement * factor["displacement"],
            leakage=TRUCK.pump.leakage * factor["leakage"],
        ),
        scatter={"age_h": age, **factor},
    )

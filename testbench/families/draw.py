"""The families: each draws plants of a structure of its own, by number."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from math import sqrt

import numpy as np

from faultline.testbench.errors import RigError
from faultline.testbench.families.circuit import HIDDEN, Circuit, implicit_euler, reduced, runge_kutta
from faultline.testbench.families.control import PI, Motor, Pulses, Relay, Steps, Velocity
from faultline.testbench.families.cycle import Style
from faultline.testbench.families.plant import Plant
from faultline.testbench.families.sensed import Bus, Seen, Sensor, Tachometer
from faultline.testbench.streams import stream
from faultline.testbench.units import ATMOSPHERE, BAR, MBAR, ML

RHO, FLOW_COEFFICIENT, VISCOSITY, HOSE_VOLUME = 1088.0, 0.7, 1.4e-3, 6e-5
"""What the diagnosis model has for fixed: only products of these with areas and moduli matter."""

SCATTER = {"D_p": 0.03, "C_v": 0.3, "A_t": 0.15, "A_p": 0.15, "A_du": 0.15, "A_ori": 0.06, "A_dos": 0.06, "B_ap": 0.15}
"""Standard deviations of the logarithms of a plant's values around its data sheet."""


@dataclass(frozen=True)
class Family:
    """A family: what it is like, and how one of its plants is drawn."""

    text: str
    draw: Callable[[np.random.Generator], Plant]


def plant_of(family: str, number: int, effects: Mapping[str, float] | None = None) -> Plant:
    """The plant with a number, with `effects` of its circuit by name.

    Raises:
        RigError: there is no such family.
    """
    if family not in FAMILIES:
        raise RigError(f"there is no family {family!r}; choose one of {', '.join(FAMILIES)}")
    plant = FAMILIES[family].draw(stream(number, family, "plant"))
    circuit = replace(plant.circuit, **{name: (effects or {}).get(name, 0.0) for name in HIDDEN})
    return replace(plant, family=family, number=number, circuit=circuit)


def _sheet(rng: np.random.Generator) -> dict[str, float]:
    """A maker's data sheet: flows, drops and the hose's compliance, as the model's parameters."""
    back, dose = rng.uniform(1.2, 3.0) * ML, rng.uniform(0.6, 1.8) * ML  # at 9 bar
    whole, rise = back + dose, 9 * BAR

    def area(flow: float, drop: float) -> float:
        return flow / (FLOW_COEFFICIENT * sqrt(2.0 * drop / RHO))

    displacement = whole / rng.uniform(22.0, 38.0) * 1.05  # m^3: the speed at full dose
    settling = rng.uniform(2.0, 5.0)  # s, of the hose through the orifice
    return {
        "D_p": displacement,
        "C_v": rng.uniform(0.02, 0.08) * back / rise * VISCOSITY / displacement,
        "A_t": area(whole, rng.uniform(12.0, 40.0) * MBAR),
        "A_p": area(whole, rng.uniform(25.0, 70.0) * MBAR),
        "A_du": area(whole, rng.uniform(40.0, 110.0) * MBAR),
        "A_ori": area(back, rise),
        "A_dos": area(dose, rise),
        "B_ap": HOSE_VOLUME * 2.0 * rise / (settling * back),
    }


def _hydraulics(rng: np.random.Generator, ambient: float = ATMOSPHERE) -> tuple[Circuit, dict[str, float]]:
    """A circuit with its data sheet; at an altitude the engineer has entered the ambient pressure."""
    sheet = _sheet(rng)
    own = {name: value * float(np.exp(SCATTER[name] * rng.standard_normal())) for name, value in sheet.items()}
    k = {name: FLOW_COEFFICIENT * own[f"A_{name}"] * sqrt(2.0 / RHO) for name in ("t", "p", "du", "ori", "dos")}
    circuit = Circuit(
        displacement=own["D_p"],
        leakage=own["D_p"] * own["C_v"] / VISCOSITY,
        k_t=k["t"],
        k_p=k["p"],
        k_f=k["du"],
        k_o=k["ori"],
        k_v=k["dos"],
        c_tp=float(np.exp(rng.uniform(np.log(1e-14), np.log(1e-13)))),
        c_bp=float(np.exp(rng.uniform(np.log(1e-14), np.log(5e-14)))),
        c_ap=HOSE_VOLUME / own["B_ap"],
        c_du=float(np.exp(rng.uniform(np.log(1e-14), np.log(1e-13)))),
        ambient=ambient,
    )
    return circuit, {**sheet, "p_tank": ambient, "p_exh": ambient}


def _sensors(rng: np.random.Generator, lag: float = 0.0) -> dict[str, Sensor]:
    """Three pressure sensors with some noise and a common `lag` [s]."""
    noise = {"y_p_tp": (2.0, 5.0), "y_p_ap": (5.0, 12.0), "y_p_du": (8.0, 20.0)}
    zero = {"y_p_tp": 50.0, "y_p_ap": 100.0, "y_p_du": 100.0}
    return {
        name: Sensor(noise=rng.uniform(*span) * MBAR, zero=zero[name] * float(rng.standard_normal()), lag=lag)
        for name, span in noise.items()
    }


def _pulsed(sensors: dict[str, Sensor], suction: float, pressure: float, pulses: int) -> dict[str, Sensor]:
    """The sensors with the pump's ripple [Pa] on the suction side and after the pump."""
    sizes = {"y_p_tp": suction, "y_p_ap": pressure, "y_p_du": 0.5 * pressure}
    return {name: replace(s, pulsation=sizes[name], pulses=pulses) for name, s in sensors.items()}


def _stepped(rng: np.random.Generator) -> Plant:
    step = float(rng.choice([0.01]))
    gain, time = rng.uniform(3.0, 12.0), rng.uniform(0.8, 3.0)
    circuit, sheet = _hydraulics(rng)
    return Plant(
        circuit=circuit,
        sheet=sheet,
        integrator=implicit_euler,
        step=step,
        controller=partial(PI, gain, time, 60.0),
        period=float(rng.choice([0.05, 0.1])),
        motor=partial(Motor, rng.uniform(0.02, 0.1)),
        pulses=partial(Pulses, rng.uniform(2.5, 4.5)),
        seen=Seen(sensors=_sensors(rng), bus=Bus(ecu_jitter=0.015, box_jitter=0.01)),
        style=Style(),
    )


def _slow(rng: np.random.Generator) -> Plant:
    circuit, sheet = _hydraulics(rng)
    full = circuit.k_v * sqrt(9 * BAR) / circuit.displacement
    period = float(rng.choice([0.5, 1.0]))
    return Plant(
        circuit=circuit,
        sheet=sheet,
        integrator=reduced,
        step=0.02,
        controller=partial(PI, rng.uniform(1.0, 3.0), rng.uniform(2.0, 4.0), 50.0, full * rng.uniform(0.7, 1.1)),
        period=period,
        motor=partial(Motor, 0.0, rng.uniform(15.0, 60.0)),
        pulses=partial(Pulses, rng.uniform(6.0, 10.0)),
        seen=Seen(
            sensors=_sensors(rng),
            speed=Tachometer(noise=0.02, resolution=float(rng.choice([0.25, 0.5, 1.0]))),
            bus=Bus(box=0.2, task=0.1),
        ),
        style=Style(steady=0.3, holds=(15.0, 45.0)),
    )


def _relay(rng: np.random.Generator) -> Plant:
    c, sheet = _hydraulics(rng)
    idle = (c.k_o * sqrt(9 * BAR) + c.leakage * 9 * BAR) / c.displacement
    dose = c.k_v * sqrt(9 * BAR) / c.displacement
    band, swing = rng.uniform(0.1, 0.3), rng.uniform(0.2, 0.4) * idle
    return Plant(
        circuit=c,
        sheet=sheet,
        integrator=runge_kutta,
        step=0.01,
        controller=partial(Relay, band, idle * rng.uniform(0.95, 1.05), dose * rng.uniform(0.9, 1.1), swing),
        period=0.1,
        motor=partial(Motor, rng.uniform(0.05, 0.3)),
        pulses=partial(Pulses, rng.uniform(3.0, 6.0)),
        seen=Seen(sensors=_sensors(rng), bus=Bus(ecu_jitter=0.004)),
        style=Style(steady=0.6, low=8.5, high=11.5),
    )


def _highland(rng: np.random.Generator) -> Plant:
    ambient = ATMOSPHERE * float(np.exp(-rng.uniform(800.0, 3000.0) / 8300.0))
    circuit, sheet = _hydraulics(rng, ambient)
    cold = rng.uniform(0.6, 2.5)  # of the viscosity at 20 degC
    return Plant(
        sheet=sheet,
        circuit=replace(circuit, leakage=circuit.leakage / cold),
        integrator=implicit_euler,
        step=0.01,
        controller=partial(
            Velocity, rng.uniform(2.0, 6.0), rng.uniform(1.0, 3.0), rng.uniform(0.0, 0.15), 55.0, rng.uniform(30, 120)
        ),
        period=0.2,
        motor=partial(Motor, rng.uniform(0.0, 0.2)),
        pulses=partial(Pulses, rng.uniform(8.0, 12.0)),
        seen=Seen(sensors=_sensors(rng), bus=Bus(ecu_jitter=0.02, lost=0.01)),
        style=Style(usual=9.5, low=7.5, high=11.5),
    )


def _ripple(rng: np.random.Generator) -> Plant:
    sensors = _pulsed(
        _sensors(rng), rng.uniform(3.0, 12.0) * MBAR, rng.uniform(10.0, 40.0) * MBAR, int(rng.choice([3, 5, 6]))
    )
    circuit, sheet = _hydraulics(rng)
    return Plant(
        circuit=circuit,
        sheet=sheet,
        integrator=runge_kutta,
        step=0.01,
        controller=partial(PI, rng.uniform(4.0, 9.0), rng.uniform(1.0, 2.5), 60.0),
        period=0.05,
        motor=partial(Motor, rng.uniform(0.05, 0.25), rng.uniform(40.0, 200.0)),
        pulses=partial(Pulses, rng.uniform(2.0, 4.0)),
        seen=Seen(sensors=sensors, bus=Bus(ecu=0.1, box=0.05, ecu_jitter=0.006)),
        style=Style(doses=(5.0, 15.0)),
    )


def _sluggish(rng: np.random.Generator) -> Plant:
    inner = partial(PI, rng.uniform(2.0, 5.0), rng.uniform(2.0, 4.0), 60.0)
    step = rng.uniform(0.3, 1.5)
    circuit, sheet = _hydraulics(rng)
    return Plant(
        circuit=circuit,
        sheet=sheet,
        integrator=reduced,
        step=0.01,
        controller=lambda: Steps(inner(), step),
        period=0.1,
        motor=partial(Motor, rng.uniform(0.1, 0.5)),
        pulses=partial(Pulses, rng.uniform(3.0, 5.0)),
        seen=Seen(
            sensors={name: replace(s, resolution=2e3 if name != "y_p_tp" else 500.0)
                     for name, s in _sensors(rng, lag=rng.uniform(0.005, 0.02)).items()},
            speed=Tachometer(window=rng.uniform(0.05, 0.2), renewed=float(rng.choice([0.0, 0.4]))),
            bus=Bus(ecu=0.2, box=0.2),
        ),
        style=Style(ramp=rng.uniform(0.3, 2.0)),
    )  # fmt: skip


def _changing(rng: np.random.Generator) -> Plant:
    circuit, sheet = _hydraulics(rng)
    return Plant(
        circuit=circuit,
        sheet=sheet,
        integrator=implicit_euler,
        step=0.01,
        controller=partial(PI, rng.uniform(3.0, 8.0), rng.uniform(1.0, 2.5), 60.0),
        period=0.1,
        motor=partial(Motor, rng.uniform(0.02, 0.2)),
        pulses=partial(Pulses, 0.0),
        seen=Seen(sensors=_sensors(rng), bus=Bus(ecu=0.2, box=0.1)),
        style=Style(dose_ramp=rng.uniform(0.05, 0.5), ramp=rng.uniform(0.5, 5.0)),
        drifts={"viscosity": 0.05, "level": 500.0, "y_p_tp": 100.0, "y_p_ap": 300.0, "y_p_du": 300.0},
    )


FAMILIES: dict[str, Family] = {
    "stepped": Family("set points step, a fast PI controller of 50 or 100 ms; stamps that jitter", _stepped),
    "slow": Family("a controller of 0.5 or 1 s that knows the dose; a coarse speed; a motor of limited slope", _slow),
    "relay": Family("two speeds and hysteresis: the pressure saws, the speed jumps all the time", _relay),
    "highland": Family("800 to 3,000 m up, warm or cold; a PID algorithm in velocity form; lost frames", _highland),
    "ripple": Family("the pump's ripple on both sides, aliased; 10 and 20 frames a second", _ripple),
    "sluggish": Family("sensors that lag, a speed averaged or seldom renewed, coarse pressures, ramps", _sluggish),
    "changing": Family("a throttling valve whose dose moves in ramps; other conditions in each recording", _changing),
}

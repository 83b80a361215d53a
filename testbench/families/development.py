"""The families for development: those that the methods were chosen on."""

from dataclasses import replace
from functools import partial
from math import sqrt

import numpy as np

from faultline.testbench.families.circuit import implicit_euler, reduced, runge_kutta
from faultline.testbench.families.control import PI, Motor, Pulses, Relay, Steps, Velocity
from faultline.testbench.families.cycle import Style
from faultline.testbench.families.parts import Family, hydraulics, pulsed, sensors
from faultline.testbench.families.plant import Plant
from faultline.testbench.families.sensed import Bus, Seen, Tachometer
from faultline.testbench.units import ATMOSPHERE, BAR, MBAR


def _stepped(rng: np.random.Generator) -> Plant:
    step = float(rng.choice([0.01]))
    gain, time = rng.uniform(3.0, 12.0), rng.uniform(0.8, 3.0)
    circuit, sheet = hydraulics(rng)
    return Plant(
        circuit=circuit,
        sheet=sheet,
        integrator=implicit_euler,
        step=step,
        controller=partial(PI, gain, time, 60.0),
        period=float(rng.choice([0.05, 0.1])),
        motor=partial(Motor, rng.uniform(0.02, 0.1)),
        pulses=partial(Pulses, rng.uniform(2.5, 4.5)),
        seen=Seen(sensors=sensors(rng), bus=Bus(ecu_jitter=0.015, box_jitter=0.01)),
        style=Style(),
    )


def _slow(rng: np.random.Generator) -> Plant:
    circuit, sheet = hydraulics(rng)
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
            sensors=sensors(rng),
            speed=Tachometer(noise=0.02, resolution=float(rng.choice([0.25, 0.5, 1.0]))),
            bus=Bus(box=0.2, task=0.1),
        ),
        style=Style(steady=0.3, holds=(15.0, 45.0)),
    )


def _relay(rng: np.random.Generator) -> Plant:
    c, sheet = hydraulics(rng)
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
        seen=Seen(sensors=sensors(rng), bus=Bus(ecu_jitter=0.004)),
        style=Style(steady=0.6, low=8.5, high=11.5),
    )


def _highland(rng: np.random.Generator) -> Plant:
    ambient = ATMOSPHERE * float(np.exp(-rng.uniform(800.0, 3000.0) / 8300.0))
    circuit, sheet = hydraulics(rng, ambient)
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
        seen=Seen(sensors=sensors(rng), bus=Bus(ecu_jitter=0.02, lost=0.01)),
        style=Style(usual=9.5, low=7.5, high=11.5),
    )


def _ripple(rng: np.random.Generator) -> Plant:
    rippling = pulsed(
        sensors(rng), rng.uniform(3.0, 12.0) * MBAR, rng.uniform(10.0, 40.0) * MBAR, int(rng.choice([3, 5, 6]))
    )
    circuit, sheet = hydraulics(rng)
    return Plant(
        circuit=circuit,
        sheet=sheet,
        integrator=runge_kutta,
        step=0.01,
        controller=partial(PI, rng.uniform(4.0, 9.0), rng.uniform(1.0, 2.5), 60.0),
        period=0.05,
        motor=partial(Motor, rng.uniform(0.05, 0.25), rng.uniform(40.0, 200.0)),
        pulses=partial(Pulses, rng.uniform(2.0, 4.0)),
        seen=Seen(sensors=rippling, bus=Bus(ecu=0.1, box=0.05, ecu_jitter=0.006)),
        style=Style(doses=(5.0, 15.0)),
    )


def _sluggish(rng: np.random.Generator) -> Plant:
    inner = partial(PI, rng.uniform(2.0, 5.0), rng.uniform(2.0, 4.0), 60.0)
    step = rng.uniform(0.3, 1.5)
    circuit, sheet = hydraulics(rng)
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
                     for name, s in sensors(rng, lag=rng.uniform(0.005, 0.02)).items()},
            speed=Tachometer(window=rng.uniform(0.05, 0.2), renewed=float(rng.choice([0.0, 0.4]))),
            bus=Bus(ecu=0.2, box=0.2),
        ),
        style=Style(ramp=rng.uniform(0.3, 2.0)),
    )  # fmt: skip


def _changing(rng: np.random.Generator) -> Plant:
    circuit, sheet = hydraulics(rng)
    return Plant(
        circuit=circuit,
        sheet=sheet,
        integrator=implicit_euler,
        step=0.01,
        controller=partial(PI, rng.uniform(3.0, 8.0), rng.uniform(1.0, 2.5), 60.0),
        period=0.1,
        motor=partial(Motor, rng.uniform(0.02, 0.2)),
        pulses=partial(Pulses, 0.0),
        seen=Seen(sensors=sensors(rng), bus=Bus(ecu=0.2, box=0.1)),
        style=Style(dose_ramp=rng.uniform(0.05, 0.5), ramp=rng.uniform(0.5, 5.0)),
        drifts={"viscosity": 0.05, "level": 500.0, "y_p_tp": 100.0, "y_p_ap": 300.0, "y_p_du": 300.0},
    )


DEVELOPMENT: dict[str, Family] = {
    "stepped": Family("set points step, a fast PI controller of 50 or 100 ms; stamps that jitter", _stepped),
    "slow": Family("a controller of 0.5 or 1 s that knows the dose; a coarse speed; a motor of limited slope", _slow),
    "relay": Family("two speeds and hysteresis: the pressure saws, the speed jumps all the time", _relay),
    "highland": Family("800 to 3,000 m up, warm or cold; a PID algorithm in velocity form; lost frames", _highland),
    "ripple": Family("the pump's ripple on both sides, aliased; 10 and 20 frames a second", _ripple),
    "sluggish": Family("sensors that lag, a speed averaged or seldom renewed, coarse pressures, ramps", _sluggish),
    "changing": Family("a throttling valve whose dose moves in ramps; other conditions in each recording", _changing),
}

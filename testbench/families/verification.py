"""The families for verification: written after the methods had been frozen (commit 784bb08), and run once."""

from dataclasses import replace
from functools import partial
from math import sqrt

import numpy as np

from faultline.testbench.families.circuit import implicit_euler, runge_kutta, tr_bdf2
from faultline.testbench.families.control import PI, Foreknowing, Motor, Pulses, Swinging, Velocity
from faultline.testbench.families.cycle import Style
from faultline.testbench.families.parts import Family, hydraulics, sensors
from faultline.testbench.families.plant import Plant
from faultline.testbench.families.sensed import Bus, Seen, Tachometer
from faultline.testbench.units import BAR, MBAR


def _counted(rng: np.random.Generator) -> Plant:
    circuit, sheet = hydraulics(rng)
    return Plant(
        circuit=circuit,
        sheet=sheet,
        integrator=tr_bdf2,
        step=0.01,
        controller=partial(PI, rng.uniform(2.0, 6.0), rng.uniform(1.0, 3.0), 60.0),
        period=0.1,
        motor=partial(Motor, rng.uniform(0.05, 0.2)),
        pulses=partial(Pulses, rng.uniform(5.5, 9.0)),
        seen=Seen(
            sensors={name: replace(s, window=0.1) for name, s in sensors(rng).items()},
            speed=Tachometer(noise=0.0, window=rng.uniform(0.1, 0.2), teeth=int(rng.choice([24, 36, 60]))),
            bus=Bus(ecu=0.2, box=0.1, ecu_jitter=0.012),
        ),
        style=Style(doses=(4.0, 12.0)),
    )


def _swinging(rng: np.random.Generator) -> Plant:
    c, sheet = hydraulics(rng)
    idle = (c.k_o * sqrt(9 * BAR) + c.leakage * 9 * BAR) / c.displacement
    dose = c.k_v * sqrt(9 * BAR) / c.displacement
    resolution = 16.0 * BAR / 1024.0  # of ten bits
    fine = {name: replace(s, noise=rng.uniform(4.0, 8.0) * MBAR) for name, s in sensors(rng).items()}
    return Plant(
        circuit=c,
        sheet=sheet,
        integrator=implicit_euler,
        step=0.01,
        controller=partial(
            Foreknowing,
            idle * rng.uniform(0.85, 1.15),
            dose * rng.uniform(0.85, 1.15),
            rng.uniform(1.5, 4.0),
            rng.uniform(1.0, 3.0),
            rng.uniform(0.02, 0.08),
        ),
        period=0.25,
        motor=partial(Swinging, rng.uniform(4.0, 12.0), rng.uniform(0.3, 0.8)),
        pulses=partial(Pulses, rng.uniform(2.5, 4.5)),
        seen=Seen(
            sensors={name: replace(s, resolution=resolution if name != "y_p_tp" else 0.0) for name, s in fine.items()},
            bus=Bus(ecu=0.2, box=0.2, task=0.01),
        ),
        style=Style(low=7.5, high=12.5, steady=0.2, holds=(15.0, 40.0)),
    )


def _seldom(rng: np.random.Generator) -> Plant:
    circuit, sheet = hydraulics(rng)
    return Plant(
        circuit=circuit,
        sheet=sheet,
        integrator=runge_kutta,
        step=0.01,
        controller=partial(Velocity, rng.uniform(1.5, 4.0), rng.uniform(1.5, 4.0), 0.0, 55.0, rng.uniform(10.0, 40.0)),
        period=0.05,
        motor=partial(Motor, rng.uniform(0.1, 0.4)),
        pulses=partial(Pulses, rng.uniform(9.0, 14.0)),
        seen=Seen(
            sensors=sensors(rng, lag=rng.uniform(0.0, 0.03)),
            speed=Tachometer(noise=rng.uniform(0.02, 0.1), window=rng.uniform(0.0, 0.3)),
            bus=Bus(ecu=0.4, box=0.15, ecu_jitter=0.03, box_jitter=0.01, task=0.05, lost=0.005),
        ),
        style=Style(ramp=rng.uniform(0.5, 4.0), doses=(10.0, 40.0), idle=0.4),
        drifts={"viscosity": 0.04, "level": 400.0, "y_p_tp": 80.0, "y_p_ap": 250.0, "y_p_du": 250.0},
    )


VERIFICATION: dict[str, Family] = {
    "counted": Family("a speed that is counted by teeth, doses that change often, pressures averaged", _counted),
    "swinging": Family("a motor that overshoots, ordered by the maker's figures each 250 ms; ten bits", _swinging),
    "seldom": Family("the controller's frames at 0.4 s, late and lost; other conditions in each recording", _seldom),
}

"""A family's plant as a whole, and its run over a cycle."""

from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import ceil

import numpy as np

from faultline.testbench.families.circuit import Circuit, Integrator
from faultline.testbench.families.control import Motor, Pulses, Swinging
from faultline.testbench.families.cycle import Asked, Style
from faultline.testbench.families.faulty import check, circuit_at, errors_at
from faultline.testbench.families.sensed import Course, Seen
from faultline.testbench.faults import Fault

Controller = Callable[[float, float, float], float]
"""From the pressure's error [Pa], the dose [0..1] and the period [s] to the ordered speed [rev/s]."""


@dataclass(frozen=True, kw_only=True)
class Plant:
    """A plant of one family.

    `controller` makes a new one for each run; it works once per `period` [s], on the true pressure of the dosing unit.
    The integrator's `step` [s] divides the period. `sheet` is its data sheet: the values that a model's parameters have
    in its medians, by name. `drifts` are the standard deviations from one recording to the next: of the logarithm of
    the viscosity, of the tank's level [Pa], and of the zeros of `y_p_tp` and the two others [Pa].
    """

    circuit: Circuit
    integrator: Integrator
    step: float
    controller: Callable[[], Controller]
    period: float
    motor: Callable[[], Motor | Swinging]
    pulses: Callable[[], Pulses]
    seen: Seen
    style: Style
    sheet: dict[str, float]
    drifts: dict[str, float] = field(default_factory=dict)
    family: str = ""
    number: int = 0

    @property
    def name(self) -> str:
        """Of the vehicle."""
        return f"{self.family}-{self.number}"


DRIFTS = ("viscosity", "level", "y_p_tp", "y_p_ap", "y_p_du")


def on_a_day(plant: Plant, rng: np.random.Generator) -> Plant:
    """The plant as it is during one recording."""
    drawn = {name: plant.drifts.get(name, 0.0) * rng.standard_normal() for name in DRIFTS}
    sensors = {
        name: replace(sensor, zero=sensor.zero + drawn[name] - drawn["level"] * (name == "y_p_tp"))
        for name, sensor in plant.seen.sensors.items()
    }
    circuit = replace(plant.circuit, leakage=plant.circuit.leakage / float(np.exp(drawn["viscosity"])))
    return replace(plant, circuit=circuit, seen=replace(plant.seen, sensors=sensors))


def run(plant: Plant, asked: Asked, duration_s: float, faults: Sequence[Fault] = ()) -> Course:
    """The run from standstill, with `faults` from their onsets on.

    Raises:
        ArithmeticError: the integrator does not converge.
        RigError: the families have no such fault.
    """
    check(faults)
    controller, motor, pulses = plant.controller(), plant.motor(), plant.pulses()
    h, x = plant.step, plant.circuit.rest
    begins = {0, *(ceil(fault.onset_s / h) for fault in faults)}
    every, count = round(plant.period / h), int(duration_s / h)
    pressures, speeds, duties = np.empty((count, 4)), array("d"), array("d")
    dosed, ordered, duty = 0.0, 0.0, 0.0
    for k in range(count):
        if k in begins:
            circuit, misread = circuit_at(plant.circuit, faults, k * h), errors_at(faults, k * h).get("y_p_du", 0.0)
        if k % every == 0:
            setpoint, dose = asked.at(k * h)
            if setpoint:
                duty = dose
                ordered = controller(setpoint - x[3] - misread, dose, plant.period)
        effective = duty if duty >= 1.0 else max(duty - circuit.dead, 0.0)
        speed, opening = motor.step(h, ordered), pulses.step(h, effective)
        lift = (1.0 + circuit.full_open * (duty >= 1.0)) * (1.0 - circuit.deposit * dosed / 1e-4)
        x = plant.integrator(circuit, x, h, speed, opening * lift)
        dosed += h * opening * circuit.k_v * 950.0 if circuit.deposit else 0.0  # sqrt(9 bar) = 950 sqrt(Pa)
        pressures[k] = x
        speeds.append(speed)
        duties.append(duty)
    return Course(h * np.arange(1.0, count + 1.0), pressures, np.array(speeds), np.array(duties), tuple(faults))

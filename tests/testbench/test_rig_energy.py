"""Balance of energy: what the pump puts into the fluid is dissipated, stored, or carried out to the surroundings.

    integral of q_pump (p_ap - p_bp) = sum of integrals of drop(q) q + sum of integrals of C p dp + net work at the ends

Dissipation is taken from each restriction's law and its flow, stored energy from each compliance in closed form;
neither uses the plant's own pressure differences, so that a wrong law, sign or connection shows. Backward Euler
dissipates a little of its own, in proportion to the step: the balance closes to that, and twice as well with half the
step.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest

from faultline.testbench.branches import Leak
from faultline.testbench.effects import fitted
from faultline.testbench.hose import Hose
from faultline.testbench.plant import SYSTEM_PRESSURE, Plant, PlantParameters
from faultline.testbench.restriction import TURBULENT, Restriction
from faultline.testbench.units import ATMOSPHERE, ML
from faultline.testbench.valve import PulseWidth
from faultline.testbench.vehicles import VEHICLES

DURATION = 24.0  # s
BENCH = VEHICLES["bench"]
HOLE = Restriction.rated(SYSTEM_PRESSURE - ATMOSPHERE, 0.3 * ML, TURBULENT)
NOZZLE = ATMOSPHERE + 3e4  # Pa: an exhaust with back-pressure, so that it does not do what the tank does


@dataclass
class Energy:
    """Work and energies [J] since the start."""

    pumped: float = 0.0
    dissipated: float = 0.0
    stored: float = 0.0
    carried_out: float = 0.0

    @property
    def missing(self) -> float:
        """As a part of what was pumped."""
        return (self.pumped - self.dissipated - self.stored - self.carried_out) / self.pumped


def spent(h: float, effects: Mapping[str, float], leaks: bool) -> Energy:
    """Start-up, pulses of the dosing valve, and a filter that clogs all at once."""
    vehicle = fitted(BENCH, effects)
    parameters, valve = vehicle.plant, PulseWidth()
    plant = Plant(parameters, vehicle.pump, [Leak(HOLE)] if leaks else [])
    plant.p_nozzle = NOZZLE
    energy = Energy()
    steps = round(DURATION / h)
    for step in range(steps):
        if step == steps // 2:
            plant.du_filter = parameters.du_filter.blocked(0.8)
        opening = valve.opening(h, 0.4)
        plant.step(h, 24.0, opening)
        energy.pumped += h * plant.q_pump * (plant.p_ap - plant.p_bp)
        energy.dissipated += h * dissipation(plant, opening)
        leaving = plant.q_return * ATMOSPHERE + plant.q_dose * NOZZLE + plant.q_branches * ATMOSPHERE
        energy.carried_out += h * (leaving - plant.q_tank * ATMOSPHERE)
    energy.stored = stored(parameters, plant)
    return energy


def dissipation(plant: Plant, opening: float) -> float:
    """Power [W] lost in the restrictions, from their flows alone."""
    q_open = plant.q_dose / opening if opening else 0.0
    through = (
        (plant.tank_filter, plant.q_tank),
        (plant.pump_filter, plant.q_pump_filter),
        (plant.du_filter, plant.q_du),
        (plant.return_orifice, plant.q_return),
        (HOLE, plant.q_branches),
    )
    return sum(part.drop(q) * q for part, q in through) + plant.dosing_valve.drop(q_open) * plant.q_dose


def stored(parameters: PlantParameters, plant: Plant) -> float:
    """Energy [J] in the four volumes, above that at rest."""
    ducts = (
        (parameters.compliance_tp, plant.p_tp),
        (parameters.compliance_bp, plant.p_bp),
        (parameters.compliance_du, plant.p_du),
    )
    return sum(c * (p**2 - ATMOSPHERE**2) / 2 for c, p in ducts) + in_hose(parameters.hose, plant.p_ap)


def in_hose(hose: Hose, end: float) -> float:
    """The integral of C(p) p dp [J] from atmospheric pressure to `end` [Pa]."""
    p = np.linspace(ATMOSPHERE, end, 2001)
    power = np.array([hose.compliance(float(x)) * float(x) for x in p])
    return float(((power[1:] + power[:-1]) / 2 * np.diff(p)).sum())


@pytest.mark.parametrize(
    ("effects", "leaks"),
    [
        ({}, False),
        ({"laminar_filters": 0.4}, False),
        ({}, True),
        ({"stiff_hose": 0.8, "entrained_air": 15.0}, False),
    ],
    ids=["turbulent", "laminar", "leak", "soft-hose"],
)
def test_what_is_pumped_is_dissipated_stored_or_carried_out(effects: Mapping[str, float], leaks: bool) -> None:
    coarse, fine = spent(0.002, effects, leaks), spent(0.001, effects, leaks)
    assert coarse.pumped > 20.0
    assert min(coarse.dissipated, coarse.stored) > 0.02 * coarse.pumped  # neither is idle
    assert abs(coarse.missing) < 2e-4  # a law that is off by a thousandth leaves four times that
    assert fine.missing / coarse.missing == pytest.approx(0.5, abs=0.1)

"""What families draw alike: a data sheet, a circuit that scatters around it, and sensors."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from faultline.testbench.families.circuit import Circuit
from faultline.testbench.families.plant import Plant
from faultline.testbench.families.sensed import Sensor
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


def data_sheet(rng: np.random.Generator) -> dict[str, float]:
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


def hydraulics(rng: np.random.Generator, ambient: float = ATMOSPHERE) -> tuple[Circuit, dict[str, float]]:
    """A circuit with its data sheet; at an altitude the engineer has entered the ambient pressure."""
    sheet = data_sheet(rng)
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


def sensors(rng: np.random.Generator, lag: float = 0.0) -> dict[str, Sensor]:
    """Three pressure sensors with some noise and a common `lag` [s]."""
    noise = {"y_p_tp": (2.0, 5.0), "y_p_ap": (5.0, 12.0), "y_p_du": (8.0, 20.0)}
    zero = {"y_p_tp": 50.0, "y_p_ap": 100.0, "y_p_du": 100.0}
    return {
        name: Sensor(noise=rng.uniform(*span) * MBAR, zero=zero[name] * float(rng.standard_normal()), lag=lag)
        for name, span in noise.items()
    }


def pulsed(sensors: dict[str, Sensor], suction: float, pressure: float, pulses: int) -> dict[str, Sensor]:
    """The sensors with the pump's ripple [Pa] on the suction side and after the pump."""
    sizes = {"y_p_tp": suction, "y_p_ap": pressure, "y_p_du": 0.5 * pressure}
    return {name: replace(s, pulsation=sizes[name], pulses=pulses) for name, s in sensors.items()}

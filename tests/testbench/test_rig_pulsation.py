"""The pump's ripple at p_tp: the ladder's formula, quieter under a clogged pump filter, nothing at standstill."""

from math import pi
from pathlib import Path

import numpy as np
import pytest

from faultline.testbench.bus import load_dbc
from faultline.testbench.cycles import CYCLES, STANDING
from faultline.testbench.effects import fitted
from faultline.testbench.faults import Fault
from faultline.testbench.plant import Plant
from faultline.testbench.pulsation import PULSES, RATED_SPEED, Pulsation, felt, pulse
from faultline.testbench.recorded import read_recording
from faultline.testbench.recording import record
from faultline.testbench.request import Kind, Request
from faultline.testbench.simulation import simulate
from faultline.testbench.units import MBAR
from faultline.testbench.vehicles import TRUCK

ALONE = {"suction_pulsation": 20.0}


@pytest.mark.parametrize(("w", "R_p"), [(200.0, 2.5e9), (1244.0, 2.5e9), (1244.0, 5e10)])
def test_the_formula_is_what_the_ladder_does(w: float, R_p: float) -> None:
    """Against its two differential equations, integrated by the trapezoidal rule until the start is forgotten."""
    R_t, C_t, C_b = 1.6e9, 5e-14, 2.7e-14
    A = np.array([[-(1 / R_t + 1 / R_p) / C_t, 1 / (R_p * C_t)], [1 / (R_p * C_b), -1 / (R_p * C_b)]])
    h, periods = 2 * pi / w / 400, 40
    forward = np.linalg.inv(np.eye(2) - h / 2 * A)
    p, seen = np.zeros(2), []
    for k in range(400 * periods):
        source = -(np.sin(w * h * k) + np.sin(w * h * (k + 1))) / 2 / C_b
        p = forward @ ((np.eye(2) + h / 2 * A) @ p + h * np.array([0.0, source]))
        seen.append(p[0])
    assert max(seen[-400:]) == pytest.approx(felt(R_t, R_p, C_t, C_b, w), rel=2e-3)


def test_the_size_is_the_amplitude_at_rated_flow_with_clean_filters() -> None:
    vehicle = fitted(TRUCK, {"laminar_filters": 0.06})
    pulsation, plant = Pulsation(vehicle, 20.0), Plant(vehicle.plant, vehicle.pump)
    plant.q_tank = plant.q_pump_filter = plant.q_pump = vehicle.rated_flow
    assert pulsation.amplitude(plant, RATED_SPEED) == pytest.approx(20 * MBAR)
    # As the ladder says, in every part: half the flow at half the speed, and a filter with a fifth of its area.
    parts = vehicle.plant
    plant.pump_filter = parts.pump_filter.blocked(0.8)
    plant.q_tank = plant.q_pump_filter = plant.q_pump = vehicle.rated_flow / 2
    R_t, R_p = (part.R + 2 * part.K * plant.q_tank for part in (parts.tank_filter, plant.pump_filter))
    rated = felt(
        parts.tank_filter.R + 2 * parts.tank_filter.K * vehicle.rated_flow,
        parts.pump_filter.R + 2 * parts.pump_filter.K * vehicle.rated_flow,
        parts.compliance_tp,
        parts.compliance_bp,
        2 * pi * PULSES * RATED_SPEED,
    )
    now = felt(R_t, R_p, parts.compliance_tp, parts.compliance_bp, pi * PULSES * RATED_SPEED)
    assert pulsation.amplitude(plant, RATED_SPEED / 2) == pytest.approx(20 * MBAR * now / rated / 2)
    assert pulsation.amplitude(plant, 0.0) == 0.0


def test_a_clogged_pump_filter_makes_it_quieter_and_standstill_silent() -> None:
    cycle = CYCLES["maximum"]
    clean, clogged = (
        simulate(TRUCK, cycle, faults, seed=4, duration=100.0, effects=ALONE)
        for faults in ((), (Fault("fA_p", 0.774, 50.0),))
    )
    standing, dosing = clean.ecu_t < STANDING, clean.ecu_t > 60.0
    assert (clean.ripple[standing] == 0.0).all()
    assert (clean.ripple[dosing] > 10 * MBAR).all()
    ratio = clogged.ripple[dosing].mean() / clean.ripple[dosing].mean()
    assert 0.3 < ratio < 0.7  # w R_p C_bp is 1.6 at rated flow: 0.53 of it
    assert (clogged.ripple[clean.ecu_t < 50.0] == clean.ripple[clean.ecu_t < 50.0]).all()


@pytest.mark.parametrize("kind", ["instrumented", "bench"])
def test_both_kinds_of_recording_show_it_as_spread(tmp_path: Path, kind: Kind) -> None:
    spread, mean = {}, {}
    for name, effects in (("plain", {}), ("pulsing", ALONE)):
        wanted = Request(name, TRUCK, CYCLES["maximum"], (), 3, 100.0, effects, kind=kind)
        folder, _ = record(
            wanted, load_dbc(), tmp_path / "out", tmp_path / "truth", force=True, progress=lambda _: None
        )
        recorded = read_recording(folder)
        track = (recorded.bus if kind == "instrumented" else recorded.external)["y_p_tp"]
        for when, part in (("standing", track.t < 10.0), ("dosing", (track.t > 60.0) & (track.t < 95.0))):
            spread[name, when], mean[name, when] = float(track.value[part].std()), float(track.value[part].mean())
    assert spread["pulsing", "standing"] == spread["plain", "standing"]
    added = spread["pulsing", "dosing"] ** 2 - spread["plain", "dosing"] ** 2
    assert added == pytest.approx((20 * MBAR) ** 2 / 2, rel=0.35)  # of 350 samples at nearly the rated flow
    assert mean["pulsing", "dosing"] == pytest.approx(mean["plain", "dosing"], abs=4 * 20 * MBAR / 350**0.5)


def test_phases_are_spread_evenly() -> None:
    read = pulse(np.random.default_rng(1).random(4000))
    assert read.std() == pytest.approx(0.5**0.5, rel=0.05)
    assert abs(read.mean()) < 0.05

"""Restrictions, pump and hydraulics: rated points, balance of volumes, rest, and what an implicit step must survive."""

from dataclasses import replace

import pytest

from faultline.testbench.effects import PROFILES, fitted
from faultline.testbench.plant import SYSTEM_PRESSURE, Plant
from faultline.testbench.pump import Drive, PumpParameters
from faultline.testbench.restriction import Restriction
from faultline.testbench.units import ATMOSPHERE, BAR, ML
from faultline.testbench.valve import FREQUENCY, PulseWidth
from faultline.testbench.vehicles import VEHICLES

H = 0.002
BENCH_PLANT = fitted(VEHICLES["bench"], PROFILES["realistic"]).plant


def rig() -> Plant:
    return Plant(BENCH_PLANT, PumpParameters())


def settle(plant: Plant, speed: float, opening: float, seconds: float = 40.0) -> Plant:
    for _ in range(round(seconds / H)):
        plant.step(H, speed, opening)
    return plant


def test_rated_restriction_has_its_drop_and_is_odd() -> None:
    filter_ = Restriction.rated(6e3, 3.2 * ML, laminar_share=0.06)
    assert filter_.drop(3.2 * ML) == pytest.approx(6e3)
    assert filter_.drop(-1.7 * ML) == -filter_.drop(1.7 * ML)
    assert pytest.approx(0.06 * 6e3) == filter_.R * 3.2 * ML


def test_working_flows_look_turbulent_within_a_few_mbar() -> None:
    """The diagnosis models a filter as an orifice: with a fitted area it must fit between idle and maximum dose."""
    for filter_ in (BENCH_PLANT.tank_filter, BENCH_PLANT.pump_filter, BENCH_PLANT.du_filter):
        fitted = filter_.drop(2.7 * ML) / (2.7 * ML) ** 2
        for flow in (2.0 * ML, 3.3 * ML):
            assert abs(fitted * flow**2 - filter_.drop(flow)) < 150  # Pa


def test_blocking_half_quadruples_the_turbulent_drop() -> None:
    filter_ = Restriction(R=1e8, K=1e15)
    half = filter_.blocked(0.5)
    assert (half.R, half.K) == (2e8, 4e15)
    assert filter_.blocked(0.0) == filter_


def test_stays_at_rest_at_atmospheric_pressure() -> None:
    plant = settle(rig(), speed=0.0, opening=0.0, seconds=10)
    for pressure in (plant.p_tp, plant.p_bp, plant.p_ap, plant.p_du):
        assert pressure == pytest.approx(ATMOSPHERE, abs=1e-6)
    assert abs(plant.q_return) < 1e-15


def test_magnitudes_at_system_pressure() -> None:
    """21 rev/s hold 10 bar without dosing, 33 with the valve open; both sides of the circuit carry the same flow."""
    idle = settle(rig(), speed=21.05, opening=0.0)
    assert idle.p_du == pytest.approx(SYSTEM_PRESSURE, abs=0.05 * BAR)
    assert idle.q_return == pytest.approx(2.0 * ML, rel=0.01)
    assert idle.q_tank == pytest.approx(idle.q_return, rel=1e-6)
    full = settle(rig(), speed=33.05, opening=1.0)
    assert full.p_du == pytest.approx(SYSTEM_PRESSURE, abs=0.05 * BAR)
    assert full.q_dose == pytest.approx(1.2 * ML, rel=0.01)
    assert full.p_ap - full.p_du == pytest.approx(60e2, rel=0.02)
    assert ATMOSPHERE - full.p_tp == pytest.approx(20e2, rel=0.02)
    assert full.p_tp - full.p_bp == pytest.approx(40e2, rel=0.02)


@pytest.mark.parametrize("speed", [25.0, 60.0])
@pytest.mark.parametrize("h", [0.001, 0.002, 0.02])
def test_what_flows_in_is_stored_or_flows_out(speed: float, h: float) -> None:
    """For every volume, through start-up, pulses, an abrupt fault, and a suction side that starves the pump."""
    plant, valve = rig(), PulseWidth()
    start = (plant.p_tp, plant.p_bp, plant.p_ap, plant.p_du)
    gained = [0.0] * 4
    steps = round(30.0 / h)
    for step in range(steps):
        if step == steps // 2:
            plant.tank_filter = BENCH_PLANT.tank_filter.blocked(0.93)
        plant.step(h, speed, valve.opening(h, 0.4))
        inward = (plant.q_tank, plant.q_pump_filter, plant.q_pump, plant.q_du)
        outward = (plant.q_pump_filter, plant.q_pump, plant.q_du, plant.q_return + plant.q_dose)
        gained = [total + h * (i - o) for total, i, o in zip(gained, inward, outward, strict=True)]
    compliance = (
        BENCH_PLANT.compliance_tp,
        BENCH_PLANT.compliance_bp,
        BENCH_PLANT.hose.rated,
        BENCH_PLANT.compliance_du,
    )
    end = (plant.p_tp, plant.p_bp, plant.p_ap, plant.p_du)
    for total, c, p0, p1 in zip(gained, compliance, start, end, strict=True):
        assert total == pytest.approx(c * (p1 - p0), abs=1e-9 * ML)
    assert sum(gained) > 1 * ML  # the hose did store something: the balance is not one of zeros


def test_starving_pump_keeps_pressures_positive_and_flow_below_displacement() -> None:
    plant = rig()
    plant.pump_filter = BENCH_PLANT.pump_filter.blocked(0.97)
    settle(plant, speed=33.0, opening=1.0)
    assert 0 < plant.p_bp < PumpParameters().fills_above
    assert 0 < plant.q_pump < 0.9 * PumpParameters().displacement * 33.0


def test_pressure_decays_through_the_return_when_the_pump_stops() -> None:
    plant = settle(rig(), speed=21.0, opening=0.0)
    last = plant.p_du
    for _ in range(20):
        settle(plant, speed=0.0, opening=0.0, seconds=1)
        assert ATMOSPHERE - 1 <= plant.p_du <= last + 1e-6  # rounding, once it is at rest
        last = plant.p_du
    assert last == pytest.approx(ATMOSPHERE, abs=50)


def test_time_constant_of_the_dosing_pressure_is_about_three_seconds() -> None:
    plant = settle(rig(), speed=21.0, opening=0.0)
    before = plant.p_du
    after = settle(Plant(BENCH_PLANT, PumpParameters()), speed=22.0, opening=0.0).p_du
    settle(plant, speed=22.0, opening=0.0, seconds=3.1)
    assert (plant.p_du - before) / (after - before) == pytest.approx(0.63, abs=0.05)


def test_leak_takes_five_percent_at_system_pressure() -> None:
    tight = Plant(BENCH_PLANT, replace(PumpParameters(), leakage=0.0))
    settle(tight, speed=20.0, opening=0.0)
    leaking = settle(rig(), speed=20.0, opening=0.0)
    assert leaking.q_pump / tight.q_pump == pytest.approx(0.95, abs=0.01)


def test_drive_reaches_its_speed_against_the_load_and_never_turns_back() -> None:
    drive = Drive(PumpParameters())
    for _ in range(1000):
        drive.step(H, 30.0, 9e5)
    assert drive.speed == pytest.approx(30.0, abs=0.01)
    for _ in range(1000):
        drive.step(H, 0.0, 9e5)
    assert drive.speed == 0.0


def test_valve_is_open_for_its_duty_at_any_step() -> None:
    for h in (0.0007, 0.002, 0.013):
        valve = PulseWidth()
        steps = round(600 / h)
        openings = [valve.opening(h, 0.37) for _ in range(steps)]
        assert sum(openings) / steps == pytest.approx(0.37, abs=0.002)
        assert all(-1e-12 <= opening <= 1 + 1e-12 for opening in openings)
        assert any(0.01 < opening < 0.99 for opening in openings)  # edges lie inside steps


def test_valve_takes_a_new_duty_with_the_next_period() -> None:
    valve = PulseWidth()
    first = [valve.opening(H, 1.0) for _ in range(int(1 / (FREQUENCY * H)) - 1)]
    assert max(first) == 0.0  # the running period began with duty 0
    later = [valve.opening(H, 1.0) for _ in range(500)]
    assert min(later[2:]) == pytest.approx(1.0)

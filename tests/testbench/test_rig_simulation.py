"""A run in memory: the step is small enough, the loop holds 10 bar, and every fault moves what it must."""

import numpy as np
import pytest

from faultline.testbench.bus import Knowledge
from faultline.testbench.cycles import CYCLES, SYSTEM
from faultline.testbench.ecu import CUT_BELOW, PERIOD, Ecu
from faultline.testbench.errors import RigError
from faultline.testbench.faults import FAULTS, Fault
from faultline.testbench.simulation import STEP, Run, simulate
from faultline.testbench.undeclared import UNDECLARED
from faultline.testbench.units import ATMOSPHERE
from faultline.testbench.vehicles import BENCH, VEHICLES

TP, BP, AP, DU = range(4)
N_P = Knowledge._fields.index("n_p")
DUTY = Knowledge._fields.index("duty")

IDLE, PARTIAL, MAXIMUM = (76.0, 84.0), (92.0, 102.0), (62.0, 70.0)  # s, steady parts of the validation cycle


def run(*faults: Fault, duration: float = 104.0, step: float = STEP) -> Run:
    return simulate(VEHICLES["bench"], CYCLES["validation"], faults, seed=5, duration=duration, step=step)


@pytest.fixture(scope="module")
def healthy() -> Run:
    return run()


def mean(of: Run, column: int, window: tuple[float, float]) -> float:
    return float(of.pressures[(of.t > window[0]) & (of.t < window[1]), column].mean())


def speed(of: Run, window: tuple[float, float]) -> float:
    return float(of.ecu[(of.ecu_t > window[0]) & (of.ecu_t < window[1]), N_P].mean())


def test_halving_the_step_changes_nothing_that_a_sensor_sees(healthy: Run) -> None:
    fine = run(step=STEP / 2)
    assert np.allclose(fine.t[1::2], healthy.t)
    difference = fine.pressures[1::2] - healthy.pressures
    rms = np.sqrt((difference**2).mean(axis=0))
    assert (rms < [10, 30, 60, 100]).all()  # Pa; the sensors' noise is 400, -, 800 and 1000
    assert np.abs(difference[:, AP]).max() < 300
    assert np.abs(fine.ecu[:, N_P] - healthy.ecu[:, N_P]).max() < 0.05


def test_rests_at_atmosphere_until_the_pump_starts(healthy: Run) -> None:
    standing = healthy.t < 14.9
    assert np.abs(healthy.pressures[standing] - ATMOSPHERE).max() < 1e-3
    assert (healthy.ecu[healthy.ecu_t < 14.9][:, [N_P, DUTY]] == 0).all()


def test_loop_holds_ten_bar_in_every_mode(healthy: Run) -> None:
    assert np.isfinite(healthy.pressures).all()
    for window in (IDLE, PARTIAL, MAXIMUM):
        assert mean(healthy, DU, window) == pytest.approx(SYSTEM, abs=3e3)
    assert speed(healthy, IDLE) == pytest.approx(21.0, abs=0.5)
    assert speed(healthy, MAXIMUM) == pytest.approx(33.0, abs=0.5)


def test_pulses_ripple_the_pressure_by_a_tenth_of_a_bar(healthy: Run) -> None:
    """At partial dose only: idle and maximum have no pulses."""
    swing = {w: np.ptp(healthy.pressures[(healthy.t > w[0]) & (healthy.t < w[1]), AP]) for w in (IDLE, (48.0, 55.0))}
    assert 1.5e4 < swing[48.0, 55.0] < 3.5e4
    assert swing[IDLE] < 1.5e4


def test_doses_only_after_pressure_is_built(healthy: Run) -> None:
    before = healthy.ecu_t < 40
    assert (healthy.ecu[before, DUTY] == 0).all()
    assert healthy.ecu[~before, DUTY].max() == 1.0


def test_clogged_filters_drop_pressure_downstream(healthy: Run) -> None:
    tank, pump, du = (run(Fault(name, 0.65, 30.0)) for name in ("fA_t", "fA_p", "fA_du"))
    for window in (IDLE, PARTIAL, MAXIMUM):
        assert mean(tank, TP, window) < mean(healthy, TP, window) - 4e3
        assert mean(pump, BP, window) < mean(healthy, BP, window) - 8e3
        assert mean(pump, TP, window) == pytest.approx(mean(healthy, TP, window), abs=50)
        assert mean(du, AP, window) > mean(healthy, AP, window) + 1e4
        assert mean(du, DU, window) == pytest.approx(mean(healthy, DU, window), abs=500)


def test_clogged_outlets_and_weak_pump_show_in_the_speed(healthy: Run) -> None:
    orifice, nozzle, pump = (run(Fault(name, 0.2, 30.0)) for name in ("fA_ori", "fA_dos", "fq_pump"))
    assert speed(orifice, IDLE) < speed(healthy, IDLE) - 3
    assert speed(nozzle, MAXIMUM) < speed(healthy, MAXIMUM) - 1.5
    assert speed(nozzle, IDLE) == pytest.approx(speed(healthy, IDLE), abs=0.1)
    assert speed(pump, IDLE) > speed(healthy, IDLE) + 3


def test_biased_controller_sensor_moves_the_true_pressure_the_other_way(healthy: Run) -> None:
    biased = run(Fault("fy_p_du", 2e4, 30.0))
    assert mean(biased, DU, IDLE) == pytest.approx(mean(healthy, DU, IDLE) - 2e4, abs=500)
    assert biased.ecu[(biased.ecu_t > 76) & (biased.ecu_t < 84), 0].mean() == pytest.approx(SYSTEM, abs=2e3)


@pytest.mark.parametrize("name", ["fy_p_tp", "fy_p_ap"])
def test_external_sensor_faults_leave_the_plant_alone(name: str) -> None:
    biased = run(Fault(name, 1e4, 30.0), duration=60.0)
    assert (biased.pressures == run(duration=60.0).pressures).all()


def test_before_the_onset_nothing_differs(healthy: Run) -> None:
    late = run(Fault("fA_du", 0.65, 80.0))
    before = healthy.t <= 80.0
    assert (late.pressures[before] == healthy.pressures[before]).all()
    assert (late.pressures[~before] != healthy.pressures[~before]).any()


def test_controller_does_not_wind_up_and_cuts_dosing_when_pressure_collapses() -> None:
    ecu = Ecu()
    for _ in range(round(60 / PERIOD)):  # a pump that delivers nothing
        starved = ecu.update(CUT_BELOW - 1, SYSTEM, 0.5)
    assert starved.duty == 0.0
    recovered = [ecu.update(SYSTEM + 1e4, SYSTEM, 0.5) for _ in range(round(5 / PERIOD))]
    assert recovered[0].duty == 0.5
    assert recovered[-1].speed < recovered[0].speed < starved.speed
    assert ecu.update(CUT_BELOW - 1, SYSTEM, 0.5).duty == 0.0
    assert ecu.update(SYSTEM - 1e5, SYSTEM, 0.5).duty == 0.0  # not before it has recovered


@pytest.mark.parametrize(
    "name",
    [name for name in FAULTS if name not in ("fy_p_tp", "fy_p_ap", "off_p_tp", "off_p_ap") and name not in UNDECLARED],
)
def test_every_fault_that_the_controller_meets_changes_the_run(name: str) -> None:
    """Those of the second logger's sensors are no part of a run."""
    size = 5e4 if "Pa" in FAULTS[name][1] else 1.0 if name.startswith("off_") else 0.5
    healthy, faulty = (
        simulate(BENCH, CYCLES["validation"], faults, 1, 70.0) for faults in ((), (Fault(name, size, 50.0),))
    )
    before = healthy.ecu_t < 50.0
    assert np.array_equal(healthy.ecu[before], faulty.ecu[before])
    assert not np.array_equal(healthy.ecu[~before], faulty.ecu[~before])


@pytest.mark.parametrize(("name", "size"), [("fA_x", 0.5), ("fA_t", 1.0), ("fq_pump", -0.1), ("fy_p_du", 0.0)])
def test_impossible_faults_are_refused(name: str, size: float) -> None:
    with pytest.raises(RigError, match=name):
        Fault(name, size, 10.0)


@pytest.mark.parametrize("name", CYCLES)
@pytest.mark.parametrize("duration", [60.0, 480.0, 1999.5])
def test_cycles_fill_their_duration_and_start_standing(name: str, duration: float) -> None:
    segments = CYCLES[name].segments(duration, np.random.default_rng(1))
    assert sum(segment.duration for segment in segments) == pytest.approx(duration)
    assert segments[0].setpoint is None
    assert segments[0].duration >= 12
    assert all(segment.duty == 0 for segment in segments[:2])


def test_validation_visits_all_modes_within_ninety_seconds() -> None:
    segments = CYCLES["validation"].segments(1000.0, np.random.default_rng(1))
    ends = np.cumsum([segment.duration for segment in segments])
    for begin in range(40, 900, 5):
        seen = [s.duty for s, end in zip(segments, ends, strict=True) if begin < end <= begin + 90]
        assert 0.0 in seen
        assert 1.0 in seen
        assert any(0 < duty < 1 for duty in seen)


def test_training_ends_with_a_pressure_ladder_without_dosing() -> None:
    segments = CYCLES["training"].segments(480.0, np.random.default_rng(1))
    ladder = [segment for segment in segments if segment.setpoint not in (None, SYSTEM)]
    assert {segment.setpoint for segment in ladder} >= {6e5, 12e5}
    assert all(segment.duty == 0 for segment in ladder)
    assert {segment.duty for segment in segments} >= {0.0, 1.0}


def test_drive_differs_with_the_seed_only() -> None:
    first, second, other = (CYCLES["drive"].segments(300.0, np.random.default_rng(s)) for s in (1, 1, 2))
    assert first == second != other

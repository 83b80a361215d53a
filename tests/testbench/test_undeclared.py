"""Faults that no model declares: each changes the plant from its onset on as its text says, and nothing before."""

import numpy as np
import pytest

from faultline.testbench.bus import Knowledge
from faultline.testbench.cycles import CYCLES
from faultline.testbench.day import CALM
from faultline.testbench.errors import RigError
from faultline.testbench.faults import Course, Fault
from faultline.testbench.plant import Array
from faultline.testbench.sensor_box import SensorBox
from faultline.testbench.simulation import Run, simulate
from faultline.testbench.undeclared import UNDECLARED
from faultline.testbench.vehicles import BENCH

ONSET_S, SECONDS = 50.0, 110.0
P_TP, P_BP, P_AP, P_DU = range(4)
Y_P_DU, N_P = range(2)


def run(*faults: Fault) -> Run:
    return simulate(BENCH, CYCLES["validation"], faults, 1, SECONDS)


@pytest.fixture(scope="module")
def healthy() -> Run:
    return run()


def severe(name: str, course: Course = "abrupt") -> Run:
    return run(Fault(name, UNDECLARED[name].severe, ONSET_S, course))


def late(of: Run, column: int) -> Array:
    """A pressure a while after the onset."""
    return np.asarray(of.pressures[of.t > ONSET_S + 10.0, column])


def speed(of: Run) -> Array:
    return np.asarray(of.ecu[of.ecu_t > ONSET_S + 10.0, N_P])


@pytest.mark.parametrize("name", UNDECLARED)
def test_each_changes_the_run_from_its_onset_on(healthy: Run, name: str) -> None:
    faulty = severe(name)
    before = healthy.ecu_t < ONSET_S
    assert np.array_equal(healthy.ecu[before], faulty.ecu[before])
    assert not np.array_equal(healthy.ecu[~before], faulty.ecu[~before])


@pytest.mark.parametrize("name", UNDECLARED)
def test_each_is_gone_when_it_goes(healthy: Run, name: str) -> None:
    """Intermittent: there for 20 s, then 40 s not, and the plant comes back to where it is without."""
    faulty = severe(name, "intermittent")
    again = (healthy.t > ONSET_S + 50.0) & (healthy.t < ONSET_S + 59.0)
    off = np.abs(faulty.pressures[again] - healthy.pressures[again]).mean(axis=0)
    assert (off < [300.0, 300.0, 3e4, 3e4]).all()


def test_air_costs_the_pump_flow_and_the_tank_filter_passes_as_much_as_before(healthy: Run) -> None:
    faulty = severe("air_tp")
    assert late(faulty, P_TP).mean() == pytest.approx(late(healthy, P_TP).mean(), abs=100.0)
    assert late(faulty, P_BP).mean() < late(healthy, P_BP).mean() - 100.0, "the pump's filter passes the air too"
    assert speed(faulty).mean() > 1.1 * speed(healthy).mean()


def test_pressure_behind_the_return_orifice_saves_flow(healthy: Run) -> None:
    assert speed(severe("return_kinked")).mean() < 0.95 * speed(healthy).mean()


@pytest.mark.parametrize("name", ["return_worn", "nozzle_worn", "valve_open", "fluid"])
def test_what_passes_more_needs_more_flow(healthy: Run, name: str) -> None:
    assert speed(severe(name)).mean() > 1.02 * speed(healthy).mean()


def test_a_valve_that_sticks_open_passes_at_idle(healthy: Run) -> None:
    idle = (healthy.ecu[:, 2] == 0.0) & (healthy.ecu_t > ONSET_S + 3.0)
    assert idle.any()
    assert severe("valve_open").ecu[idle, N_P].mean() > 1.2 * healthy.ecu[idle, N_P].mean()


def test_a_valve_that_sticks_shut_raises_the_pressure_before_it(healthy: Run) -> None:
    drop = {k: (late(of, P_AP) - late(of, P_DU)).mean() for k, of in (("no", healthy), ("yes", severe("inlet_sticks")))}
    assert drop["yes"] - drop["no"] == pytest.approx(0.5e5, rel=0.1)


def test_a_weak_motor_does_not_reach_the_pressure(healthy: Run) -> None:
    assert late(severe("supply_low"), P_AP).mean() < 0.9 * late(healthy, P_AP).mean()


def test_a_relief_valve_that_opens_early_holds_the_pressure_down() -> None:
    assert late(severe("relief_low"), P_AP).max() < 9.8e5


def test_air_in_the_hose_makes_it_softer(healthy: Run) -> None:
    ripple = [np.abs(np.diff(late(of, P_AP))).mean() for of in (severe("air_hose"), healthy)]
    assert ripple[0] < 0.8 * ripple[1]


def test_a_fouled_membrane_is_slow(healthy: Run) -> None:
    now = healthy.ecu_t > ONSET_S + 10.0
    step = [np.abs(np.diff(of.ecu[now, Y_P_DU])).mean() for of in (severe("slow_p_du"), healthy)]
    assert step[0] < step[1]


def test_swapped_plugs_swap_what_both_sensors_feel() -> None:
    faulty = severe("swapped")
    at = np.searchsorted(faulty.t, faulty.ecu_t - 0.001, side="right") - 1
    far = np.abs(faulty.ecu[1:, Y_P_DU, None] - faulty.pressures[at[1:]][:, [P_AP, P_DU]])
    now = faulty.ecu_t[1:] > ONSET_S
    assert far[now, 0].mean() < far[now, 1].mean()
    assert far[~now, 1].mean() < far[~now, 0].mean()
    box = SensorBox(BENCH.external, [Fault("swapped", 1.0, ONSET_S)], CALM, *map(np.random.default_rng, (1, 2)))
    read = box.add(Knowledge(1e6, 20.0, 0.0, 0.0), faulty, 100.0).p_ap
    true = faulty.pressures[np.searchsorted(faulty.t, 100.0), P_DU]
    assert read == pytest.approx(true, abs=3e3)


def test_a_size_beyond_the_largest_is_refused() -> None:
    with pytest.raises(RigError, match=r"size 7 of relief_low is not in 0..6"):
        Fault("relief_low", 7.0, 10.0)

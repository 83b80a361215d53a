"""Hidden effects: each can be seen in the logs, leaves the balance of volumes alone, and says what is wrong with it."""

import math
from collections.abc import Mapping

import numpy as np
import pytest

from faultline.testbench.branches import Branch, Creep, Leak, Relief
from faultline.testbench.bus import Knowledge
from faultline.testbench.cycles import CYCLES
from faultline.testbench.effects import EFFECTS, PROFILES, checked, fitted
from faultline.testbench.errors import RigError
from faultline.testbench.faults import ON_S, PERIOD_S, Fault
from faultline.testbench.hose import Hose
from faultline.testbench.plant import SYSTEM_PRESSURE, Array, Plant
from faultline.testbench.pump import PumpParameters
from faultline.testbench.restriction import TURBULENT, Restriction
from faultline.testbench.sensors import EcuSensors, Membrane
from faultline.testbench.simulation import MARGIN, STEP, Run, simulate
from faultline.testbench.units import ATMOSPHERE, BAR, ML
from faultline.testbench.valve import FREQUENCY, Needle, PulseWidth
from faultline.testbench.vehicles import VEHICLES

BENCH = VEHICLES["bench"]
WINDOW = 10.0  # s
NOISE = (4e2, 8e2, 1e3, 0.05)  # sd of a sample: p_tp, p_ap, p_du [Pa], n_p [rev/s]


def run(effects: Mapping[str, float], *faults: Fault, cycle: str = "training", duration: float = 160.0) -> Run:
    return simulate(BENCH, CYCLES[cycle], faults, seed=4, duration=duration, effects=effects)


def seen(of: Run, effects: Mapping[str, float]) -> Array:
    """10 s means of what the sensors show, (windows, 4), as they would be without noise of the external ones."""
    t = np.arange(0.0, of.t[-1] - 1.0, 0.1)
    gain = 1.0 + effects.get("sensor_gain", 0.0)
    delay = effects.get("log_delay", 0.0)
    late = np.searchsorted(of.ecu_t, t - delay, side="right") - 1
    columns = [
        np.interp(t, of.t, of.pressures[:, 0]),
        ATMOSPHERE + gain * (np.interp(t, of.t, of.pressures[:, 2]) - ATMOSPHERE),
        of.ecu[late, Knowledge._fields.index("p_du")],
        of.ecu[late, Knowledge._fields.index("n_p")],
    ]
    size = round(WINDOW / 0.1)
    windows = len(t) // size
    return np.stack([c[: windows * size].reshape(windows, size).mean(axis=1) for c in columns], axis=1)


@pytest.fixture(scope="module")
def ideal() -> Array:
    return seen(run({}), {})


@pytest.mark.parametrize("name", [name for name in EFFECTS if name != "suction_pulsation"])
def test_at_its_typical_size_every_effect_shows_in_the_logs(ideal: Array, name: str) -> None:
    """Some 10 s mean is off by more than three standard deviations of its noise.

    A pulsation has no mean: `test_rig_pulsation.py` looks at the spread.
    """
    effects = {name: EFFECTS[name].typical}
    found = seen(run(effects), effects)
    off = np.abs(found - ideal) / (np.array(NOISE) / math.sqrt(WINDOW / 0.1))
    assert off.max() > 3.0
    assert np.isfinite(found).all()


@pytest.mark.parametrize("name", [*EFFECTS])
def test_at_its_largest_size_every_effect_still_runs(name: str) -> None:
    found = run({name: EFFECTS[name].largest}, cycle="drive", duration=90.0)
    assert np.isfinite(found.pressures).all()
    assert (found.pressures > 0).all()


def test_there_are_enough_of_them_in_two_sets() -> None:
    assert len(EFFECTS) >= 20
    assert {effect.set for effect in EFFECTS.values()} == {"A", "B"}
    assert checked(PROFILES["realistic"]) == PROFILES["realistic"]
    assert PROFILES["ideal"] == {}


def test_a_run_with_every_effect_halves_its_step_without_a_difference() -> None:
    effects = {name: effect.typical / 2 for name, effect in EFFECTS.items()}
    coarse, fine = (
        simulate(BENCH, CYCLES["validation"], (), seed=4, duration=100.0, effects=effects, step=step)
        for step in (STEP, STEP / 2)
    )
    rms = np.sqrt(((fine.pressures[1::2] - coarse.pressures) ** 2).mean(axis=0))
    assert (rms < [20, 60, 150, 200]).all()  # Pa


@pytest.mark.parametrize(
    "branch",
    [
        Leak(Restriction.rated(SYSTEM_PRESSURE - ATMOSPHERE, 0.3 * ML, TURBULENT)),
        Relief(9.0 * BAR, 0.5 * ML / BAR),
        Creep(0.2 * ML / BAR, 5.0),
    ],
    ids=["leak", "relief", "creep"],
)
def test_a_branch_takes_what_the_hose_loses(branch: Branch) -> None:
    plant = Plant(fitted(BENCH, {}).plant, PumpParameters(), [branch])
    stored, h = 0.0, 0.002
    start = plant.p_ap
    for _ in range(15_000):
        plant.step(h, 24.0, 0.0)
        stored += h * (plant.q_pump - plant.q_du - plant.q_branches)
    assert plant.q_branches != 0.0
    assert stored == pytest.approx(BENCH.plant.hose.rated * (plant.p_ap - start), abs=1e-9 * ML)


def test_leak_relief_and_creep_are_what_they_say() -> None:
    q, g = Leak(Restriction.rated(SYSTEM_PRESSURE - ATMOSPHERE, 0.3 * ML, TURBULENT)).linear(0.002, SYSTEM_PRESSURE)
    assert q + g * SYSTEM_PRESSURE == pytest.approx(0.3 * ML)
    relief = Relief(9.7 * BAR, 0.4 * ML / BAR)
    assert relief.linear(0.002, 9.6 * BAR) == (0.0, 0.0)
    q, g = relief.linear(0.002, 10.7 * BAR)
    assert q + g * 10.7 * BAR == pytest.approx(0.4 * ML)
    creep = Creep(0.2 * ML / BAR, 5.0)
    for _ in range(2500):  # one time constant at a constant pressure
        q, g = creep.linear(0.002, 11 * BAR)
        creep.took(0.002, q + g * 11 * BAR)
    assert creep.stored == pytest.approx(0.2 * ML * (11 * BAR - ATMOSPHERE) / BAR * (1 - math.exp(-1)), rel=1e-3)


def test_the_hose_is_softer_with_air_and_at_low_pressure() -> None:
    assert Hose(3e-12).compliance(5 * BAR) == 3e-12
    assert Hose(3e-12, stiffening=0.8).compliance(10 * BAR) == pytest.approx(3e-12)
    assert Hose(3e-12, stiffening=0.8).compliance(2 * BAR) > 1.8 * 3e-12
    air = Hose(3e-12, air=15 * ML)
    assert air.compliance(10 * BAR) - 3e-12 == pytest.approx(15e-6 * ATMOSPHERE / (10 * BAR) ** 2)


@pytest.mark.parametrize(
    ("needle", "duty", "expected"),
    [
        (Needle(), 0.4, 0.4),
        (Needle(opens_after=0.02), 0.4, 0.4 - 0.02 * FREQUENCY),
        (Needle(shuts_after=0.03), 0.4, 0.4 + 0.03 * FREQUENCY),
        (Needle(opens_after=0.02, shuts_after=0.03), 0.05, 0.0),  # too short a pulse moves nothing
        (Needle(opens_after=0.02, full_lift=0.17), 1.0, 1.17),  # held open: no delay, full lift
        (Needle(full_lift=0.17), 0.9, 0.9),
    ],
)
def test_the_needle(needle: Needle, duty: float, expected: float) -> None:
    valve, h = PulseWidth(needle), 0.002
    settled = [valve.opening(h, duty) for _ in range(round(600 / h))][round(2 / h) :]
    assert sum(settled) / len(settled) == pytest.approx(expected, abs=0.003)


def test_the_membrane_lags_and_sticks() -> None:
    lag = Membrane(EcuSensors(lag_p_du=0.4), 0.02)
    lag.feel(0.0)
    assert [lag.feel(1.0) for _ in range(20)][-1] == pytest.approx(1 - math.exp(-1))
    stick = Membrane(EcuSensors(backlash_p_du=2.0), 0.02)
    assert [stick.feel(p) for p in (0.0, 0.9, 3.0, 2.5, 1.5, 0.0)] == [0.0, 0.0, 2.0, 2.0, 2.0, 1.0]
    plain = Membrane(EcuSensors(), 0.02)
    assert [plain.feel(p) for p in (1.0, 5.0, 2.0)] == [1.0, 5.0, 2.0]


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ({"dragons": 1.0}, "there is no effect 'dragons'; choose one of laminar_filters"),
        ({"leak": 0.0}, "size 0 of leak is not in 0..1 mL/s, 0 excluded"),
        ({"leak": 3.0}, "size 3 of leak is not in 0..1 mL/s, 0 excluded"),
        ({"leak": math.nan}, "size nan of leak"),
    ],
)
def test_impossible_effects_are_refused(effects: dict[str, float], message: str) -> None:
    with pytest.raises(RigError, match=message.replace(".", r"\.")):
        simulate(BENCH, CYCLES["drive"], (), 1, 60.0, effects=effects)


def test_faults_grow_come_and_go() -> None:
    growing = Fault("fA_du", 0.6, 100.0, "growing")
    assert [growing.strength(t) for t in (99.0, 100.0, 160.0, 220.0, 900.0)] == pytest.approx([0, 0, 0.3, 0.6, 0.6])
    coming = Fault("fA_du", 0.6, 100.0, "intermittent")
    assert coming.strength(100.0 + ON_S - 1) == coming.strength(100.0 + PERIOD_S) == 0.6
    assert coming.strength(100.0 + ON_S + 1) == coming.strength(99.0) == 0.0
    with pytest.raises(RigError, match="a sensor is on or off; use abrupt or intermittent"):
        Fault("off_p_du", 1.0, 100.0, "growing")
    with pytest.raises(RigError, match="profile 'sudden' of fA_du is not known; use abrupt, growing, intermittent"):
        Fault("fA_du", 0.6, 100.0, "sudden")  # type: ignore[arg-type]


def test_two_faults_at_once_and_a_leak_show_both() -> None:
    clogged, leaking = Fault("fA_du", 0.7, 60.0), Fault("leak_ap", 0.4, 60.0, "intermittent")
    alone, both = run({}, clogged, duration=200.0), run({}, clogged, leaking, duration=200.0)
    healthy = run({}, duration=200.0)
    late = (healthy.t > 61.0 + PERIOD_S) & (healthy.t < 60.0 + PERIOD_S + ON_S - MARGIN)
    drop = [float((r.pressures[late, 2] - r.pressures[late, 3]).mean()) for r in (healthy, alone, both)]
    assert drop[1] > 2 * drop[0]
    assert drop[2] > 2 * drop[0]
    n_p = Knowledge._fields.index("n_p")
    there = (both.ecu_t > 61.0 + PERIOD_S) & (both.ecu_t < 60.0 + PERIOD_S + ON_S)
    gone = (both.ecu_t > 65.0 + ON_S) & (both.ecu_t < 60.0 + PERIOD_S)
    more = both.ecu[:, n_p] - alone.ecu[:, n_p]
    assert more[there].mean() == pytest.approx(0.4 * ML / 0.1e-6, rel=0.4)  # rev/s to make up for the leak
    assert abs(more[gone].mean()) < 1.0

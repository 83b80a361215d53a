"""What the thesis says of figures 5.8 (healthy) and 5.9 (clogged dosing-unit filter), on what our loggers write."""

from pathlib import Path

import numpy as np
import pytest

from faultline.testbench.bus import load_dbc
from faultline.testbench.cycles import CYCLES, DOSING_FROM
from faultline.testbench.ecu import CUT_BELOW, RESUME_WITHIN
from faultline.testbench.faults import Fault
from faultline.testbench.plant import Array
from faultline.testbench.pump import PumpParameters
from faultline.testbench.recorded import Track, read_recording
from faultline.testbench.recording import record
from faultline.testbench.request import Request
from faultline.testbench.units import ATMOSPHERE, BAR
from faultline.testbench.vehicles import VEHICLES

SEEDS = (1, 2, 3)
TRAINING, VALIDATION = 360.0, 220.0  # s
LADDER = (8.0, 6.0, 7.0, 9.0, 11.0, 12.0, 10.0)  # bar
RUNG = 0.3 * (TRAINING - DOSING_FROM) / len(LADDER)  # s
LADDER_FROM = TRAINING - len(LADDER) * RUNG  # s; no dosing from here on
CLOGGED = Fault("fA_du", 0.93, 100.0)
"""So that the relief valve's 13.5 bar reach 9.7 bar behind the filter without dosing, and less than 7 bar with it."""

RELIEF = PumpParameters().relief_pressure
Bus = dict[str, Track]


def written(folder: Path, cycle: str, seed: int, faults: tuple[Fault, ...], duration: float) -> Bus:
    """The signals of an instrumented vehicle: both pressures on one clock."""
    request = Request("r", VEHICLES["bench"], CYCLES[cycle], faults, seed, duration, kind="instrumented")
    found, _ = record(request, load_dbc(), folder / "out", folder / "truth", force=True, progress=lambda _: None)
    return dict(read_recording(found).bus)


@pytest.fixture(scope="module", params=SEEDS)
def training(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Bus:
    return written(tmp_path_factory.mktemp("rig"), "training", request.param, (), TRAINING)


@pytest.fixture(scope="module", params=SEEDS)
def pair(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Bus, Bus]:
    """The validation cycle, healthy and clogged."""
    healthy, clogged = (
        written(tmp_path_factory.mktemp("rig"), "validation", request.param, faults, VALIDATION)
        for faults in ((), (CLOGGED,))
    )
    return healthy, clogged


def at(track: Track, t: Array) -> Array:
    """The last value at each of `t` [s]."""
    return np.asarray(track.value[np.searchsorted(track.t, t, side="right") - 1])


def between(track: Track, start: float, end: float) -> Array:
    return np.asarray(track.value[(track.t > start) & (track.t < end)])


def test_the_tank_side_is_near_one_bar(training: Bus) -> None:
    p_tp = training["y_p_tp"].value
    assert 0.95 * BAR < p_tp.min() < p_tp.max() < 1.05 * BAR


def test_after_pump_and_dosing_unit_are_a_constant_offset_apart(training: Bus) -> None:
    t, p_ap = training["y_p_ap"]
    offset = (p_ap - np.interp(t, *training["y_p_du"]))[t > 40.0]
    dynamics = p_ap[t > 40.0].std()
    assert 10e2 < offset.mean() < 60e2  # Pa: the filter's drop at 2 to 3.2 mL/s is 23 to 60 mbar
    assert offset.std() < 0.05 * dynamics
    assert dynamics > 1 * BAR


def test_pump_speed_drives_the_pressure_through_a_storage(training: Bus) -> None:
    """dp/dt = a + b n_p - c sqrt(p) explains the ladder; p as any function of n_p does not."""
    t, p_du = (column[training["y_p_du"].t > LADDER_FROM] for column in training["y_p_du"])
    n_p = at(training["n_p"], t)
    rate = np.gradient(p_du, t)
    dynamic = np.column_stack([np.ones_like(t), n_p, np.sqrt(p_du - ATMOSPHERE)])
    static = np.column_stack([n_p**k for k in range(4)])
    coefficients, unexplained = fitted(dynamic, rate)
    assert unexplained < 0.1
    assert coefficients[1] == pytest.approx(0.1 / 0.35 * BAR, rel=0.1)  # mL/rev over mL/bar
    _, unexplained = fitted(static, p_du)
    assert np.sqrt(unexplained) * p_du.std() > 30 * 1e3  # thirty times the sensor's noise


def fitted(columns: Array, y: Array) -> tuple[Array, float]:
    """Coefficients, and the share of the variance that they leave."""
    found: Array = np.asarray(np.linalg.lstsq(columns, y, rcond=None)[0], dtype=np.float64)
    return found, float((y - columns @ found).var() / y.var())


def test_each_rung_of_the_ladder_has_a_transient(training: Bus) -> None:
    """The speed runs ahead of where it settles, up or down; the pressure moves through the step and settles."""
    before = 10.0
    for k, level in enumerate(LADDER):
        start, end = LADDER_FROM + k * RUNG, LADDER_FROM + (k + 1) * RUNG
        p_du, n_p = training["y_p_du"], training["n_p"]
        assert between(p_du, end - 5, end).mean() == pytest.approx(level * BAR, abs=0.02 * BAR)
        if k:  # dosing has just ended before the first
            assert between(p_du, start, start + 0.5).mean() == pytest.approx(before * BAR, abs=0.5 * BAR)
        settled, early = between(n_p, end - 5, end).mean(), between(n_p, start, start + 4.0)
        if level > before:
            assert early.max() > settled + 1.0  # rev/s; noise is 0.05
        else:
            assert early.min() < settled - 1.0
        before = level


def cuts(bus: Bus) -> tuple[Array, Array]:
    """At the controller's frames (times [s]), whether the duty cycle is zero although a dose is requested."""
    t, duty = bus["dc_dose"]
    wanted = bus["def_requested_dosing"]  # every 50 ms
    requested = (at(wanted, t) > 0.0) & (at(wanted, t + 0.06) > 0.0)
    return t, (duty == 0.0) & requested & (t > CLOGGED.onset_s + 5.0)


def test_clogged_the_dose_is_cut_when_pressure_collapses_again_and_again(pair: tuple[Bus, Bus]) -> None:
    healthy, clogged = pair
    assert not cuts(healthy)[1].any()
    t, cut = cuts(clogged)
    begins, ends = (np.flatnonzero(np.diff(cut.astype(int)) == edge) for edge in (1, -1))
    assert len(begins) > 50
    assert len(ends) > 50
    p_du = clogged["y_p_du"].value
    # The controller decides between two frames: around the cut the lowest, around the return the highest of two.
    lowest = np.minimum(p_du[begins], p_du[begins + 1])
    highest = np.maximum(p_du[ends], p_du[ends + 1])
    setpoint = 10.0 * BAR
    assert np.median(lowest) < CUT_BELOW + 1.0 * BAR
    assert np.median(highest) > setpoint - RESUME_WITHIN - 0.1 * BAR
    late = t > CLOGGED.onset_s + 5.0
    assert p_du[late].min() < CUT_BELOW


def test_clogged_the_collapse_needs_a_large_dose(pair: tuple[Bus, Bus]) -> None:
    _, clogged = pair
    t, cut = cuts(clogged)
    requested = at(clogged["def_requested_dosing"], t)
    late = t > CLOGGED.onset_s + 5.0
    large, small = (requested > 0.5 * requested.max()), (requested > 0) & (requested < 0.2 * requested.max())
    assert cut[late & large].mean() > 0.3
    assert cut[late & small].mean() < 0.7 * cut[late & large].mean()
    idle = late & (at(clogged["def_requested_dosing"], t - 10.0) == 0.0) & (requested == 0.0)
    assert clogged["y_p_du"].value[idle].min() > 9.5 * BAR


def test_clogged_the_tank_side_is_not_affected(pair: tuple[Bus, Bus]) -> None:
    """But for the flow that the pump draws: the means differ by a hundredth of what the pressure side does."""
    healthy, clogged = pair
    shift = {
        signal: abs(
            between(clogged[signal], 105.0, VALIDATION).mean() - between(healthy[signal], 105.0, VALIDATION).mean()
        )
        for signal in ("y_p_tp", "y_p_ap")
    }
    assert shift["y_p_ap"] > 3.0 * BAR
    assert shift["y_p_tp"] < 0.02 * BAR
    assert 0.9 * BAR < between(clogged["y_p_tp"], 105.0, VALIDATION).mean() < 1.1 * BAR


def test_clogged_there_are_dynamics_between_after_pump_and_dosing_unit(pair: tuple[Bus, Bus]) -> None:
    spread = []
    for bus in pair:
        t, p_ap = bus["y_p_ap"]
        spread.append(float((p_ap - np.interp(t, *bus["y_p_du"]))[t > 105.0].std()))
    assert spread[1] > 15 * spread[0]


def test_the_relief_valve_protects_the_hose(pair: tuple[Bus, Bus]) -> None:
    """Thesis 4.2: without it the pump would push to 30 bar."""
    healthy, clogged = pair
    assert healthy["y_p_ap"].value.max() < RELIEF - 1.0 * BAR
    assert RELIEF < clogged["y_p_ap"].value.max() < RELIEF + 1.0 * BAR

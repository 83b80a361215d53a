"""Plants of other structures: their integrators agree, their recordings are what a logger hands over."""

from dataclasses import replace
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from faultline.testbench.bus import load_dbc
from faultline.testbench.command import main
from faultline.testbench.errors import RigError
from faultline.testbench.families.circuit import implicit_euler, reduced, runge_kutta, tr_bdf2
from faultline.testbench.families.control import Motor, Pulses, Relay
from faultline.testbench.families.cycle import STANDING_S, asked
from faultline.testbench.families.draw import FAMILIES, plant_of
from faultline.testbench.families.plant import on_a_day, run
from faultline.testbench.families.recording import record, truth
from faultline.testbench.families.sensed import PLACE, frames
from faultline.testbench.faults import Fault
from faultline.testbench.streams import stream
from faultline.testbench.traffic import Frame
from faultline.testbench.units import BAR

DURATION_S = 70.0


def test_the_integrators_agree() -> None:
    plant = plant_of("changing", 1)  # whose valve does not pulse
    cycle = asked(plant.style, DURATION_S, stream(1, "cycle"))
    runs = [
        run(replace(plant, integrator=integrator, step=step), cycle, DURATION_S).pressures[:: round(0.05 / step)]
        for integrator, step in (
            (implicit_euler, 0.01),
            (implicit_euler, 0.005),
            (runge_kutta, 0.01),
            (tr_bdf2, 0.01),
            (reduced, 0.01),
        )
    ]
    for other in runs[1:]:
        count = min(len(other), len(runs[0]))
        late = slice(round((STANDING_S + 10.0) / 0.05), count)
        assert np.sqrt(np.mean((other[late] - runs[0][late]) ** 2)) < 500.0


@pytest.mark.parametrize(
    ("fault", "size", "moves"),
    [
        ("fA_t", 0.5, {"y_p_tp": -1}),
        ("fA_du", 0.5, {"y_p_ap": 1}),
        ("fA_ori", 0.3, {"n_p": -1}),
        ("fq_pump", 0.2, {"n_p": 1}),
        ("fy_p_du", 1e5, {"y_p_ap": -1, "n_p": -1}),
        ("leak_ap", 1.0, {"n_p": 1}),
    ],
)
def test_a_fault_moves_what_it_must_from_its_onset_on(fault: str, size: float, moves: dict[str, int]) -> None:
    """At a pressure that is held, by what the controller reads."""
    plant, onset_s = plant_of("stepped", 2), 50.0
    style = replace(plant.style, doses=(DURATION_S, DURATION_S), idle=1.0, steady=1.0)
    cycle = asked(style, DURATION_S, stream(1, "cycle"))
    healthy = run(plant, cycle, DURATION_S)
    faulty = run(plant, cycle, DURATION_S, [Fault(fault, size, onset_s)])
    before, after = slice(round(onset_s / plant.step)), slice(round((onset_s + 10.0) / plant.step), None)
    np.testing.assert_array_equal(faulty.pressures[before], healthy.pressures[before])
    read = {
        "n_p": (faulty.speed - healthy.speed)[after].mean(),
        **{name: (faulty.pressures - healthy.pressures)[after, k].mean() for name, k in PLACE.items()},
    }
    assert {name: int(np.sign(read[name])) for name in moves} == moves
    assert all(abs(read[name]) > (0.3 if name == "n_p" else 100.0) for name in moves)


def test_a_sensor_that_is_off_is_sent_so_and_other_faults_are_refused() -> None:
    plant = plant_of("stepped", 2)
    cycle = asked(plant.style, DURATION_S, stream(1, "cycle"))
    course = run(plant, cycle, DURATION_S, [Fault("fy_p_ap", 5e4, 30.0)])
    clean = run(plant, cycle, DURATION_S)
    sent, usual = (
        [decoded(frame) for frame in frames(of, plant.seen, load_dbc(), stream(1, "frames"))] for of in (course, clean)
    )
    off = [a - b for a, b in zip(sent, usual, strict=True) if a is not None and b is not None]
    assert off[0] == 0.0
    assert off[-1] == pytest.approx(50.0, abs=1.0)
    with pytest.raises(RigError, match=r"^off_p_du: plants of the families have fA_t, fA_p, .*, leak_ap$"):
        run(plant, cycle, DURATION_S, [Fault("off_p_du", 1.0, 30.0)])


def decoded(frame: Frame) -> float | None:
    """The reading of `y_p_ap` [kPa] in a frame."""
    message = load_dbc().sensor_box.message
    if frame.frame_id != message.frame_id:
        return None
    values: Any = message.decode(frame.data)
    return float(values["y_p_ap"])


def test_at_rest_what_flows_in_flows_out() -> None:
    circuit = plant_of("stepped", 2).circuit
    x = circuit.rest
    for _ in range(6000):
        x = implicit_euler(circuit, x, 0.01, 25.0, 0.5)
    p_tp, p_bp, p_ap, p_du = x
    flows = [
        circuit.k_t * sqrt(circuit.ambient - p_tp),
        circuit.k_p * sqrt(p_tp - p_bp),
        circuit.delivered(25.0, p_bp, p_ap),
        circuit.k_f * sqrt(p_ap - p_du),
        (circuit.k_o + 0.5 * circuit.k_v) * sqrt(p_du - circuit.ambient),
    ]
    assert flows == pytest.approx([flows[0]] * 5, rel=2e-3)


@pytest.mark.parametrize("family", FAMILIES)
def test_a_plant_holds_its_pressure_and_is_its_seeds(family: str, tmp_path: Path) -> None:
    plant = plant_of(family, 3)
    course = run(plant, asked(plant.style, DURATION_S, stream(3, "cycle")), DURATION_S)
    late = course.t > STANDING_S + 15.0
    assert course.pressures[late, 3].min() > 5.0 * BAR
    assert course.pressures[late, 3].max() < 16.0 * BAR
    assert course.pressures[:, :2].min() > 0.3 * BAR
    first, second = (
        (record(plant_of(family, 3), "a", 7, DURATION_S, load_dbc(), tmp_path / n) / "can.log").read_bytes()
        for n in "xy"
    )
    assert first == second
    other = record(plant, "a", 8, DURATION_S, load_dbc(), tmp_path / "z") / "can.log"
    assert other.read_bytes() != first


def test_plants_of_a_family_differ_and_effects_are_hidden_on_demand() -> None:
    one, two = plant_of("slow", 1), plant_of("slow", 2)
    assert one.circuit != two.circuit
    hidden = plant_of("slow", 1, {"air": 5e-6})
    assert replace(hidden.circuit, air=0.0) == one.circuit
    assert "[hidden]\nair = 5e-06" in truth(hidden)
    assert "[hidden]\n\n" in truth(one)
    with pytest.raises(RigError, match="there is no family 'fast'"):
        plant_of("fast", 1)


def test_conditions_differ_between_recordings_where_a_family_says_so() -> None:
    plant = plant_of("changing", 1)
    days = [on_a_day(plant, stream(seed, "day")) for seed in range(200)]
    zeros = np.array([day.seen.sensors["y_p_ap"].zero for day in days])
    assert np.std(zeros) == pytest.approx(300.0, rel=0.2)
    assert np.std(np.log([day.circuit.leakage for day in days])) == pytest.approx(0.05, rel=0.2)
    same = plant_of("stepped", 1)
    assert on_a_day(same, stream(1, "day")) == on_a_day(same, stream(2, "day"))


def test_a_relay_switches_at_its_band_and_pulses_open_for_their_part() -> None:
    relay = Relay(band=0.2, idle=20.0, dose=10.0, swing=5.0)
    speeds = [relay(error * BAR, 0.0, 0.1) for error in (0.5, 0.0, -0.1, -0.3, 0.0, 0.3)]
    assert speeds == [25.0, 25.0, 25.0, 15.0, 15.0, 25.0]
    pulses = Pulses(3.7)
    assert np.mean([pulses.step(0.01, 0.3) for _ in range(10_000)]) == pytest.approx(0.3, abs=0.005)
    motor = Motor(lag=0.2)
    assert [motor.step(0.1, 10.0) for _ in range(40)][-1] == pytest.approx(10.0, rel=1e-3)


def test_the_command_writes_both_recordings_and_the_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["family", "relay", "--number", "2", "--duration", "60", "--out", str(tmp_path / "out")]
    assert main([*words, "--truth", str(tmp_path / "truth"), "--effect", "leak=2e-7"]) == 0
    assert capsys.readouterr().out.split() == [str(tmp_path / "out" / f"relay-2-{n}") for n in ("training", "held-out")]
    assert "leak = 2e-07" in (tmp_path / "truth" / "relay-2.toml").read_text()
    assert main([*words, "--truth", str(tmp_path / "truth"), "--effect", "rust=1"]) == 2
    assert "there is no 'rust'" in capsys.readouterr().err


def test_a_recordings_dbc_says_how_often_its_frames_come(tmp_path: Path) -> None:
    plant = plant_of("ripple", 1)
    folder = record(plant, "short", 1, DURATION_S, load_dbc(), tmp_path)
    dbc = load_dbc(folder / "uds.dbc")
    periods = {sender.message.name: sender.period for sender in (*dbc.controllers, dbc.sensor_box)}
    assert (periods["UDS_ECU"], periods["UDS_SENSORS"]) == (plant.seen.bus.ecu, plant.seen.bus.box)
    assert periods["A1SCRDSI1"] == 0.05

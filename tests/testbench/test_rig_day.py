"""Days: drawn from the seed with the spread that is stated, seen by the sensors, told in the truth file."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from faultline.analysis.evaluation.truth import load_truth
from faultline.testbench.bus import Knowledge, load_dbc
from faultline.testbench.command import main
from faultline.testbench.cycles import CYCLES, STANDING
from faultline.testbench.day import CALM, Day, day_of
from faultline.testbench.effects import PROFILES
from faultline.testbench.play import live
from faultline.testbench.recorded import read_recording
from faultline.testbench.recording import record
from faultline.testbench.request import Kind, Request
from faultline.testbench.simulation import Run, simulate
from faultline.testbench.traffic import frames
from faultline.testbench.units import MBAR
from faultline.testbench.vehicles import VEHICLES

BENCH = VEHICLES["bench"]
SHORT = ["record", "--cycle", "validation", "--duration", "60", "--kind", "instrumented", "--seed", "7"]


def run(day: Day) -> Run:
    return simulate(BENCH, CYCLES["validation"], (), seed=4, duration=90.0, effects=PROFILES["everyday"], day=day)


def steady(of: Run) -> tuple[float, float, float]:
    """p_tp [Pa], y_p_du [Pa], n_p [rev/s]: means before the first dose, at 10 bar."""
    late, told = (of.t > 32.0) & (of.t < 40.0), (of.ecu_t > 32.0) & (of.ecu_t < 40.0)
    known = of.ecu[told].mean(axis=0)
    p_du, n_p = (float(known[Knowledge._fields.index(name)]) for name in ("p_du", "n_p"))
    return float(of.pressures[late, 0].mean()), p_du, n_p


def test_days_have_the_spread_that_is_stated() -> None:
    days = [day_of("everyday", seed, "drive") for seed in range(400)]
    logs = np.log([day.viscosity for day in days])
    assert logs.std() == pytest.approx(0.05, rel=0.15)  # four standard errors of a spread of 400
    for name, sd in (("zero_p_tp", 1.0), ("zero_p_ap", 3.0), ("zero_p_du", 3.0), ("level", 5.0)):
        values = np.array([getattr(day, name) for day in days]) / MBAR
        assert values.std() == pytest.approx(sd, rel=0.15), name
        assert abs(values.mean()) < 0.2 * sd, name
    assert day_of("everyday", 3, "drive") == day_of("everyday", 3, "drive")
    assert day_of("everyday", 3, "drive") != day_of("everyday", 3, "validation")
    assert day_of("realistic", 3, "drive") == CALM


def test_each_condition_does_what_it_says() -> None:
    plain = steady(run(CALM))
    level = steady(run(Day(level=20 * MBAR)))
    assert level[0] - plain[0] == pytest.approx(20 * MBAR, rel=0.02)
    thin = steady(run(Day(viscosity=0.8)))
    leak = BENCH.pump.leakage * 9e5 / BENCH.pump.displacement  # rev/s that make up for the leakage
    assert thin[2] - plain[2] == pytest.approx(leak * (1 / 0.8 - 1), rel=0.15)
    # The controller holds what its sensor says: the reading stays, the pressure and with it the flow fall.
    wrong = steady(run(Day(zero_p_du=100 * MBAR)))
    assert wrong[1] == pytest.approx(plain[1], abs=3 * MBAR)
    assert wrong[2] < plain[2] - 0.05


@pytest.mark.parametrize("kind", ["instrumented", "bench"])
def test_both_loggers_read_the_zeros(tmp_path: Path, kind: Kind) -> None:
    """At rest, before anything flows: the day's zero is added to what the sensor reads otherwise."""
    day, read = Day(zero_p_tp=30 * MBAR, zero_p_ap=-60 * MBAR), {}
    for name, conditions in (("plain", CALM), ("day", day)):
        wanted = Request(name, BENCH, CYCLES["validation"], (), 3, 60.0, kind=kind, day=conditions)
        folder, _ = record(
            wanted, load_dbc(), tmp_path / "out", tmp_path / "truth", force=True, progress=lambda _: None
        )
        recorded = read_recording(folder)
        tracks = recorded.bus if kind == "instrumented" else recorded.external
        read[name] = [float(tracks[s].value[tracks[s].t < STANDING - 5].mean()) for s in ("y_p_tp", "y_p_ap")]
    moved = np.array(read["day"]) - np.array(read["plain"])
    assert moved == pytest.approx([30 * MBAR, -60 * MBAR], abs=1.5 * MBAR)


def test_the_truth_says_what_the_day_was(tmp_path: Path) -> None:
    where = ["--out", str(tmp_path / "out"), "--truth", str(tmp_path / "truth")]
    for profile in ("everyday", "realistic"):
        assert main([*SHORT, *where, "--profile", profile, "--id", profile]) == 0
    told = tomllib.loads((tmp_path / "truth" / "everyday.toml").read_text())
    assert told["day"] == day_of("everyday", 7, "validation").truth()
    assert load_truth(tmp_path / "truth" / "everyday.toml", "everyday").day == told["day"]
    assert "day" not in tomllib.loads((tmp_path / "truth" / "realistic.toml").read_text())
    logs = [(tmp_path / "out" / name / "can.log").read_bytes() for name in ("everyday", "realistic")]
    assert logs[0] != logs[1]


def test_what_is_played_has_the_day_of_what_is_recorded() -> None:
    wanted = Request("r", BENCH, CYCLES["drive"], (), 4, 60.0, PROFILES["everyday"], kind="instrumented")
    wanted = replace(wanted, day=day_of("everyday", 4, "drive"), effects={**wanted.effects, "suction_pulsation": 10.0})
    whole = simulate(BENCH, wanted.cycle, (), 4, 60.0, effects=wanted.effects, day=wanted.day)
    assert [*live(wanted, load_dbc())] == [*frames(wanted, load_dbc(), [whole])]


def test_list_tells_the_profiles(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    out = capsys.readouterr().out
    assert "profiles" in out
    for name in PROFILES:
        assert f"  {name}  " in out

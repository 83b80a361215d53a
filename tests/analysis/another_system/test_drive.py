"""A made linear drive at 200 Hz with one test: its alarm is a fault, one of those that the test is sensitive to."""

import csv
import json
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from faultline.analysis.calibration.command import main as calibrate
from faultline.analysis.discrepancy.command import main as discover
from faultline.analysis.export import main as export
from faultline.analysis.model import load_model
from faultline.analysis.tuning.command import main as tune
from faultline.service.diagnose.command import main as diagnose

PERIOD_S, STEPS = 0.005, 10
M, FV, F_C, F_0, GAIN, V_0 = 11.6, 24.8, 20.4, -3.16, 35.15, 0.002
NOISE = 0.004
"""Of the velocity [m/s]."""


class Drive(NamedTuple):
    folder: Path
    bundle: Path


def moved(folder: Path, name: str, seconds: float, seed: int, friction: float = 0.0, offset: float = 0.0) -> Path:
    """A run of levels of voltage above what friction holds; from two thirds on the encoder is off by `offset`."""
    rng, ticks = np.random.default_rng(seed), round(seconds / PERIOD_S)
    lengths = rng.integers(60, 300, ticks // 60)
    levels = rng.choice([-1.0, 1.0], len(lengths)) * (friction / GAIN + rng.uniform(0.15, 0.7, len(lengths)))
    u = np.repeat(levels, lengths)[:ticks]
    v, rows = 0.0, []
    for k in range(ticks):
        for _ in range(STEPS):
            force = GAIN * u[k] - FV * v - friction * v / np.hypot(v, V_0) - F_0
            v += PERIOD_S / STEPS * force / M
        shown = v + rng.normal(0.0, NOISE) + (offset if k > 2 * ticks / 3 else 0.0)
        rows.append([PERIOD_S * (k + 1), u[k] + rng.normal(0.0, 0.01), shown])
    here = folder / name
    here.mkdir()
    with (here / "log.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["time_s", "u [V]", "y_v [m/s]"], *rows])
    (here / "recording.toml").write_text(
        f'schema = 1\nid = "{name}"\nkind = "instrumented"\nsource = "simulated"\nvehicle = "drive"\ncycle = "levels"\n'
        'sensor_set = "production"\n[table]\nfile = "log.csv"\n'
    )
    return here


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    folder = tmp_path_factory.mktemp("drive")
    logs = [moved(folder, f"log-{k}", 30.0, k) for k in range(3)]
    model, tuning, bundle = folder / "calibrated.toml", folder / "tuning.json", folder / "bundle"
    assert calibrate(["emps", str(logs[0]), "--out", str(model)]) == 0
    assert tune([str(model), str(logs[1]), str(logs[2]), "--out", str(tuning)]) == 0
    assert export([str(model), "--tuning", str(tuning), "--out", str(bundle)]) == 0
    return Drive(folder, bundle)


def test_the_drive_is_calibrated_at_200_hz(drive: Drive) -> None:
    found = {name: p.value for name, p in load_model(drive.folder / "calibrated.toml").parameters.items()}
    assert found["M"] == pytest.approx(M, rel=0.02)
    assert found["Fv"] == pytest.approx(FV, rel=0.02)
    assert found["F_0"] == pytest.approx(F_0, abs=0.3)


def test_an_alarm_of_the_only_test_is_one_of_its_faults_and_none_is_ranked(
    drive: Drive, capsys: pytest.CaptureFixture[str]
) -> None:
    sound = moved(drive.folder, "sound", 20.0, 11)
    assert diagnose([str(sound), "--bundle", str(drive.bundle)]) == 0
    broken = moved(drive.folder, "broken", 30.0, 12, offset=10.0 * NOISE)
    capsys.readouterr()
    assert diagnose([str(broken), "--bundle", str(drive.bundle), "--json"]) == 1
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    confirmed = [event for event in events if event["diagnoses"]]
    assert 20.0 < confirmed[0]["t_s"] < 30.0
    for event in confirmed:
        assert [(one["faults"], one["rank"], one["p"]) for one in event["diagnoses"]] == [
            (["f_Fv"], 1, None),
            (["f_g"], 1, None),
            (["f_y"], 1, None),
        ]


def test_hidden_friction_is_named_among_what_the_system_binds_to_its_roles(
    drive: Drive, capsys: pytest.CaptureFixture[str]
) -> None:
    """Home data of this test: the drive's own equations with the friction that its model lacks."""
    fit, held = (moved(drive.folder, name, 30.0, seed, F_C) for name, seed in (("stiff", 21), ("stiff-2", 22)))
    out = drive.folder / "found"
    discover(["emps", str(fit), "--held-out", str(held), "--out", str(out), "--apply"])
    found = json.loads((out / "discovery.json").read_text())
    assert found["verdict"]["kind"] == "named"
    assert [one["effect"] for one in found["strengths"]] == ["coulomb_friction"]
    assert found["strengths"][0]["value"] == pytest.approx(F_C, rel=0.05)
    assert "simulated" in capsys.readouterr().out or found["simulated"]
    page = (out / "report.html").read_text()
    assert "velocity" in page
    assert "y_v [m/s]" in page
    told = {*re.findall(r"[a-z]+", re.sub(r"base64,[^\"]+", "", page))}
    assert not {"bar", "mbar", "dose", "dosing", "pump", "hose"} & told

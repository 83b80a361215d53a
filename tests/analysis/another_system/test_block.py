"""A made heated block at 5 s: tests without a state, a heater that saturates, a thermistor that is not affine."""

import csv
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from faultline.analysis.calibration.command import main as calibrate
from faultline.analysis.export import main as export
from faultline.analysis.model import load_model
from faultline.analysis.tuning.command import main as tune
from faultline.service.diagnose.command import main as diagnose

HERE = Path(__file__).parent / "block"
PERIOD_S, STEP_S, HOLD_S = 5.0, 0.5, 400.0
P, U_1, C, H, R_0, K_R, T_0 = 85.0, 5.0, 550.0, 1.0, 2250.0, 0.025, 298.0
NOISE = {"u": 0.005, "y_a": 0.05, "y_T": 0.2, "y_T2": 0.3, "y_R": 8.0}


class Block(NamedTuple):
    folder: Path
    bundle: Path


def warmed(folder: Path, name: str, hours: float, seed: int, fault: str = "", size: float = 0.0) -> Path:
    """A run of steps of the heater's voltage; from the middle on a fault of that size."""
    rng = np.random.default_rng(seed)
    levels = rng.choice([0.0, 1.0, 2.0, 3.0, 5.0, 8.0], int(hours * 3600 / HOLD_S) + 1)
    ambient, temperature, rows = 294.0 + rng.normal(), 295.0, []
    for k in range(int(hours * 3600 / STEP_S)):
        t, u = k * STEP_S, levels[int(k * STEP_S / HOLD_S)]
        of = {fault: size} if t >= hours * 1800 else {}
        ambient += rng.normal(0.0, 0.001) * STEP_S**0.5
        heat = P * (1.0 + of.get("fP", 0.0)) * np.tanh(u / U_1)
        temperature += STEP_S * (heat - H * (temperature - ambient)) / C
        if k % round(PERIOD_S / STEP_S) == 0:
            shown = {
                "u": u,
                "y_a": ambient,
                "y_T": temperature + of.get("fy_T", 0.0),
                "y_T2": temperature + of.get("fy_T2", 0.0),
                "y_R": R_0 * (1.0 + of.get("fR", 0.0)) * np.exp(-K_R * (temperature - T_0)),
            }
            rows.append([t, *(value + rng.normal(0.0, NOISE[signal]) for signal, value in shown.items())])
    here = folder / name
    here.mkdir()
    with (here / "log.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["time_s", *NOISE], *rows])
    (here / "recording.toml").write_text(
        f'schema = 1\nid = "{name}"\nkind = "instrumented"\nsource = "simulated"\nvehicle = "block"\ncycle = "steps"\n'
        'sensor_set = "instrumented"\n[table]\nfile = "log.csv"\n'
    )
    return here


@pytest.fixture(scope="module")
def block(tmp_path_factory: pytest.TempPathFactory) -> Block:
    folder = tmp_path_factory.mktemp("block")
    logs = [str(warmed(folder, f"log-{k}", 3.0, k)) for k in range(4)]
    model, tuning, bundle = folder / "calibrated.toml", folder / "tuning.json", folder / "bundle"
    assert calibrate([str(HERE), logs[0], "--out", str(model)]) == 0
    assert tune([str(model), *logs[1:], "--out", str(tuning)]) == 0
    assert export([str(model), "--tuning", str(tuning), "--out", str(bundle)]) == 0
    return Block(folder, bundle)


def test_parameters_are_found_with_a_measured_ambient_as_input(block: Block) -> None:
    found = {name: p.value for name, p in load_model(str(block.folder / "calibrated.toml")).parameters.items()}
    assert found["P"] / found["h"] == pytest.approx(P / H, rel=0.01)
    assert found["C"] / found["h"] == pytest.approx(C / H, rel=0.02)
    assert found["R_0"] == pytest.approx(R_0, rel=0.005)


def test_half_of_the_tests_have_no_state(block: Block) -> None:
    generators = json.loads((block.bundle / "manifest.json").read_bytes())["generators"]
    assert [len(generator["states"]) for generator in generators] == [0, 0, 0, 1, 1, 1]


@pytest.mark.parametrize(("fault", "size"), [("", 0.0), ("fP", -0.3), ("fy_T", 2.0), ("fy_T2", 3.0), ("fR", 0.1)])
def test_each_fault_is_isolated_and_a_sound_block_is_quiet(
    block: Block, fault: str, size: float, capsys: pytest.CaptureFixture[str]
) -> None:
    log = warmed(block.folder, f"of-{fault or 'none'}", 3.0, 20, fault, size)
    capsys.readouterr()
    assert diagnose([str(log), "--bundle", str(block.bundle), "--json"]) == (1 if fault else 0)
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    named = [event["diagnoses"][0]["faults"] for event in events if event["diagnoses"]]
    assert (named[-1:] == [[fault]]) if fault else (not named)

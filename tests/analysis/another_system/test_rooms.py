"""Two heated rooms, sampled once a minute, in tables of values alone: a system slower than the urea dosing system's."""

import csv
import json
import shutil
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from faultline.analysis.calibration.command import main as calibrate
from faultline.analysis.export import main as export
from faultline.analysis.model import load_model
from faultline.analysis.tuning.command import main as tune
from faultline.service.bundle.files import BundleError
from faultline.service.bundle.live import check_live
from faultline.service.bundle.load import load_bundle
from faultline.service.core.errors import InputError
from faultline.service.diagnose.command import main as diagnose

SYSTEM = Path(__file__).with_name("rooms")
MINUTE, DAY = 60.0, 86400.0
TRUE = {"C1": 4e6, "C2": 2.5e6, "G1": 70.0, "G2": 50.0, "G12": 55.0}
NOISE = 0.05
"""Of a temperature [K]: an offset of one kelvin is twenty of them."""


class House(NamedTuple):
    folder: Path
    model: Path
    bundle: Path


def lived_in(folder: Path, name: str, days: float, seed: int, onset_s: float = np.inf) -> Path:
    """A recording: heaters that step, outdoors every ten minutes, and room 1 shown a kelvin too warm from onset."""
    rng, ticks, steps = np.random.default_rng(seed), round(days * DAY / MINUTE), 6
    t = MINUTE * np.arange(ticks)
    outdoors = 278.0 + 5.0 * np.sin(2.0 * np.pi * (t / DAY - 0.3)) + np.cumsum(rng.normal(0.0, 0.02, ticks))
    power = np.column_stack([stepped(rng, ticks, levels) for levels in ((400, 900, 1400, 1900), (300, 700, 1200))])
    rooms, rows = np.array([293.0, 293.0]), []
    for k in range(ticks):
        for _ in range(steps):
            through = TRUE["G12"] * (rooms[1] - rooms[0])
            lost = np.array([TRUE["G1"], TRUE["G2"]]) * (outdoors[k] - rooms)
            rooms = rooms + MINUTE / steps * (power[k] + lost + [through, -through]) / [TRUE["C1"], TRUE["C2"]]
        shown = rooms + rng.normal(0.0, NOISE, 2) + [float(t[k] >= onset_s), 0.0]
        told = outdoors[k] + rng.normal(0.0, 0.1)
        rows.append([t[k], *(power[k] + rng.normal(0.0, 10.0, 2)), told if k % 10 == 0 else "", *shown])
    here = folder / name
    here.mkdir()
    with (here / "log.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["time_s", "P1 [W]", "P2 [W]", "T_out [K]", "y1 [K]", "y2 [K]"], *rows])
    (here / "recording.toml").write_text(
        f'schema = 1\nid = "{name}"\nkind = "instrumented"\nsource = "simulated"\nvehicle = "house"\ncycle = "life"\n'
        'sensor_set = "production"\n[table]\nfile = "log.csv"\n'
    )
    return here


def stepped(rng: np.random.Generator, ticks: int, levels: tuple[int, ...]) -> np.ndarray:
    """Levels held for one to seven hours each."""
    lengths = rng.integers(60, 400, ticks // 60)
    return np.repeat(rng.choice(levels, len(lengths)), lengths)[:ticks].astype(float)


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> House:
    folder = tmp_path_factory.mktemp("house")
    shutil.copytree(SYSTEM, folder / "rooms")
    logs = [lived_in(folder, f"log-{k}", days, k) for k, days in enumerate((8.0, 10.0, 10.0))]
    model, tuning, bundle = folder / "calibrated.toml", folder / "tuning.json", folder / "bundle"
    assert calibrate([str(folder / "rooms"), str(logs[0]), "--out", str(model)]) == 0
    assert tune([str(model), str(logs[1]), str(logs[2]), "--out", str(tuning)]) == 0
    assert export([str(model), "--tuning", str(tuning), "--out", str(bundle)]) == 0
    return House(folder, model, bundle)


def test_a_week_of_a_slow_system_calibrates_it(house: House) -> None:
    found = {name: p.value for name, p in load_model(house.model).parameters.items()}
    for name, true in TRUE.items():
        assert found[name] == pytest.approx(true, rel=0.03), name


def test_its_periods_and_ages_are_in_the_bundle(house: House) -> None:
    manifest = load_bundle(house.bundle).manifest
    assert (manifest.period_s, manifest.settling_s, manifest.dbc) == (60.0, 86400.0, None)
    assert {each.signal: each.maximum_age_s for each in manifest.inputs}["T_out"] == 3600.0
    assert manifest.modes.names == ("edge", "operation")


def test_an_offset_of_a_sensor_is_isolated_and_a_sound_house_is_quiet(
    house: House, capsys: pytest.CaptureFixture[str]
) -> None:
    sound = lived_in(house.folder, "sound", 6.0, 11)
    assert diagnose([str(sound), "--bundle", str(house.bundle), "--json"]) == 0
    assert not any(json.loads(line)["diagnoses"] for line in capsys.readouterr().out.splitlines())
    onset_s = 4.0 * DAY
    broken = lived_in(house.folder, "broken", 6.0, 12, onset_s)
    assert diagnose([str(broken), "--bundle", str(house.bundle), "--json"]) == 1
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    first = next(event for event in events if event["diagnoses"])
    assert onset_s < first["t_s"] < onset_s + 7200.0
    assert "f_y1" in {name for one in first["diagnoses"] for name in one["faults"]}
    assert [one["faults"] for one in events[-1]["diagnoses"] if one["rank"] == 1] == [["f_y1"]]


def test_a_bundle_without_a_dbc_is_for_tables_alone(house: House) -> None:
    with pytest.raises(BundleError, match=r"bundle: has no DBC, so its signals come in tables .*; export it with"):
        check_live(load_bundle(house.bundle))
    golden = Path(__file__).parents[2] / "golden" / "log"
    with pytest.raises(InputError, match="the bundle has no DBC, so its signals come in a table: give one"):
        diagnose([str(golden), "--bundle", str(house.bundle)])

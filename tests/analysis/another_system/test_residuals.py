"""A boiler of which only the residuals of another tool are known, in tables at 5 s, with a fault signature matrix."""

import csv
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from faultline.analysis.calibration.command import main as calibrate
from faultline.analysis.evaluation.command import main as evaluate
from faultline.analysis.export import main as export
from faultline.analysis.model import ModelError, dump_model, load_model, parse_model
from faultline.analysis.recordings.new_system import main as new_system
from faultline.analysis.structure.command import main as structure
from faultline.analysis.structure.structure import structure_of
from faultline.analysis.tuning.command import main as tune
from faultline.service.core.errors import InputError
from faultline.service.diagnose.command import main as diagnose

PERIOD_S, TICKS, ONSET = 5.0, 2400, 1200
NOISE, DRIVE = np.array([0.1, 0.2, 0.05]), np.array([0.02, 0.03, 0.005])
SHIFTS = {"f_pump": (1.0, 0.8, 0.0), "f_valve": (0.0, 0.9, -0.3), "f_sensor": (0.35, 0.0, 0.0), "": (0.0, 0.0, 0.0)}
MATRIX = "residual;pump;valve;sensor\nr1;1;.;X\nr2;1;1;\nr3;0;1;0\n"
DBC = """VERSION ""
BU_: tool
BO_ 256 residuals: 6 tool
 SG_ r1 : 0|16@1- (0.001,0) [-30|30] "" tool
 SG_ r2 : 16|16@1- (0.001,0) [-30|30] "" tool
 SG_ r3 : 32|16@1- (0.001,0) [-30|30] "" tool
"""


class Boiler(NamedTuple):
    folder: Path
    system: Path
    bundle: Path


def residuals(seed: int, fault: str) -> np.ndarray:
    rng = np.random.default_rng(seed)
    r = NOISE * rng.standard_normal((TICKS, 3)) + DRIVE * rng.standard_normal(3)
    r[ONSET:] += SHIFTS[fault]
    return r


def recorded(folder: Path, name: str, seed: int, fault: str = "") -> Path:
    here = folder / name
    here.mkdir()
    rows = [[f"{k * PERIOD_S:g}", *(f"{value:.5f}" for value in row)] for k, row in enumerate(residuals(seed, fault))]
    with (here / "log.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["t", "r1", "r2", "r3"], *rows])
    (here / "recording.toml").write_text(
        f'schema = 1\nid = "{name}"\nkind = "instrumented"\nsource = "made"\nvehicle = "boiler"\ncycle = "any"\n'
        'sensor_set = "production"\n[table]\nfile = "log.csv"\n'
    )
    return here


def system(folder: Path, name: str, log: Path, matrix: str) -> Path:
    """The folder that the command begins, filled in."""
    (folder / f"{name}.csv").write_text(matrix)
    words = ["--from", str(log), "--signatures", str(folder / f"{name}.csv"), "--out", str(folder / name)]
    assert new_system(["system", name, *words]) == 0
    path = folder / name / "model.toml"
    lines = [line for line in path.read_text().splitlines() if "FILL IN" not in line]
    path.write_text("\n".join(["warm_up_s = 50.0", *lines]))
    return folder / name


def bundled(folder: Path, of: Path, logs: list[str], *more: str) -> Path:
    tuning, bundle = folder / f"{of.name}.json", folder / f"{of.name}-bundle"
    assert tune([str(of), *logs, "--out", str(tuning)]) == 0
    assert export([str(of), "--tuning", str(tuning), "--out", str(bundle), *more]) == 0
    return bundle


@pytest.fixture(scope="module")
def boiler(tmp_path_factory: pytest.TempPathFactory) -> Boiler:
    folder = tmp_path_factory.mktemp("boiler")
    logs = [recorded(folder, f"sound-{k}", k) for k in range(3)]
    made = system(folder, "boiler", logs[0], MATRIX)
    return Boiler(folder, made, bundled(folder, made, [str(log) for log in logs]))


def test_the_file_is_read_as_it_is_written(boiler: Boiler) -> None:
    model = load_model(boiler.system)
    assert model.residuals == {"r1": ("f_pump", "f_sensor"), "r2": ("f_pump", "f_valve"), "r3": ("f_valve",)}
    assert parse_model(dump_model(model), "again") == model


def test_there_is_nothing_to_calibrate(boiler: Boiler, tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"boiler: residuals of another tool have no parameters; `faultline tune` takes"
    ):
        calibrate([str(boiler.system), str(boiler.folder / "sound-0"), "--out", str(tmp_path / "calibrated.toml")])


def test_the_system_says_more_of_listed_faults(boiler: Boiler, tmp_path: Path) -> None:
    for name in ("model.toml", "system.toml"):
        (tmp_path / name).write_text((boiler.system / name).read_text())
    with (tmp_path / "system.toml").open("a") as file:
        file.write('[fault.f_pump]\nspn = 520200\nfmi = 7\n[component."valve"]\nplace = "behind the cover"\n')
    faults = load_model(tmp_path).faults
    assert (faults["f_pump"].spn, faults["f_pump"].fmi, faults["f_valve"].place) == (520200, 7, "behind the cover")


def test_structure_shows_what_the_signatures_tell_apart(boiler: Boiler, capsys: pytest.CaptureFixture[str]) -> None:
    assert structure([str(boiler.system)]) == 0
    assert "f_sensor  not isolable from f_pump" in capsys.readouterr().out
    assert structure([str(boiler.system), "--json", "-"]) == 0
    isolability = json.loads(capsys.readouterr().out)["isolability"]
    assert isolability == {"f_pump": [], "f_sensor": ["f_pump"], "f_valve": []}
    with pytest.raises(ModelError, match="no equations"):
        structure_of(load_model(boiler.system))


@pytest.mark.parametrize("fault", list(SHIFTS))
def test_faults_are_isolated_without_a_model(boiler: Boiler, fault: str, capsys: pytest.CaptureFixture[str]) -> None:
    log = recorded(boiler.folder, f"of-{fault}", 20, fault)
    capsys.readouterr()
    assert diagnose([str(log), "--bundle", str(boiler.bundle), "--json"]) == (1 if fault else 0)
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    ended = [event["diagnoses"] for event in events if event["diagnoses"]][-1:]
    likeliest = [max(each, key=lambda d: d["p"])["faults"] for each in ended]
    assert likeliest == ([[fault]] if fault else [])
    truth = boiler.folder / f"truth-{fault}.toml"
    there = (
        f'\n[[fault]]\nname = "{fault}"\nsize = 1.0\nonset_s = {ONSET * PERIOD_S}\nprofile = "step"\n' if fault else ""
    )
    truth.write_text(f'schema = 1\nrecording = "of-{fault}"\n{there}')
    report = str(boiler.folder / "report")
    assert evaluate([str(boiler.bundle), str(log), "--truth", str(truth), "--report", report]) == 0


def test_why_no_drive_can_be_left_out_is_said(boiler: Boiler, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(boiler.folder / "one-drive.json")
    assert tune([str(boiler.system), str(boiler.folder / "sound-0"), "--out", out]) == 0
    assert "of a single drive none can be left out to count false alarms on; add another one" in capsys.readouterr().err


def test_of_one_residual_it_is_one_of_its_faults(boiler: Boiler, capsys: pytest.CaptureFixture[str]) -> None:
    made = system(boiler.folder, "one", boiler.folder / "sound-0", "r;pump;sensor\nr1;1;1\n")
    bundle = bundled(boiler.folder, made, [str(boiler.folder / f"sound-{k}") for k in range(3)])
    capsys.readouterr()
    assert diagnose([str(recorded(boiler.folder, "one-of", 30, "f_pump")), "--bundle", str(bundle), "--json"]) == 1
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [d["faults"] for d in events[-1]["diagnoses"]] == [["f_pump"], ["f_sensor"]]


def test_residuals_come_on_a_bus_too(boiler: Boiler, capsys: pytest.CaptureFixture[str]) -> None:
    (boiler.folder / "tool.dbc").write_text(DBC)
    made = system(boiler.folder, "bus", boiler.folder / "sound-0", MATRIX)
    logs = [str(boiler.folder / f"sound-{k}") for k in range(3)]
    bundle = bundled(boiler.folder, made, logs, "--dbc", str(boiler.folder / "tool.dbc"))
    raw = np.round(1e3 * residuals(40, "f_valve")).astype("<i2")
    frames = [f"({k * PERIOD_S:.6f}) can0 100#{row.tobytes().hex()}\n" for k, row in enumerate(raw)]
    log = boiler.folder / "bus.log"
    log.write_text("".join(frames))
    capsys.readouterr()
    assert diagnose([str(log), "--bundle", str(bundle), "--json"]) == 1
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [d["faults"] for d in events[-1]["diagnoses"]] == [["f_valve"], []]


@pytest.mark.parametrize(
    ("matrix", "problem"),
    [
        ("", "no matrix"),
        ("r;f\nr1;1;1\n", "no matrix"),
        ("r;f;g\nr9;1;0\n", "r9.*no such signal"),
        ("r;f;g\nr1;maybe;0\n", "maybe"),
        ("r;f;g\nr1;0;0\n", "no fault moves it"),
        ("r;f;g\nr1;1;0\nr1;0;1\n", "twice"),
    ],
)
def test_a_matrix_that_cannot_be_used_is_refused(boiler: Boiler, matrix: str, problem: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=problem):
        system(tmp_path, "refused", boiler.folder / "sound-0", matrix)


def test_a_matrix_on_its_side_is_turned(boiler: Boiler, tmp_path: Path) -> None:
    made = system(tmp_path, "turned", boiler.folder / "sound-0", "fault,r1,r2\npump,1,1\nvalve,0,1\n")
    assert load_model(made).residuals == {"r1": ("f_pump",), "r2": ("f_pump", "f_valve")}


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (("[residual.r1]", "[residual.r7]"), "r7 is no known signal"),
        (('"f_pump", "f_valve"', '"f_pump", "f_pipe"'), "f_pipe is not listed"),
        (('faults = ["f_valve"]', "faults = []"), "is empty"),
        (("[fault.f_valve]", '[fault.f_other]\ncomponent = "x"\n[fault.f_valve]'), "no residual is sensitive"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused(boiler: Boiler, change: tuple[str, str], problem: str) -> None:
    with pytest.raises(ModelError, match=problem):
        parse_model((boiler.system / "model.toml").read_text().replace(*change), "m")

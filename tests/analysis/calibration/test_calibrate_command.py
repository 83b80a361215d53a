"""From made recordings to a calibrated model and its tuning, by the commands alone."""

import contextlib
import io
import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from made_drive import DELAY_S, UDS4, frames, freed, write_recording

from faultline.analysis.calibration.command import main as calibrate
from faultline.analysis.calibration.provenance import recordings_of, vehicle_of
from faultline.analysis.model import dump_model, load_model
from faultline.analysis.tuning.command import main as tune
from faultline.analysis.tuning.file import load_tuning, model_digest
from faultline.service.core.errors import InputError
from faultline.service.logs import open_log

FREE = ("A_du", "A_ori")
AREA = 0.8 * UDS4.parameters["A_du"].value


@dataclass(frozen=True)
class Made:
    """Two recordings of one vehicle whose filter is narrower than the datasheet's, one of another, and the models."""

    model: Path
    beside: Path
    first: Path
    second: Path
    other: Path
    calibrated: Path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("made")
    model, beside = folder / "datasheet.toml", folder / "beside.toml"
    model.write_text(dump_model(freed(UDS4, FREE)))
    beside.write_text(dump_model(freed(load_model("uds/production"), FREE)))
    true = {name: p.value for name, p in UDS4.parameters.items()} | {"A_du": AREA}
    first, second, other = (
        write_recording(folder / f"holds-{seed}", frames(UDS4, true, seed, delay_s=DELAY_S), vehicle)
        for seed, vehicle in ((3, "made"), (4, "made"), (5, "another"))
    )
    calibrated = folder / "new" / "calibrated.toml"
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert calibrate([str(model), str(first), "--out", str(calibrated)]) == 0
    assert f"wrote {calibrated} (sha256 " in printed.getvalue()
    return Made(model, beside, first, second, other, calibrated)


def test_the_calibrated_model_loads_again_with_its_provenance(made: Made) -> None:
    model = load_model(made.calibrated)
    assert model.parameters["A_du"].value == pytest.approx(AREA, rel=0.06)
    [entry] = model.provenance
    assert entry["command"] == "calibrate"
    assert recordings_of(model) == entry["recordings"] == [open_log(made.first).sha256]
    assert entry["sections"] == 1
    assert entry["vehicle"] == vehicle_of(model) == "made"
    others = {name: p for name, p in model.parameters.items() if name not in FREE}
    assert others == {name: p for name, p in load_model(made.model).parameters.items() if name not in FREE}


@dataclass(frozen=True)
class Reported:
    """A second calibration, validated and reported: its model file, its folder and what it printed."""

    out: Path
    folder: Path
    printed: str


@pytest.fixture(scope="module")
def reported(made: Made, tmp_path_factory: pytest.TempPathFactory) -> Reported:
    folder = tmp_path_factory.mktemp("reported")
    out, report = folder / "calibrated.toml", folder / "new" / "report"
    command = [str(made.model), str(made.first), "--out", str(out), "--beside", str(made.beside)]
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        assert calibrate([*command, "--validate", str(made.second), "--report", str(report), "--json"]) == 0
    return Reported(out, report, printed.getvalue())


def test_the_same_recording_gives_the_same_bytes(made: Made, reported: Reported) -> None:
    """What is validated on does not matter."""
    assert reported.out.read_bytes() == made.calibrated.read_bytes()


def test_the_result_is_printed(reported: Reported) -> None:
    told = json.loads(reported.printed)
    assert told["model"] == "uds"
    assert told["vehicle"] == "made"
    assert told["sources"] == ["made"]
    assert list(told["parameters"]) == list(FREE)
    model = load_model(reported.out)
    for name, p in told["parameters"].items():
        assert p["value"] == model.parameters[name].value
        assert p["prior_value"] == UDS4.parameters[name].value
        assert p["interval"][0] < p["value"] < p["interval"][1]
        assert p["told"] is True
    assert told["anchors"] == {}
    assert told["doubts"] == []
    assert list(told["zeros"]) == ["y_p_tp", "y_p_ap", "y_p_du"]
    assert told["delays"]["dc_dose"] == pytest.approx(DELAY_S, abs=0.2)
    assert told["starts"] == [4, 4]
    assert list(told["agreement"]) == ["holds-3", "holds-4"]
    for by_output in told["agreement"].values():
        assert list(by_output) == ["y_p_tp", "y_p_ap", "y_p_du"]
        for by_mode in by_output.values():
            assert set(by_mode) == {*UDS4.modes.names, "steady"}
            assert 0.3 < by_mode["steady"]["rms"] / by_mode["steady"]["expected"] < 1.5


def test_a_report_is_a_page_a_picture_and_numbers(reported: Reported) -> None:
    folder = reported.folder
    assert sorted(path.name for path in folder.iterdir()) == ["calibration.json", "free-run.png", "report.md"]
    picture = (folder / "free-run.png").read_bytes()
    assert picture.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = np.frombuffer(picture[16:24], dtype=">u4")
    assert width > 800
    assert height > 600
    page = (folder / "report.md").read_text()
    assert page.startswith("# Calibration of uds of vehicle made\n")
    assert re.search(
        r"\nthe model describes these data: .* at most [01]\.\d times .* mode \w+; 2 times are allowed", page
    )
    assert "![Free run](free-run.png)" in page
    for name in (*FREE, "holds-3", "holds-4"):
        assert name in page
    assert json.loads((folder / "calibration.json").read_bytes()) == json.loads(reported.printed)


def test_a_recording_given_twice_is_refused(made: Made, tmp_path: Path) -> None:
    out = tmp_path / "calibrated.toml"
    for command in ([str(made.first), str(made.first)], [str(made.first), "--validate", str(made.first)]):
        with pytest.raises(InputError, match=r"holds-3: this recording is given twice; validate on recordings that"):
            calibrate([str(made.model), *command, "--out", str(out)])
    assert not out.exists()


def test_two_recordings_of_one_id_are_refused(made: Made, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(made.second, other)
    described = other / "recording.toml"
    described.write_text(described.read_text().replace("holds-4", "holds-3"))
    with pytest.raises(InputError, match=r"other: id 'holds-3' is another recording's too; give each one of its own"):
        calibrate([str(made.model), str(made.first), "--validate", str(other), "--out", str(tmp_path / "c.toml")])


def test_recordings_of_two_vehicles_are_refused(made: Made, tmp_path: Path) -> None:
    message = r"holds-5: recorded on vehicle 'another', .*holds-3 is of 'made'; every vehicle has"
    for command in ([str(made.first), str(made.other)], [str(made.first), "--validate", str(made.other)]):
        with pytest.raises(InputError, match=message):
            calibrate([str(made.model), *command, "--out", str(tmp_path / "calibrated.toml")])


def test_a_calibrated_model_is_of_one_vehicle(made: Made, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds-5: recorded on vehicle 'another', the calibration of uds is of 'm"):
        calibrate([str(made.calibrated), str(made.other), "--out", str(tmp_path / "c.toml")])


def test_a_model_that_does_not_describe_the_data_is_not_written(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing of it may take up that the orifice is three times as large as in the vehicle."""
    model = load_model(made.model)
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(dump_model(model.with_parameters({"A_ori": 3.0 * model.parameters["A_ori"].value}, {})))
    out = tmp_path / "c.toml"
    assert calibrate([str(wrong), str(made.first), "--out", str(out)]) == 1
    printed = capsys.readouterr().out
    assert printed.startswith("the model does NOT describe these data: ")
    assert printed.endswith(f"{out} is not written (--force does)\n")
    assert not out.exists()
    assert calibrate([str(wrong), str(made.first), "--out", str(out), "--force"]) == 0
    assert out.exists()


def test_a_model_without_priors_is_refused(made: Made, tmp_path: Path) -> None:
    model = tmp_path / "fixed.toml"
    model.write_text(dump_model(freed(UDS4, ())))
    with pytest.raises(InputError, match=r"uds: no parameter has a prior; give `prior` to those that shall be"):
        calibrate([str(model), str(made.first), "--out", str(tmp_path / "calibrated.toml")])


def test_a_recording_that_is_too_short_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    short = write_recording(tmp_path / "short", [frame for frame in frames(UDS4, {}, 6) if frame.t < 45.0])
    out = tmp_path / "calibrated.toml"
    with pytest.raises(InputError, match=r"short: in no 50 s on end .*do all inputs tell"):
        calibrate(["uds", str(short), "--out", str(out)])
    assert not out.exists()


def test_tuning_takes_another_recording_of_the_vehicle(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "tuning.json"
    assert tune([str(made.calibrated), str(made.second), "--out", str(out)]) == 0
    assert "from 1 fault-free recordings" in capsys.readouterr().out
    tuning = load_tuning(out)
    assert tuning.recordings == [open_log(made.second).sha256]
    assert tuning.model_sha256 == model_digest(made.calibrated.read_text())
    assert len(tuning.golden_z) == 150
    assert [detector.generator for detector in tuning.detectors][:2] == ["t02.ode", "t06.ode"]
    assert all(len(detector.scale) == len(UDS4.modes.names) for detector in tuning.detectors)
    again = tmp_path / "again.json"
    assert tune([str(made.calibrated), str(made.second), "--out", str(again), "--json"]) == 0
    assert again.read_bytes() == out.read_bytes()
    assert json.loads(capsys.readouterr().out) == json.loads(out.read_bytes())["detectors"]


def test_tuning_refuses_the_recording_of_the_calibration(made: Made, tmp_path: Path) -> None:
    out = tmp_path / "tuning.json"
    with pytest.raises(InputError, match=r"holds-3: this recording is used to make the model; tune on fault-free"):
        tune([str(made.calibrated), str(made.first), "--out", str(out)])
    assert not out.exists()


def test_tuning_refuses_a_recording_named_twice(made: Made, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds-4: this recording is used twice; tune on fault-free recordings"):
        tune([str(made.calibrated), str(made.second), str(made.second), "--out", str(tmp_path / "tuning.json")])


def test_tuning_refuses_another_vehicle(made: Made, tmp_path: Path) -> None:
    message = r"holds-5: recorded on vehicle 'another', the calibration of uds is of 'm"
    with pytest.raises(InputError, match=message):
        tune([str(made.calibrated), str(made.other), "--out", str(tmp_path / "tuning.json")])


def test_tuning_refuses_recordings_that_never_hold_a_mode(made: Made, tmp_path: Path) -> None:
    """Before the fourth hold the valve has not been held open."""
    log = [frame for frame in frames(UDS4, {}, 6) if frame.t < 90.0]
    partial = write_recording(tmp_path / "partial", log)
    with pytest.raises(InputError, match=r"tuning data \(partial\): t02.ode saw mode 'maximum' for 0 ticks only; add"):
        tune([str(made.calibrated), str(partial), "--out", str(tmp_path / "tuning.json")])

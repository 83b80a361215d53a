"""From made recordings to a calibrated model and its tuning, by the commands alone."""

import json
from dataclasses import dataclass
from pathlib import Path

import pytest
from made_drive import HOLD_TICKS, freed, samples, write_recording

from analysis.calibration.command import main as calibrate
from analysis.calibration.provenance import recordings_of
from analysis.graph.bank import build_bank
from analysis.model import dump_model, load_model
from analysis.tuning.command import main as tune
from analysis.tuning.file import load_tuning, model_digest
from service.core.errors import InputError
from service.core.manifest import MODES
from service.logs import open_log

UDS4 = load_model("uds4")
AREA = 0.8 * UDS4.parameters["A_du"].value
GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "log"


@dataclass(frozen=True)
class Made:
    """Two recordings of one vehicle whose filter is narrower than the datasheet's, and the datasheet's model."""

    model: Path
    first: Path
    second: Path
    calibrated: Path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("made")
    bank = build_bank(UDS4)
    model = folder / "datasheet.toml"
    model.write_text(dump_model(freed(UDS4, ["A_du"])))
    first, second = (
        write_recording(folder / f"holds-{seed}", samples(bank, {"A_du": AREA}, seed=seed)) for seed in (3, 4)
    )
    calibrated = folder / "new" / "calibrated.toml"
    assert calibrate([str(model), str(first), "--out", str(calibrated)]) == 0
    return Made(model, first, second, calibrated)


def test_the_calibrated_model_loads_again_with_its_provenance(made: Made) -> None:
    model = load_model(made.calibrated)
    assert abs(model.parameters["A_du"].value / AREA - 1) < 0.03
    [entry] = model.provenance
    assert entry["command"] == "calibrate"
    assert recordings_of(model) == entry["recordings"] == [open_log(made.first).sha256]
    blocks = entry["blocks"]
    assert isinstance(blocks, int)
    assert blocks >= 20
    others = {name: p for name, p in model.parameters.items() if name != "A_du"}
    assert others == {name: p for name, p in load_model(made.model).parameters.items() if name != "A_du"}


def test_the_result_is_printed_and_repeats_to_the_byte(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "again.toml"
    assert calibrate([str(made.model), str(made.first), "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert out.read_bytes() == made.calibrated.read_bytes()
    assert list(result["values"]) == ["A_du"]
    assert result["values"]["A_du"] == load_model(out).parameters["A_du"].value


def test_the_golden_log_is_too_short_and_nothing_is_written(tmp_path: Path) -> None:
    out = tmp_path / "calibrated.toml"
    with pytest.raises(InputError, match=r"golden/log: only \d+ steady blocks of 5 s"):
        calibrate(["uds4", str(GOLDEN), "--out", str(out)])
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
    assert all(len(detector.scale) == len(MODES) for detector in tuning.detectors)
    again = tmp_path / "again.json"
    assert tune([str(made.calibrated), str(made.second), "--out", str(again), "--json"]) == 0
    assert again.read_bytes() == out.read_bytes()
    assert json.loads(capsys.readouterr().out) == json.loads(out.read_bytes())["detectors"]


def test_tuning_refuses_the_recording_of_the_calibration(made: Made, tmp_path: Path) -> None:
    out = tmp_path / "tuning.json"
    with pytest.raises(InputError, match=r"holds-3: this recording is used for calibration; tune on fault-free"):
        tune([str(made.calibrated), str(made.first), "--out", str(out)])
    assert not out.exists()


def test_tuning_refuses_a_recording_named_twice(made: Made, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds-4: this recording is used twice; tune on fault-free recordings"):
        tune([str(made.calibrated), str(made.second), str(made.second), "--out", str(tmp_path / "tuning.json")])


def test_tuning_refuses_recordings_that_never_hold_a_mode(made: Made, tmp_path: Path) -> None:
    """Before the fourth hold the valve has not been held open."""
    z = samples(build_bank(UDS4), {}, seed=5)[: 3 * HOLD_TICKS]
    partial = write_recording(tmp_path / "partial", z)
    with pytest.raises(InputError, match=r"tuning data \(partial\): t02.ode saw mode 'maximum' for 0 ticks only; add"):
        tune([str(made.calibrated), str(partial), "--out", str(tmp_path / "tuning.json")])

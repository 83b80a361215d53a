"""A fleet is tuned, and another vehicle with one drive and what the fleet teaches; vehicles are the model itself."""

import dataclasses
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "calibration"))
from made_drive import UDS4, frames, freed, write_recording

from faultline.analysis.fleet.command import main
from faultline.analysis.model import dump_model
from faultline.analysis.tuning.command import main as tune
from faultline.analysis.tuning.file import Tuning, load_tuning
from faultline.analysis.tuning.prior import Prior, load_prior
from faultline.service.core.errors import InputError

VEHICLES = "abcd"


def model_of(folder: Path, vehicle: str) -> Path:
    """The model as if it had been calibrated for a vehicle."""
    entry: Mapping[str, object] = {"command": "calibrate", "recordings": [], "vehicle": vehicle}
    path = folder / f"vehicle={vehicle}" / "model.toml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(dump_model(dataclasses.replace(freed(UDS4, ()), provenance=(entry,))))
    return path


def drive(folder: Path, vehicle: str, seed: int, zero: float) -> Path:
    """A drive of a vehicle whose pressure sensor before the pump reads too much [Pa]."""
    return write_recording(folder / f"{vehicle}-{seed}", frames(UDS4, {}, seed, zero={"y_p_ap": zero}), vehicle)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fleet")
    rng = np.random.default_rng(5)
    for number, vehicle in enumerate(VEHICLES):
        model_of(folder / "made", vehicle)
        for k in range(2):
            drive(folder / "drives", vehicle, 50 + 10 * number + k, float(rng.normal(0.0, 300.0)))
    model = str(folder / "made" / "vehicle={vehicle}" / "model.toml")
    assert main(["tune", model, str(folder / "drives"), "--out", str(folder / "made"), "--processes", "2"]) == 0
    return folder


@pytest.fixture(scope="module")
def new(made: Path) -> tuple[Path, Path]:
    """Another vehicle's model and drive."""
    return model_of(made / "new", "n"), drive(made / "new", "n", 99, 200.0)


def tuned(made: Path, new: tuple[Path, Path], *words: str) -> Tuning:
    out = made / "out.json"
    assert tune([*map(str, new), "--out", str(out), *words]) == 0
    return load_tuning(out)


def test_the_fleets_file_says_what_its_vehicles_have_shown(made: Path) -> None:
    prior: Prior = load_prior(made / "made" / "fleet.json")
    assert (prior.vehicles, prior.drives) == (4, 8)
    own = [load_tuning(made / "made" / f"vehicle={vehicle}" / "tuning.json") for vehicle in VEHICLES]
    assert prior.hours == pytest.approx(sum(each.hours for tuning in own for each in tuning.statistics))
    assert {*own[0].recordings} < {*prior.recordings}
    usual = {d.generator: d.J for d in prior.detectors}
    assert usual[own[0].detectors[0].generator] == np.median([tuning.detectors[0].J for tuning in own])


def test_a_new_vehicle_is_tuned_with_one_drive_and_the_fleet(made: Path, new: tuple[Path, Path]) -> None:
    alone, with_fleet = tuned(made, new), tuned(made, new, "--fleet", str(made / "made" / "fleet.json"))
    assert with_fleet.fleet is not None
    assert alone.fleet is None
    assert len(with_fleet.evidence.drifts) > len(alone.evidence.drifts)
    usual = {d.generator: d for d in load_prior(made / "made" / "fleet.json").detectors}
    for d, without in zip(with_fleet.detectors, alone.detectors, strict=True):
        assert usual[d.generator].J <= d.J
        assert d.generator == without.generator


def test_a_drive_with_a_fault_is_not_made_normal(made: Path, new: tuple[Path, Path]) -> None:
    faulty = drive(made / "new", "n", 98, 60e3)
    with pytest.raises(InputError, match="standard deviations from the fleet in mode"):
        tuned(made, (new[0], faulty), "--fleet", str(made / "made" / "fleet.json"))


def test_what_the_fleet_has_seen_teaches_nothing_of_itself(made: Path) -> None:
    own = made / "made" / "vehicle=a" / "model.toml", made / "drives" / "a-50"
    with pytest.raises(InputError, match=r"the fleet in .*fleet\.json has seen it"):
        tuned(made, own, "--fleet", str(made / "made" / "fleet.json"))


def test_a_file_that_is_no_fleet_is_named(made: Path, new: tuple[Path, Path]) -> None:
    other = made / "new" / "other.json"
    with pytest.raises(InputError, match=r"other\.json: not found; `faultline fleet tune` writes it"):
        tuned(made, new, "--fleet", str(other))
    other.write_text("{}")
    with pytest.raises(InputError, match=r"other\.json: not a fleet's file"):
        tuned(made, new, "--fleet", str(other))
    with pytest.raises(InputError, match="--also with --fleet"):
        tuned(made, new, "--fleet", str(other), "--also", "a.toml", "b")

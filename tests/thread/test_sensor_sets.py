"""Every command that takes recordings and a model refuses those that lack the model's sensors, before any work."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from faultline.analysis.calibration.command import main as calibrate
from faultline.analysis.discrepancy.command import main as discover
from faultline.analysis.tuning.command import main as tune
from faultline.service.core.errors import InputError
from faultline.training.command import main as train

LOG = Path(__file__).parents[1] / "golden" / "log"


@pytest.mark.parametrize("command", [calibrate, discover, tune, train])
def test_recordings_without_the_added_sensors_are_refused(command: Callable[[list[str]], int], tmp_path: Path) -> None:
    few = Path(shutil.copytree(LOG, tmp_path / "few"))
    described = (few / "recording.toml").read_text()
    (few / "recording.toml").write_text(described.replace('sensor_set = "instrumented"', 'sensor_set = "production"'))
    held = ["--held-out", str(LOG)] if command is discover else []
    message = r"few/recording.toml: sensor_set is 'production', the model uds needs 'instrumented'; give recordings of"
    with pytest.raises(InputError, match=message):
        command(["uds", str(few), *held, "--out", str(tmp_path / "out")])

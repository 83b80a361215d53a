"""A pump speed that jumps between two samples is no effect that a model misses."""

import dataclasses
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1] / "calibration"))
from made_drive import Errors, frames, log_sections

from faultline.analysis.calibration.sections import Section
from faultline.analysis.discrepancy.discover import REMAINDER
from faultline.analysis.discrepancy.name.attempt import Judge, Study, baseline_of
from faultline.analysis.model import load_model
from faultline.analysis.simulation import system_of

UDS1 = load_model("uds/production")
SYSTEM = system_of(UDS1, UDS1.calibrated)
SPEED = (20.0, 27.0, 20.0, 28.0, 21.0, 28.0) * 2
DOSE = (0.0,) * 12


@pytest.fixture(scope="module")
def logs() -> list[list[Section]]:
    """Two drives of a vehicle that is the model, its speed stepping every half minute."""
    true, errors = {name: p.value for name, p in UDS1.parameters.items()}, Errors(jumps=True, level=0.0)
    made = (frames(UDS1, true, seed, errors=errors, speed=SPEED, dose=DOSE, zero={}) for seed in (1, 2))
    return [log_sections(UDS1, SYSTEM, log) for log in made]


def evidence(logs: list[list[Section]]) -> list[float]:
    """Of an unknown input [nats], in the training and in the held-out log."""
    study = Study("made", UDS1, {}, *map(tuple, logs))
    judge = Judge(study, baseline_of(study))
    nominal = judge.attempt(())
    return [0.5 * judge.locate(nominal, held=held).suspects[0].evidence for held in (False, True)]


def test_nothing_is_missing_where_the_speed_jumps_between_samples(logs: list[list[Section]]) -> None:
    """The wound: of 8 sound vehicles of another plant, whose set points step, 6 were said to miss something."""
    assert max(evidence(logs)) < 0.1 * REMAINDER


def test_without_the_jumps_something_would_be(logs: list[list[Section]]) -> None:
    """So that the test above can fail: the noise of its quiet samples says nothing of a jump."""
    bare = [[dataclasses.replace(section, uncertain={}) for section in log] for log in logs]
    assert min(evidence(bare)) > REMAINDER

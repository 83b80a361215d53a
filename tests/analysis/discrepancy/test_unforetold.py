"""A fault in a held-out recording: parameters stay what the training made them, and the fault is seen for itself."""

import dataclasses

import numpy as np
import pytest
from made_study import UDS1, study

from faultline.analysis.calibration.sections import Section
from faultline.analysis.discrepancy.find.locate import Location
from faultline.analysis.discrepancy.find.onset import onset
from faultline.analysis.discrepancy.name.attempt import Judge, Study, baseline_of

ONSET_S = 90.0
LEAK = 1e-7
"""m3/s at 10 bar: it takes half a bar."""


def until(section: Section, faulty: Section) -> Section:
    """A section whose samples from `ONSET_S` on are those of the faulty one."""
    samples = {
        name: dataclasses.replace(s, value=np.where(s.t < ONSET_S, s.value, faulty.samples[name].value))
        for name, s in section.samples.items()
    }
    return dataclasses.replace(section, samples=samples)


def unforetold(made: Study) -> Location:
    judge = Judge(made, baseline_of(made))
    return judge.unforetold(judge.attempt(()))


def test_a_fault_sets_in_when_it_did() -> None:
    """The wound: a recording's own fit sent parameters far away, and an orifice clogged by 20 % was missing physics."""
    healthy, faulty = study((), {}), study(("leak_laminar",), {"leak_laminar": LEAK})
    held = tuple(map(until, healthy.held, faulty.held))
    found = onset(UDS1, unforetold(dataclasses.replace(healthy, held=held)), ["held"])
    assert found is not None
    assert found.t_s == pytest.approx(ONSET_S, abs=10.0)


def test_a_healthy_recording_is_foretold() -> None:
    found = unforetold(study((), {}))
    assert found.members == ()
    assert onset(UDS1, found, ["held"]) is None

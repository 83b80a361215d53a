"""Attempts: exact nesting, sizes that are recovered, evidence that speaks for what is there."""

import dataclasses

import numpy as np
import pytest
from made_study import study

from faultline.analysis.discrepancy.name.attempt import Attempt, Begin, Judge, baseline_of
from faultline.analysis.model import load_model

SIZE = 0.15
ENTRIES = ("full_open_gain", "valve_opens_late", "stiff_hose")


@pytest.fixture(scope="module")
def judge() -> Judge:
    found = study(ENTRIES, {"full_open_gain": SIZE})
    return Judge(found, baseline_of(found))


@pytest.fixture(scope="module")
def nominal(judge: Judge) -> Attempt:
    return judge.attempt(())


@pytest.fixture(scope="module")
def right(judge: Judge) -> Attempt:
    return judge.attempt(("full_open_gain",))


def test_the_effect_is_found_at_its_size(right: Attempt) -> None:
    size, spread = right.values["full_open_gain_g"], right.spreads["full_open_gain_g"]
    assert abs(size - SIZE) < 3.5 * spread
    assert spread < 0.1 * SIZE
    assert 0.2 < right.dispersion < 1.2  # levels are those of the model without it, which the steps make larger


def test_both_recordings_speak_for_it(nominal: Attempt, right: Attempt) -> None:
    assert right.training - nominal.training > 30.0
    assert right.predicted - nominal.predicted > 30.0
    assert right.evidence == right.training + right.predicted


def test_an_effect_that_is_not_there_stays_at_nothing_and_gains_nothing(judge: Judge, right: Attempt) -> None:
    both = judge.attempt(("full_open_gain", "stiff_hose"), Begin(right.unknowns, right.x))
    assert both.evidence < right.evidence + 3.0
    assert abs(both.values["stiff_hose_k"]) < 4.0 * max(both.spreads["stiff_hose_k"], 1e-3)


def test_a_right_model_leaves_unit_noise() -> None:
    found = study((), {})
    assert Judge(found, baseline_of(found)).attempt(()).dispersion == pytest.approx(1.0, abs=0.3)


def test_the_same_conditions_in_all_recordings_show_what_drifts_would_hide() -> None:
    """A filter's laminar part looks like zero errors of sensors and a viscosity that change between two drives."""
    drifting = study(("laminar_filters",), {"laminar_filters": 0.4}, seed=5, model=load_model("uds"))
    same = dataclasses.replace(drifting, model=drifting.model.without_drifts())
    gains = []
    for found in (drifting, same):
        judge = Judge(found, baseline_of(found))
        gains.append(judge.attempt(("laminar_filters",)).evidence - judge.attempt(()).evidence)
    assert gains[0] < 10.0
    assert gains[1] > 25.0


def test_held_out_recordings_may_hold_an_input_still_that_wandered_in_training() -> None:
    """Without a step and a measurement's noise it looks like a command; it has no delay for all that."""
    found = study((), {})
    [section] = found.held
    still = section.drive.inputs.copy()
    still[:, 0] = still[:, 0].mean()
    held = dataclasses.replace(section, drive=dataclasses.replace(section.drive, inputs=still))
    found = dataclasses.replace(found, held=(held,))
    attempt = Judge(found, baseline_of(found)).attempt(())
    assert attempt.unknowns.delays == ("dc_dose",)
    assert attempt.predicted < attempt.training  # which is wrong, but can be said


@pytest.mark.parametrize("entry", ENTRIES)
def test_no_entry_is_worse_than_the_model_without_it(judge: Judge, nominal: Attempt, entry: str) -> None:
    """Nested models: at the null value an effect leaves the model as it was."""
    found = judge.attempt((entry,))
    assert found.cost <= nominal.cost + 1e-6
    glance = judge.glance((entry,), Begin(nominal.unknowns, nominal.x), 0)
    assert glance.cost == pytest.approx(nominal.cost, rel=1e-9)


def test_a_typical_beginning_comes_to_the_same_place(judge: Judge, nominal: Attempt, right: Attempt) -> None:
    other = judge.attempt(("full_open_gain",), Begin(nominal.unknowns, np.zeros(nominal.unknowns.size), typical=True))
    assert other.cost == pytest.approx(right.cost, abs=0.1)


def test_blocks_add_up_to_what_is_left(nominal: Attempt, judge: Judge) -> None:
    e, number = judge.left(nominal)
    assert nominal.blocks.sum() == pytest.approx(-0.5 * float(e @ e))
    assert len(nominal.blocks) == number.max() + 1

"""The experiment that would tell rivals apart: it can be recorded on the rig, and is planned on the rivals' models."""

import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest
from made_study import study
from scipy.stats import multivariate_normal

from faultline.analysis.discrepancy.effects.experiments import load_experiments
from faultline.analysis.discrepancy.name.attempt import Attempt, Baseline, Judge, Study, baseline_of
from faultline.analysis.discrepancy.name.experiment import Plan, divergence, propose
from faultline.analysis.model import load_model
from faultline.analysis.model.file import SYSTEMS
from faultline.testbench.cycles import DOSING_FROM, Segment, read_cycle

RIVALS = ("full_open_gain", "valve_shuts_late")
LONGEST_S = 120.0
SHIPPED = load_experiments(SYSTEMS / "uds").planned


@pytest.fixture(scope="module")
def fitted() -> tuple[Study, Baseline, list[Attempt]]:
    found = study(RIVALS, {"full_open_gain": 0.03})
    baseline = baseline_of(found)
    judge = Judge(found, baseline)
    return found, baseline, [judge.attempt((name,)) for name in RIVALS]


@pytest.fixture(scope="module")
def plans(fitted: tuple[Study, Baseline, list[Attempt]]) -> list[Plan]:
    return propose(*fitted, SHIPPED)


def test_every_shipped_experiment_can_be_recorded_on_the_rig_in_two_minutes(tmp_path: Path) -> None:
    assert len({e.name for e in SHIPPED}) == len(SHIPPED) >= 7
    how = SHIPPED[0].control
    assert (how.actuator, how.command, how.before_s) == ("n_p", "dc_dose", DOSING_FROM)
    for e in SHIPPED:
        assert 60.0 <= e.duration_s <= LONGEST_S, e.name
        text = e.cycle()
        table = tomllib.loads(text)
        assert {*table} == {"schema", "name", "text", "segment"}
        assert all({*segment} == {"duration_s", "setpoint_bar", "duty"} for segment in table["segment"])
        path = tmp_path / f"{e.name}.toml"
        path.write_text(text)
        cycle = read_cycle(path)
        assert (cycle.name, cycle.text) == (e.name.replace("_", "-"), e.text)
        segments = cycle.segments(e.duration_s, np.random.default_rng(0))[2:]
        for found, (duration, pressure, duty) in zip(segments, e.segments, strict=False):
            assert dataclasses.astuple(found) == pytest.approx(dataclasses.astuple(Segment(duration, pressure, duty)))
        assert len(segments) - len(e.segments) in (0, 1)  # of no length, where the rig holds the pressure
        assert sum(segment.duration for segment in segments) == pytest.approx(e.duration_s - how.before_s)


def test_every_experiment_is_planned_the_best_first(plans: list[Plan]) -> None:
    assert {plan.experiment.name for plan in plans} == {e.name for e in SHIPPED}
    assert [plan.left for plan in plans] == sorted(plan.left for plan in plans)
    for plan in plans:
        assert {*plan.expected} == {RIVALS, RIVALS[::-1]}
        assert np.isfinite([*plan.expected.values()]).all()


def test_the_proposed_plan_promises_evidence_for_whichever_it_is(plans: list[Plan]) -> None:
    assert plans[0].told == {RIVALS: min(plans[0].expected.values())}
    assert plans[0].untold == ()
    assert plans[0].left < 0.1


def test_where_nothing_is_dosed_rivals_of_the_dosing_valve_are_not_told_apart(plans: list[Plan]) -> None:
    by_name = {plan.experiment.name: plan for plan in plans}
    assert by_name["dose_staircase"].told
    assert by_name["pressure_ladder"].untold == (RIVALS,)
    assert by_name["pressure_ladder"].left > 0.3 > 0.1 > by_name["dose_staircase"].left


def test_evidence_to_expect_is_the_divergence_of_predictions() -> None:
    """Against the mean of log ratios over draws."""
    rng = np.random.default_rng(5)
    A, B = rng.normal(size=(2, 3, 6))
    true, other, d = np.eye(3) + A @ A.T, np.eye(3) + B @ B.T, np.array([0.5, -1.0, 2.0])
    assert divergence(np.zeros(3), true, true) == pytest.approx(0.0, abs=1e-9)
    drawn = multivariate_normal(np.zeros(3), true)
    y = drawn.rvs(100_000, random_state=5)
    ratio = drawn.logpdf(y) - multivariate_normal(d, other).logpdf(y)
    assert divergence(d, true, other) == pytest.approx(np.mean(ratio), abs=5 * np.std(ratio) / np.sqrt(len(y)))


def test_a_model_of_something_else_has_no_experiments(fitted: tuple[Study, Baseline, list[Attempt]]) -> None:
    found, baseline, rivals = fitted
    assert propose(dataclasses.replace(found, model=load_model("three-tank")), baseline, rivals, SHIPPED) == []
    assert propose(*fitted, ()) == []

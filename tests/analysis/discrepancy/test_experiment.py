"""The experiment that would tell rivals apart: it can be recorded on the rig, and is planned on the rivals' models."""

import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest
from made_study import study
from scipy.stats import multivariate_normal

from faultline.analysis.discrepancy.effects.experiments import joined, load_experiments
from faultline.analysis.discrepancy.name.attempt import Attempt, Baseline, Judge, Study, baseline_of
from faultline.analysis.discrepancy.name.experiment import SURE, Plan, Prediction, divergence, propose, ruled_out
from faultline.analysis.model import load_model
from faultline.analysis.model.file import SYSTEMS
from faultline.testbench.cycles import DOSING_FROM, Segment, read_cycle

RIVALS = ("full_open_gain", "valve_shuts_late")
LONGEST_S = 300.0
SHIPPED = load_experiments(SYSTEMS / "uds").planned


@pytest.fixture(scope="module")
def fitted() -> tuple[Study, Baseline, list[Attempt]]:
    found = study(RIVALS, {"full_open_gain": 0.03})
    baseline = baseline_of(found)
    judge = Judge(found, baseline)
    right, wrong = (judge.attempt((name,)) for name in RIVALS)
    alike = dataclasses.replace(  # as if these recordings did not tell
        wrong, training=right.training, predicted=right.predicted, blocks=right.blocks
    )
    return found, baseline, [right, alike]


@pytest.fixture(scope="module")
def plans(fitted: tuple[Study, Baseline, list[Attempt]]) -> list[Plan]:
    return propose(*fitted, SHIPPED)


def test_every_shipped_experiment_can_be_recorded_on_the_rig_in_five_minutes(tmp_path: Path) -> None:
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
    assert {plan.experiment.name for plan in plans} >= {e.name for e in SHIPPED}
    assert [plan.left for plan in plans] == sorted(plan.left for plan in plans)
    for plan in plans:
        assert {*plan.expected} == {RIVALS, RIVALS[::-1]}
        assert np.isfinite([*plan.expected.values()]).all()


def test_the_proposed_plan_promises_evidence_for_whichever_it_is(plans: list[Plan]) -> None:
    assert plans[0].resolved == {RIVALS: min(plans[0].expected.values())}
    assert plans[0].unresolved == ()
    assert plans[0].left < 0.1


def test_where_nothing_is_dosed_rivals_of_the_dosing_valve_are_not_told_apart(plans: list[Plan]) -> None:
    by_name = {plan.experiment.name: plan for plan in plans}
    assert by_name["dose_staircase"].resolved
    assert by_name["pressure_ladder"].unresolved == (RIVALS,)
    assert by_name["pressure_ladder"].left > 0.3 > 0.1 > by_name["dose_staircase"].left


def test_evidence_to_expect_is_the_divergence_of_predictions() -> None:
    """Against the mean of log ratios over draws."""
    rng = np.random.default_rng(5)
    true, other = (
        Prediction(rng.normal(size=3), rng.normal(size=(3, f)), np.diag(rng.uniform(0.5, 2.0, f))) for f in (2, 5)
    )
    assert divergence(true, true) == pytest.approx(0.0, abs=1e-9)
    drawn, wrong = (multivariate_normal(p.mean, np.eye(3) + p.J @ np.linalg.solve(p.H, p.J.T)) for p in (true, other))
    y = drawn.rvs(100_000, random_state=5)
    ratio = drawn.logpdf(y) - wrong.logpdf(y)
    assert divergence(true, other) == pytest.approx(np.mean(ratio), abs=5 * np.std(ratio) / np.sqrt(len(y)))


def test_a_model_of_something_else_has_no_experiments(fitted: tuple[Study, Baseline, list[Attempt]]) -> None:
    found, baseline, rivals = fitted
    assert propose(dataclasses.replace(found, model=load_model("three-tank")), baseline, rivals, SHIPPED) == []
    assert propose(*fitted, ()) == []


def test_an_experiment_that_tells_too_little_is_continued(fitted: tuple[Study, Baseline, list[Attempt]]) -> None:
    study, baseline, rivals = fitted
    short = dataclasses.replace(SHIPPED[3], segments=((15.0, 1e6, 0.5), (15.0, 1e6, 1.0)))
    best, *others, first = propose(study, baseline, rivals, [short])
    assert first.experiment == short
    assert min(first.likely.values()) < SURE
    assert best.left < min(plan.left for plan in [*others, first])
    assert best.experiment == joined([short] * (len(best.experiment.segments) // 2))
    assert best.experiment.duration_s <= short.control.longest_s
    assert best.experiment.text.endswith(f" times {short.text}")
    bounded = dataclasses.replace(short, control=dataclasses.replace(short.control, longest_s=short.duration_s))
    assert [plan.experiment for plan in propose(study, baseline, rivals, [bounded])] == [bounded]


def test_a_rival_is_the_likelier_ruled_out_the_more_evidence_is_to_come(
    fitted: tuple[Study, Baseline, list[Attempt]],
) -> None:
    right, wrong = fitted[2]
    chances = [ruled_out(right, wrong, nats) for nats in (0.0, 5.0, 20.0, 80.0)]
    assert chances == sorted(chances)
    assert chances[0] == 0.0
    assert chances[-1] > 0.99
    ahead = dataclasses.replace(right, training=right.training + 4.0)
    assert ruled_out(ahead, wrong, 5.0) > chances[1]

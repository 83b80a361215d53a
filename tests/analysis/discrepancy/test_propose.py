"""Formulas composed for an equation: sound entries of a library, screened by what they do, found where they are."""

import dataclasses
import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from made_runs import dosing, tanks, weights
from made_runs import made as made_run
from made_study import Inline

from faultline.analysis.calibration.problem import Problem
from faultline.analysis.calibration.sections import Section, fitting
from faultline.analysis.discrepancy.data import Data
from faultline.analysis.discrepancy.discover import Discovery, discover
from faultline.analysis.discrepancy.effects.compiled import system_with
from faultline.analysis.discrepancy.effects.library import effect_of, load_library
from faultline.analysis.discrepancy.effects.rewrite import rewritten
from faultline.analysis.discrepancy.find.disturbed import disturbed_runs
from faultline.analysis.discrepancy.find.features import Operation
from faultline.analysis.discrepancy.find.followed import followed
from faultline.analysis.discrepancy.find.latent import Misfit
from faultline.analysis.discrepancy.propose.candidates import Candidate, candidates
from faultline.analysis.discrepancy.propose.entries import entries_toml
from faultline.analysis.discrepancy.propose.proposal import Proposal, propose_formula
from faultline.analysis.discrepancy.propose.screen import FIELD, screened
from faultline.analysis.discrepancy.show.proposed import proposal_lines, proposal_of
from faultline.analysis.model import ModelError, load_model
from faultline.analysis.simulation import Trajectory, system_of

UDS4, TANKS, DRIVE = load_model("uds"), load_model("three-tank"), load_model("emps")
EVERY = 29
"""Of thousands of candidates every so many are put into the model."""

LEVEL, RUNS = 0.25, 2e-5
OVERFLOW = {
    "name": "overflow",
    "statement": "some of what tank 2 has above a level runs over",
    "component": "tank 2",
    "source": "made",
    "signature": "",
    "parameter": {
        "k": {"unit": "m2/s", "description": "runs over", "null": 0.0, "spread": 1e-5},
        "h": {"unit": "m", "description": "level", "value": LEVEL},
    },
    "change": [{"where": ["q12", "dh2"], "replace": "q12 -> q12 - k*(h2 - h + abs(h2 - h))/2"}],
}
"""What the true tanks have; no entry describes it, as the tanks have no library."""


@cache
def made(name: str) -> tuple[Problem, Operation]:
    t = np.arange(0.0, 20.0, 0.02)
    made_of = {
        "uds": lambda: dosing(UDS4, {}, 1),
        "three-tank": lambda: tanks(TANKS, {}, 1),
        "emps": lambda: made_run(DRIVE, np.sin(t)[:, None], t, {}, 1),
    }
    problem = made_of[name]()
    return problem, Operation(disturbed_runs(problem, np.zeros(problem.unknowns.size)))


def all_of(name: str) -> list[Candidate]:
    operation = made(name)[1]
    return [c for equation in operation.model.equations for c in candidates(operation, equation)]


@pytest.mark.parametrize("name", ["uds", "three-tank", "emps"])
def test_a_candidate_is_a_sound_entry(name: str) -> None:
    """Its units agree, and it is the model as it was at null; a few cannot be run, as a rate that a sensor shows."""
    model, found = load_model(name), all_of(name)[::EVERY]
    halted = []
    for candidate in found:
        try:
            new = rewritten(model, effect_of(candidate.table, "here"))
        except ModelError as error:
            assert "the model cannot be run with it" in str(error)  # noqa: PT017  (any other reason fails)
            halted.append(candidate)
            continue
        changed = [e for e in model.equations if new.equations[e].text != model.equations[e].text]
        assert changed == [candidate.equation], candidate.name
    assert len(found) > 10
    assert len(halted) < 0.1 * len(found)


@pytest.mark.parametrize("name", ["e16_p_du_as_backlash", "e17_p_tp_plus_time", "e18_p_ap_plus_rate_p_ap"])
def test_a_sensor_may_show_what_has_a_state_of_its_own(name: str) -> None:
    """The wound: a sensor shows one unknown, so that backlash and drift of sensors were never fitted."""
    candidate = next(c for c in all_of("uds") if c.name == name)
    new = rewritten(UDS4, effect_of(candidate.table, "here"))
    assert new.equations[candidate.equation].text.endswith("_seen")


@pytest.mark.parametrize(
    "name",
    [
        "e04_q_dos_times_step_dc_dose_1",
        "e04_dc_dose_plus_between_dc_dose_0_1",
        "e10_B_ap_times_linear_p_ap",
        "e11_q_filt_du_plus_late_p_du",
        "e07_A_du_times_integral_q_filt_du",
        "e02_C_v_times_settling",
        "e16_p_du_as_lag",
    ],
)
def test_the_course_of_a_candidate_is_what_its_entry_does(name: str) -> None:
    """To first order: the disturbance of the equation against the derivative of the model with the term in it."""
    problem, operation = made("uds")
    candidate = next(c for c in all_of("uds") if c.name == name)
    column = operation.runs.outputs(candidate.equation, operation.split(candidate.direction[:, None]))[0][:, 0]
    effect = effect_of(candidate.table, "here")
    system = system_with(UDS4, [effect])
    new = Problem(system, [fitting(section, system) for section in problem.sections])
    x = np.zeros(new.unknowns.size)
    small = np.zeros_like(x)
    part = 1.0 if candidate.form == "lag" else 0.01  # a lag's direction is that of a whole spread
    small[new.unknowns.parameters.index(next(iter(effect.strengths)))] = part
    moved = (new.left(x)[0] - new.left(x + small)[0]) / part
    assert np.sqrt(np.mean((moved - column) ** 2)) < 0.2 * np.sqrt(np.mean(moved**2))


def test_the_screening_finds_what_was_added() -> None:
    """A valve that passes more when held open, among all candidates of the four equations that may miss it."""
    problem = dosing(UDS4, {"e04": lambda v: 0.17 * v["q_dos"] * (v["dc_dose"] > 0.98)}, 1)
    x = np.zeros(problem.unknowns.size)
    operation = Operation(disturbed_runs(problem, x))
    misfit = Misfit(problem, x, weights(problem, x))
    field, tried = screened(misfit, operation, ["e03", "e04", "e10", "e11"], lambda _: True)
    assert tried > 500
    assert len(field) <= FIELD
    best = field[0]
    does = {each.candidate.name for each in (best, *best.same)}
    assert "e04_q_dos_times_step_dc_dose_1" in does
    assert best.evidence > 5.0 + field[-1].evidence


def test_runs_follow_what_was_measured_with_an_unknown_input() -> None:
    """Less and less goes on to the hose above 9.5 bar: the free run is bars away from what was measured."""
    problem = dosing(UDS4, {"e10": lambda v: 0.3 * np.maximum(v["p_ap"] - 9.5e5, 0.0)}, 1)
    x = np.zeros(problem.unknowns.size)
    near = followed(problem, x, weights(problem, x), "e10")
    measured = problem.sections[0].samples["y_p_ap"]

    def off(section: Section, trajectory: Trajectory) -> float:
        e = np.interp(measured.t, section.t, trajectory.outputs()["y_p_ap"]) - measured.value
        return float(np.sqrt(np.mean(e**2)))

    free = off(problem.sections[0], problem.trajectories(x)[0])
    assert free > 1e5
    assert off(*near.operation.runs.pairs[0]) < 0.1 * free


def search(runs_over: float) -> Discovery:
    true = rewritten(TANKS, effect_of(OVERFLOW, "here"))
    size = dataclasses.replace(true.parameters["overflow_k"], value=runs_over)
    true = dataclasses.replace(true, parameters={**true.parameters, "overflow_k": size})
    training, held = (tuple(tanks(TANKS, {}, seed, true).sections) for seed in (1, 2))
    data = Data(TANKS, system_of(TANKS, TANKS.calibrated), (), (), training, held)
    return discover(data, {}, Inline(), None, lambda *_: None)


@cache
def proposed() -> tuple[Discovery, Proposal | None]:
    found = search(RUNS)
    return found, propose_formula(found, Inline(), None, lambda *_: None)


def test_a_formula_is_proposed_for_another_system() -> None:
    found, proposal = proposed()
    assert found.verdict.kind == "unnamed"
    assert proposal is not None
    assert proposal.terms[0].equation == "e06"
    assert proposal.terms[0].family[-1] == "above h2"
    assert proposal.whole
    told = proposal_of(found, proposal)
    assert told.gain > told.threshold
    assert told.gain_held_out > 0.0
    level = next(s for s in told.strengths if s.parameter.endswith("_L"))
    low, high = level.interval or (None, None)
    assert low is not None
    assert high is not None
    assert low < LEVEL < high
    steady = [r for r in told.regimes if r.output == "y2"]
    assert all(r.rms_after < r.rms_before for r in steady)
    lines = proposal_lines(told)
    assert lines[0].startswith("a formula is proposed, to be reviewed: in ")
    assert any("becomes" in line and "S*dh2" in line for line in lines)
    assert any(line.startswith("against it: ") for line in lines)


def test_a_proposal_is_an_entry_for_review(tmp_path: Path) -> None:
    """The file is read as any library is, and its entries are the effects that were fitted."""
    _, proposal = proposed()
    assert proposal is not None
    file = tmp_path / "proposal.toml"
    file.write_text(entries_toml("three-tank", proposal.terms, proposal.rivals))
    assert tomllib.loads(file.read_text())["schema"] == 1
    read = load_library(None, file)
    for term in (*proposal.terms, *proposal.rivals):
        fitted = proposal.study.library[term.name]
        assert dataclasses.replace(read[term.name], place="") == dataclasses.replace(fitted, place="")


def test_nothing_is_proposed_where_nothing_is_missing() -> None:
    found = search(0.0)
    assert found.verdict.kind == "nothing missing"
    assert propose_formula(found, Inline(), None, lambda *_: None) is None

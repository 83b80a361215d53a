"""Calibration where the usual starts all agree and are all wrong: a threshold that begins beyond what was recorded."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from once import once

from faultline.analysis.calibration.fit import Fit, fit
from faultline.analysis.calibration.global_starts import MANY, global_starts
from faultline.analysis.calibration.likelihood import Likelihood, bins_of
from faultline.analysis.calibration.problem import Problem
from faultline.analysis.calibration.report import _of_global_search
from faultline.analysis.calibration.sections import Samples, Section
from faultline.analysis.model import Model, Parameter, load_model
from faultline.analysis.model.expression import parse_expression
from faultline.analysis.recordings.modes import time_of
from faultline.analysis.simulation import Drive, System, run, system_of

FORCE, THRESHOLD = 20.0, 0.3
"""Of the made drive: a braking force [N] above a velocity [m/s]. The model's threshold begins at 5 m/s."""


def braked() -> Model:
    """The shipped drive with a force that brakes it above a velocity."""
    model = load_model("emps")
    text = "M*dv - (F - Fv*v - F_0 - F_b*(tanh(20*(v/v_1 - t_b)) + tanh(20*(v/v_1 + t_b)))/2)"
    values: dict[str, Any] = {
        "F_b": {"unit": "N", "value": 15.0, "spread": 10.0, "prior": None, "min": 0.0, "max": 200.0},
        "t_b": {"unit": "1", "value": 5.0, "spread": None, "prior": 1.5, "min": 1e-3, "max": 50.0},
        "v_1": {"unit": "m/s", "value": 1.0, "spread": None, "prior": None, "min": None, "max": None},
    }
    new = {name: Parameter(description="", source="made", **given) for name, given in values.items()}
    parameters = {**model.parameters, **new}
    expression = parse_expression(text, [*model.known, *model.unknown, *parameters], "e2")
    e2 = dataclasses.replace(model.equations["e2"], text=text, expression=expression, fault=None)
    return dataclasses.replace(model, parameters=parameters, equations={**model.equations, "e2": e2})


def recorded(model: Model, force: float, threshold: float) -> tuple[System, Section]:
    """A minute of a made drive with this brake, its velocity measured with noise."""
    system, t = system_of(model, model.calibrated), np.arange(0.0, 60.0, 0.05)
    u = (3.0 * np.sin(t) + 1.5 * np.sin(2.3 * t))[:, None]
    drive = Drive(0.05, u, np.zeros(1), np.zeros((len(t), 1)))
    values = {name: model.parameters[name].value for name in system.parameters}
    y = run(system, drive, {**values, "F_b": force, "t_b": threshold}).outputs()
    at = np.arange(0, len(t) - 1, 4)
    shown = y["y_v"][at] + np.random.default_rng(1).normal(0.0, 0.002, len(at))
    samples = {"y_v": Samples(t[at], shown, np.ones(len(at), dtype=np.int64))}
    return system, Section(0, 0.0, drive, np.full_like(u, 0.01), samples, y, time_of(model))


@once
def fitted(force: float = FORCE) -> Fit:
    system, section = recorded(braked(), force, THRESHOLD)
    return fit(system, [section], lambda _: None)


def test_where_the_data_have_no_gradient_a_global_search_finds_the_parameters() -> None:
    """The wound: 4 of 4 searches came to the same place, which was where they had begun, and the model was written."""
    found = fitted()
    assert found.globally is not None
    assert found.globally.starts == (4, 4)
    assert "do not depend on F_b, t_b" in found.globally.reason
    assert found.globally.gain > 15.0
    assert found.values["F_b"] == pytest.approx(FORCE, rel=0.03)
    assert found.values["t_b"] == pytest.approx(THRESHOLD, rel=0.03)
    assert 2 * found.starts[1] >= found.starts[0] > 1


def test_where_there_is_nothing_better_it_says_so() -> None:
    found = fitted(0.0)
    assert found.globally is not None
    assert found.globally.gain < 20.0  # less of the prior of F_b, at most
    assert found.values["Fv"] == pytest.approx(30.0, rel=0.02)


def test_the_sets_that_are_tried_are_within_the_bounds_and_the_starts_apart() -> None:
    system, section = recorded(braked(), FORCE, THRESHOLD)
    problem = Problem(system, [section])
    begin = np.zeros(problem.unknowns.size)
    weights = Likelihood(problem, begin, np.full((1, len(system.model.modes.names)), 0.001), [bins_of(section)]).weights
    open_ones = np.isin(np.arange(len(begin)), [system.parameters.index(name) for name in ("F_b", "t_b")])
    found = global_starts(problem, weights, begin, open_ones, 3)
    assert (found.tried, len(found.x)) == (MANY, 3)
    for k, x in enumerate(found.x):
        assert (x >= problem.bounds[0]).all()
        assert (x <= problem.bounds[1]).all()
        assert all(np.abs(x - other)[open_ones].max() > 0.1 for other in found.x[:k])


def test_the_report_says_what_was_done() -> None:
    found = fitted().globally
    assert found is not None
    said = _of_global_search(found)
    assert said.startswith("where the searches ended the data do not depend on F_b, t_b, so 64 sets of parameters")
    assert said.endswith(f"ended {found.gain:.0f} nats better")
    worse = dataclasses.replace(found, gain=0.0, failed=3)
    assert "(3 could not be run); the searches from the best of them found nothing better" in _of_global_search(worse)

"""What was added to an equation is found there; where nothing was, nothing is."""

import dataclasses
from functools import cache

import numpy as np
import pytest
import sympy as sp
from made_runs import DOSE, HOLD_S, Missing, dosing, tanks, weights

from faultline.analysis.calibration.problem import Problem
from faultline.analysis.discrepancy.find.classes import inseparable, splitting_sensors
from faultline.analysis.discrepancy.find.latent import Latent, null_law, tail
from faultline.analysis.discrepancy.find.locate import Location, locate
from faultline.analysis.model import Model, Parameter, load_model
from faultline.analysis.simulation import Drive, System, disturbance, run, system_of
from faultline.service.core.errors import InputError

UDS4, TANKS = load_model("uds"), load_model("three-tank")

MISSING: dict[str, dict[str, Missing]] = {
    "nothing": {},
    "held open": {"e04": lambda v: 0.17 * v["q_dos"] * (v["dc_dose"] > 0.98)},
    "cake": {"e07": lambda v: -0.2 * v["q_filt_du"] * v["t"] / v["t"][-1]},
    "late sensor": {"e16": lambda v: -0.3 * v["dp_du"]},
    "stiff hose": {"e10": lambda v: 0.06 * v["dp_ap"] * (v["p_ap"] - 9e5) / 1e5},
    "two": {
        "e04": lambda v: 0.17 * v["q_dos"] * (v["dc_dose"] > 0.98),
        "e17": lambda v: np.where(v["t"] > 80.0, -400.0, 0.0),
    },
}


@cache
def located(name: str, seed: int = 1) -> tuple[Problem, Location]:
    problem = dosing(UDS4, MISSING[name], seed)
    x = np.zeros(problem.unknowns.size)
    return problem, locate(problem, x, weights(problem, x))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_model_that_misses_nothing_has_no_suspect(seed: int) -> None:
    _, found = located("nothing", seed)
    assert found.members == ()
    assert not any(suspect.significant for suspect in found.suspects)
    assert found.sentences == ("no equation misses anything that these recordings show",)


@pytest.mark.parametrize(
    ("name", "equation"),
    [("held open", "e04"), ("cake", "e07"), ("late sensor", "e16"), ("stiff hose", "e10")],
)
def test_the_equation_that_was_changed_comes_first(name: str, equation: str) -> None:
    _, found = located(name)
    assert found.members[0] == equation
    assert found.suspects[0].significant
    assert not found.further


def test_the_smoothed_input_is_what_was_added_but_for_what_a_parameter_absorbs() -> None:
    """The wider valve is in part a larger area: held open against partly open is what is known, and with closed."""
    _, found = located("held open")
    e04 = next(suspect for suspect in found.suspects if suspect.equation == "e04")
    assert (e04.variable, e04.unit) == ("q_dos", "m3/s")
    hold = (e04.t / HOLD_S).astype(int)
    dose = np.array(DOSE)[hold]
    inside = (e04.t > UDS4.warm_up_s + 4.0) & (np.abs(e04.t - HOLD_S * np.round(e04.t / HOLD_S)) > 1.5)
    relative = e04.value[inside & (dose > 0.0)] / (1.2e-6 * dose[inside & (dose > 0.0)])
    open_ = dose[inside & (dose > 0.0)] == 1.0
    assert np.median(relative[open_]) - np.median(relative[~open_]) == pytest.approx(0.17, abs=0.03)
    assert np.abs(e04.value[inside & (dose == 0.0)]).max() < 0.04e-6


def test_what_no_recording_tells_apart_is_said_with_the_sensor_that_would() -> None:
    _, found = located("held open")
    assert {"e03", "e11"} <= set(found.members)
    assert found.inseparable == ("e03", "e11")
    assert found.sensors == ("q_dos",)
    assert found.sentences[-1].endswith("a sensor of q_dos would")


def test_a_second_effect_is_seen_beside_the_first() -> None:
    _, found = located("two")
    assert found.members[0] == "e04"
    assert [suspect.equation for suspect in found.further] == ["e17"]
    assert found.sentences[-1] == "besides, something is missing in added sensor between the filters (4.27) (e17)"


def test_once_the_effect_is_in_the_model_nothing_is_left() -> None:
    before, after = (_fitted(dosing(model, {}, 4, _with_growing_dose(UDS4, 0.3))) for model in GROWING)
    assert before.members[0] == "e04"
    assert after.members == ()
    assert after.suspects[0].evidence < 0.01 * before.suspects[0].evidence


def test_another_system() -> None:
    """A leak of tank 2 that opens: its balance cannot be told from nothing, as every level is measured."""
    problem = tanks(TANKS, {"e06": lambda v: np.where(v["t"] > 300.0, -1e-5, 0.0)}, 1)
    x = np.zeros(problem.unknowns.size)
    found = locate(problem, x, weights(problem, x))
    assert found.members[0] == "e06"
    assert found.suspects[0].significant


def test_classes_follow_from_the_structure() -> None:
    assert inseparable(UDS4, "e01") == ("e02",)
    assert inseparable(UDS4, "e10") == ()
    assert splitting_sensors(UDS4, "e01", ("e02",))[0] == "eta_volp"
    assert splitting_sensors(UDS4, "e10", ("e04",)) == ()
    assert inseparable(TANKS, "e04") == ("e07",)


def test_the_null_law_is_that_of_the_evidence() -> None:
    rng = np.random.default_rng(3)
    C = rng.standard_normal((60, 12)) * np.geomspace(0.1, 30.0, 12)
    roots = [np.eye(12), np.diag(np.where(np.arange(12) < 4, 1.0, 0.0))]
    drawn = np.array(
        [max(Latent(C.T @ C, C.T @ rng.standard_normal(60), root).evidence for root in roots) for _ in range(600)]
    )
    law = null_law(C.T @ C, roots, 600)
    assert np.mean(drawn > np.quantile(law, 0.9)) == pytest.approx(0.1, abs=0.04)
    assert tail(law, float(np.quantile(drawn, 0.99))) == pytest.approx(0.01, abs=0.01)


def test_what_a_disturbance_does_is_the_derivative_of_the_disturbed_run() -> None:
    system = system_of(UDS4, UDS4.calibrated, disturbed=True)
    theta = {name: UDS4.parameters[name].value for name in system.parameters}
    start = np.array([99e3, 95e3, 1.0e6, 0.95e6])
    u = np.zeros((100, len(system.inputs)))
    u[:, :2] = (25.0, 0.5)
    drive = Drive(0.1, u, start, np.tile(start, (100, 1)))
    trajectory = run(system, drive, theta)
    for equation, small in (("e02", 1e-5), ("e04", 1e-11), ("e16", 1.0)):
        moved = u.copy()
        moved[40:, system.inputs.index(disturbance(equation))] = small
        there = run(system, dataclasses.replace(drive, inputs=moved), theta, trajectory).outputs()
        by = trajectory.by_input(disturbance(equation), (moved - u)[:, [system.inputs.index(disturbance(equation))]])
        for name, before in trajectory.outputs().items():
            size = np.abs(by[name]).max() + 1e-6
            assert there[name] - before == pytest.approx(by[name][:, 0], abs=0.01 * size)


def test_a_name_that_is_a_disturbances_is_refused() -> None:
    taken = dataclasses.replace(UDS4, parameters={**UDS4.parameters, "d_e04": UDS4.parameters["eta"]})
    with pytest.raises(InputError, match="d_e04 names a disturbance of an equation; call it something else"):
        system_of(taken, [], disturbed=True)
    system: System = system_of(taken, [])
    assert "d_e04" not in system.inputs


def _fitted(problem: Problem) -> Location:
    x = np.zeros(problem.unknowns.size)
    x = problem.search(x, weights(problem, x), 1e-6).x
    return locate(problem, x, weights(problem, x))


def _with_growing_dose(model: Model, size: float = 0.0) -> Model:
    """The dosed flow with 1 + g times the duty cycle; zero is the model as it was."""
    e04 = model.equations["e04"]
    flow = sp.Symbol("q_dos") - e04.expression
    changed = sp.Symbol("q_dos") - flow * (1 + sp.Symbol("g") * sp.Symbol("dc_dose"))
    g = Parameter(unit="1", description="", value=size, min=-0.5, max=2.0, prior=None, source="", spread=0.3)
    equations = {**model.equations, "e04": dataclasses.replace(e04, expression=changed)}
    return dataclasses.replace(model, equations=equations, parameters={**model.parameters, "g": g})


GROWING = (UDS4, _with_growing_dose(UDS4))

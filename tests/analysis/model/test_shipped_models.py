"""The models that come with the program: each loads, is analysed, and computes or says why it does not."""

import math

import numpy as np
import pytest
import sympy as sp

from faultline.analysis.graph.bank import build_bank
from faultline.analysis.model import dump_model, load_model, parse_model
from faultline.analysis.model.file import shipped_models
from faultline.analysis.structure import detectable, find_tests, integral_tests, isolability, mso_sets, structure_of
from faultline.analysis.structure.command import main as structure
from faultline.service.core.errors import InputError
from faultline.service.core.residuals.generators import Graph

UDS1, UDS4, RC = load_model("uds/production"), load_model("uds"), load_model("rc")


def test_the_systems_are_shipped() -> None:
    assert list(shipped_models()) == ["emps", "rc", "three-tank", "uds", "uds/production"]


@pytest.mark.parametrize("name", shipped_models())
def test_every_one_is_analysed_and_survives_being_written(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    model = load_model(name)
    assert parse_model(dump_model(model), name) == model
    assert structure([name]) == 0
    assert capsys.readouterr().out.startswith(f"{model.name}: {model.description}\n")


@pytest.mark.parametrize("name", shipped_models())
def test_every_signal_parameter_and_state_says_its_unit_and_source(name: str) -> None:
    model = load_model(name)
    assert model.source
    assert all(p.source and p.description and p.unit for p in model.parameters.values())
    assert all(k.unit and k.description for k in model.known.values())
    assert all(u.unit for u in model.unknown.values())


def test_the_rc_circuit_is_example_4_and_its_residual_that_of_example_6() -> None:
    found = structure_of(RC)
    rows = {name: set(found.unknowns_in([name])) for name in found.equations}
    expected = {"e1": {"u_R", "i"}, "e2": {"du_c", "i"}, "e3": {"i"}, "e4": {"u_R", "u_c"}, "e5": {"u_c", "du_c"}}
    assert rows == expected
    assert mso_sets(found) == [("e1", "e2", "e3", "e4", "e5")]
    tests = find_tests(RC)
    assert detectable(tests, found.faults) == ("f_R", "f_y_i")
    assert isolability(tests, found.faults) == {"f_R": ("f_y_i",), "f_y_i": ("f_R",)}
    [test] = integral_tests(RC)
    assert (test.residual, test.predicts, test.states) == ("e3", "y_i", ("u_c",))


def test_the_rc_circuit_charges_with_its_time_constant() -> None:
    """After a step of the voltage from 0 to 10 V the current falls as exp(-t / RC), and the residual is silent."""
    bank = build_bank(RC)
    R, C = RC.parameters["R"].value, RC.parameters["C"].value
    graph, x = Graph(bank.graph()), np.array([[0.0]])
    t = RC.period_s * np.arange(1, 51)
    currents = []
    for _ in t:
        _, y_hat, _, x = graph(z=np.array([[10.0, 0.0]]), x=x)
        currents.append(y_hat[0, 0])
    exact = 10.0 / R * np.exp(-t / (R * C))
    np.testing.assert_allclose(currents, exact, atol=0.05 * 10.0 / R)  # implicit Euler, a tenth of RC a step
    np.testing.assert_allclose(currents, 10.0 / R / (1 + RC.period_s / (R * C)) ** np.arange(1, 51), rtol=1e-9)


def test_the_one_state_model_has_the_thesiss_equations() -> None:
    """(4.17)-(4.20) at 3.2 mL/s: the drops that uds's file states for its filters, 20, 40 and 60 mbar."""
    numbers = {name: p.value for name, p in UDS1.parameters.items()}
    drops: dict[str, sp.Expr] = {}
    for equation, variable in (("e06", "p_tp"), ("e07", "p_bp"), ("e08", "p_ap")):
        expression = UDS1.expression(equation, with_fault=False).subs({**numbers, "q_pump": 3.2e-6, **drops})
        [drops[variable]] = sp.solve(expression.subs("p_du", 1e6), sp.Symbol(variable))
    assert float(drops["p_tp"]) == pytest.approx(101325 - 2000, abs=5)
    assert float(drops["p_bp"]) == pytest.approx(101325 - 6000, abs=10)
    assert float(drops["p_ap"]) == pytest.approx(1e6 + 6000, abs=10)
    assert [d.state for d in UDS1.differentials] == ["p_du"]
    rest = {n: f for n, f in UDS4.faults.items() if n in UDS1.faults}
    assert list(UDS1.faults) == list(rest) == list(UDS4.faults)


def test_a_square_with_two_roots_is_refused_and_none_is_taken() -> None:
    """The thesis left its one-state model because a tool took the first root without a word (ch. 7.3)."""
    flow = sp.Symbol("q_pump")
    numbers = {name: p.value for name, p in UDS1.parameters.items()}
    roots = sp.solve(UDS1.expression("e06", with_fault=False).subs({**numbers, "p_tp": 99325.0}), flow)
    assert sorted(math.copysign(1, root) for root in roots) == [-1, 1]
    with pytest.raises(InputError, match=r"^uds_production: no test can be run \(t01: .*, e06 cannot be solved for"):
        build_bank(UDS1)


def test_every_test_of_the_one_state_model_needs_such_a_root_or_a_loop() -> None:
    obstacles = [test.obstacle or "" for test in find_tests(UDS1)]
    roots = [obstacle for obstacle in obstacles if "cannot be solved for q_pump with one solution only" in obstacle]
    loops = [obstacle for obstacle in obstacles if "are an algebraic loop of q_pump, eta_volp, " in obstacle]
    assert (len(roots), len(loops), len(obstacles)) == (5, 10, 15)
    assert integral_tests(UDS1) == ()
    # Without formulas the squares cannot be seen: the same structure has eight tests.
    assert len(integral_tests(structure_of(UDS1))) == 8

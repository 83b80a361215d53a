"""What the canonical form cannot hold is refused by name; what it can hold steps as the exact solution says."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from faultline.analysis.graph.bank import Bank, build_bank
from faultline.analysis.graph.network import Evaluator, flow_network
from faultline.analysis.graph.runnable import Runnable
from faultline.analysis.model import Model, parse_model
from faultline.analysis.structure import integral_tests
from faultline.service.core.errors import InputError
from faultline.service.core.residuals.generators import Graph

PERIOD_S = 0.2  # of the dosing system


Array = npt.NDArray[np.float64]

MODEL = """
schema = 1
name = "tank"

[known.y]
unit = "Pa"
min = 0.0
max = 1e5
noise = 5.0

[known.u]
unit = "1"
min = 0.0
max = 10.0
noise = 0.01

[unknown.p]
unit = "Pa"
initial = {initial}

[unknown.dp]
unit = "Pa/s"

[unknown.q]
unit = "Pa/s"

[parameter.A]
unit = "1"
value = 2.0

[parameter.k]
unit = "Pa/s"
value = 50.0

[[equation]]
name = "e1"
expr = "{flow}"
fault = {{name = "fA", component = "outlet", description = "", enters = "{enters}", sizes = [-0.5]}}

[[equation]]
name = "e2"
expr = "dp - ({rate})"

[[equation]]
name = "e3"
expr = "{sensor}"
fault = {{name = "fy", component = "sensor", description = "", enters = "p -> p + fy", sizes = [10.0]}}

[[differential]]
name = "e4"
state = "p"
derivative = "dp"
"""


def model(
    flow: str = "q - A*sgsqrt(p)",
    rate: str = "k*u - q",
    sensor: str = "y - p",
    enters: str = "A -> A + fA",
    initial: str = '["y"]',
) -> Model:
    """A tank: y measures p, u feeds it, q leaves it."""
    return parse_model(MODEL.format(flow=flow, rate=rate, sensor=sensor, enters=enters, initial=initial), "tank.toml")


TANK = model()
LINEAR = model(flow="q - A*p")


def stepped(bank: Bank, u: Array, p0: float) -> Array:
    """Predictions (K,) of the only generator from the state p0."""
    graph, x, out = Graph(bank.graph()), np.array([[p0]]), []
    for level in u:
        _, y_hat, _, x = graph(z=np.array([[0.0, level]]), x=x)
        out.append(y_hat[0, 0])
    return np.array(out)


@pytest.mark.parametrize(
    ("refused", "reason"),
    [
        (model(flow="q - A*sgsqrt(p**2 + p)"), "a root has p in it other than in proportion, p**2; the implicit step"),
        (
            model(flow="q - A*sgsqrt(p + sgsqrt(p))"),
            "a flow is in a root, sgsqrt(p); the implicit step cannot solve it",
        ),
        (model(flow="q - A*p*sgsqrt(p)"), "a flow is multiplied by its own state, -p*(A + fA); the implicit"),
        (model(rate="k*u - q - q*q"), "multiplies flows, "),
        (model(flow="q - A*u**(1/3)*sgsqrt(p)"), "a graph has roots of second, fourth, eighth order only, u**(1/3)"),
        (model(flow="q*q - A*p"), "no test can be run (t01: with residual e3, e1 cannot be solved for q"),
        (model(flow="sgsqrt(q) - A*p"), "e1 cannot be solved for q with one solution only"),
    ],
)
def test_what_the_form_cannot_hold_is_refused_with_model_test_and_reason(refused: Model, reason: str) -> None:
    with pytest.raises(InputError) as caught:
        build_bank(refused)
    message = str(caught.value)
    assert message.startswith("tank: ")
    assert "t01: " in message
    assert len(message) <= 220
    assert reason in message
    assert "\n" not in message


def test_a_model_without_a_state_predicts_from_the_samples_alone() -> None:
    """`y - u` is a static test: its graph has states of width zero and one residual, y - u."""
    text = MODEL.replace("p -> p + fy", "u -> u + fy")
    static = text.format(flow="q - A*sgsqrt(p)", rate="k*u - q", sensor="y - u", enters="A -> A + fA", initial='["y"]')
    bank = build_bank(parse_model(static, "tank"))
    assert [(test.predicts, test.states) for test in bank.tests] == [("y", ())]
    assert [channel.signal for channel in bank.inputs] == ["y", "u"]
    z = np.array([[7.0, 3.0], [2.0, 5.0]])
    r, y_hat, *_, x = Graph(bank.graph())(z=z, x=np.empty((2, 0)))
    assert y_hat.tolist() == [[3.0], [5.0]]
    assert r.tolist() == [[4.0], [-3.0]]
    assert x.shape == (2, 0)


@pytest.mark.parametrize(
    ("sensor", "shows"),
    [
        ("y - p**2", lambda p: p**2),
        ("y - A*sgsqrt(p)", lambda p: 2.0 * np.sqrt(p)),
        ("y - p - k*tanh(p/k)", lambda p: p + 50.0 * np.tanh(p / 50.0)),
        ("y - max(p, k)", lambda p: np.maximum(p, 50.0)),
    ],
)
def test_a_sensor_that_is_not_affine_shows_the_state_after_the_step(
    sensor: str, shows: Callable[[Array], Array]
) -> None:
    u = np.concatenate([np.full(20, 0.1), np.full(20, 7.0)])
    flow = "q - A*sgsqrt(p)"
    p = stepped(build_bank(model(flow=flow)), u, 30.0)
    bank = build_bank(model(flow=flow, sensor=sensor))
    np.testing.assert_allclose(stepped(bank, u, 30.0), shows(p), rtol=1e-12)
    zero_and_u = np.column_stack([np.zeros_like(u), u])
    y_hat = -bank.simulate([{}, {"fA": 0.0}, {"fy": 10.0}], zero_and_u, np.array([30.0]))[:, :, 0]
    np.testing.assert_allclose(y_hat[:, :2], np.stack([shows(p)] * 2, axis=1), rtol=1e-12)
    np.testing.assert_allclose(y_hat[:, 2], shows(p + 10.0), rtol=1e-12)


def test_a_test_that_cannot_be_run_is_named_and_left_out() -> None:
    second = """
[known.u2]
unit = "Pa"
min = 0.0
max = 1e5
noise = 5.0

[[equation]]
name = "e5"
expr = "u2 - k*u"
fault = {name = "fu", component = "second sensor", description = "", enters = "k -> k + fu", sizes = [10.0]}
"""
    unsolvable = model(flow="q - A*p*sgsqrt(p)")
    text = MODEL.format(flow="q - A*p*sgsqrt(p)", rate="k*u - q", sensor="y - p", enters="A -> A + fA", initial='["y"]')
    with pytest.raises(InputError, match=r"t01: a flow is multiplied by its own state"):
        build_bank(unsolvable)
    bank = build_bank(parse_model(text + second, "tank"))
    assert [(test.name, test.predicts) for test in bank.tests] == [("t01", "u2")]
    [note] = bank.notes()
    assert note.startswith("left out: t02: a flow is multiplied by its own state, ")


def test_a_model_that_no_sensor_watches_is_refused() -> None:
    text = MODEL.replace("p -> p + fy", "u -> u + fy")
    blind = text.format(flow="q - A*sgsqrt(p)", rate="k*u - q", sensor="y*u - 1", enters="A -> A + fA", initial='["y"]')
    with pytest.raises(InputError, match=r"tank: no test can be run \(t01: no sensor is predicted by e3"):
        build_bank(parse_model(blind, "tank.toml"))


def test_the_network_of_the_tank_is_the_one_written_down() -> None:
    [test] = integral_tests(TANK)
    network = flow_network(TANK, test, ["y", "u"])
    [values] = Evaluator([network], TANK)([{"k": 7.0, "fA": -0.5}])
    assert (values.test, values.states) == ("t01", ("p",))
    assert values.alpha[0].tolist() == [[1.0]]
    assert values.beta[0].tolist() == [[0.0, 0.0, 0.0]]
    assert (values.mu[0] * values.C[0]).tolist() == [[-1.5, 0.0, 0.0]]
    assert values.A[0].tolist() == [[0.0]]
    assert values.B[0].tolist() == [[0.0, 0.0, 7.0]]
    assert values.H[0].tolist() == [[1.0]]
    assert values.E[0].tolist() == [[0.0, 0.0, 0.0]]


def test_an_opening_commanded_by_a_signal_is_kept_apart_from_the_flow() -> None:
    dosed = model(flow="q - A*(1 + 3*u)*sgsqrt(p - k)")
    [test] = integral_tests(dosed)
    [values] = Evaluator([flow_network(dosed, test, ["y", "u"])], dosed)([{}])
    opening = (values.C[0, 0][:, None] * values.mu[0]).sum(axis=0)  # per unit of velocity, over [1; y; u]
    np.testing.assert_allclose(opening, [-2.0, 0.0, -6.0])
    assert set(values.alpha[0].ravel()) == {1.0}
    assert set(values.beta[0][:, 0]) == {-50.0}


def test_every_trial_has_its_own_parameters() -> None:
    [test] = integral_tests(TANK)
    [values] = Evaluator([flow_network(TANK, test, ["y", "u"])], TANK)([{}, {"A": 3.0}, {"k": 1.0}])
    assert (values.mu[:, 0, 0] * values.C[:, 0, 0]).tolist() == [-2.0, -3.0, -2.0]
    assert values.B[:, 0, 2].tolist() == [50.0, 50.0, 1.0]


def test_a_tank_without_an_orifice_steps_as_backward_euler_and_tends_to_the_exact_solution() -> None:
    """p' = k u - A p."""
    bank = build_bank(LINEAR)
    p = stepped(bank, np.full(60, 2.0), 200.0)
    euler = 50.0 + 150.0 / (1 + 2.0 * PERIOD_S) ** np.arange(1, 61)
    np.testing.assert_allclose(p, euler, rtol=1e-7)
    assert abs(p[-1] - 50.0) < 1e-6


def test_an_emptying_tank_follows_the_parabola() -> None:
    """p' = -A sgsqrt(p): sqrt(p) falls linearly by A t / 2; a step is p+ + h A sqrt(p+) = p, exactly."""
    bank = build_bank(TANK)
    p = stepped(bank, np.zeros(100), 1e4)
    t = PERIOD_S * np.arange(1, 101)
    exact = (100.0 - t) ** 2
    np.testing.assert_allclose(np.sqrt(p), np.sqrt(exact), atol=0.05)
    before = np.concatenate([[1e4], p[:-1]])
    np.testing.assert_allclose(p + PERIOD_S * 2.0 * np.sqrt(p), before, rtol=1e-9)


def test_a_fed_tank_settles_where_what_enters_leaves() -> None:
    p = stepped(build_bank(TANK), np.full(1000, 0.4), 0.0)
    np.testing.assert_allclose(p[-1], (50.0 * 0.4 / 2.0) ** 2, rtol=1e-5)


def drained(seconds: float, A: float, fy: float = 0.0) -> Array:
    """Samples (K, 2) of y and u: the exact solution of an emptying tank, standing still at the end."""
    t = PERIOD_S * np.arange(round(seconds / PERIOD_S))
    p = np.maximum(100.0 - A / 2 * t, 0.0) ** 2
    return np.column_stack([p + fy, np.zeros_like(p)])


def test_the_one_tank_bank_end_to_end() -> None:
    """Manifest entries, states from the sensor, warm-up; quiet without a fault, and each fault has its own mark."""
    bank = build_bank(TANK)
    [generator] = bank.generators
    assert (generator.name, generator.predicts, generator.inputs) == ("t01.ode", "y", ["y", "u"])
    assert set(generator.faults) == {"fA", "fy"}
    assert generator.states[0].gain == {"y": 1.0}
    assert [channel.unit for channel in bank.inputs] == ["Pa", "1"]
    assert bank.sigma.tolist() == [5.0]
    assert bank.start(np.array([321.0, 5.0])).tolist() == [321.0]

    def residuals(z: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
        generators = Runnable(bank).fresh()
        seen = [generators.step(sample, np.ones(2, dtype=np.bool_)) for sample in z]
        return np.array([s.r[0] for s in seen]), np.array([s.usable[0] for s in seen])

    r, usable = residuals(drained(60.0, A=2.0))
    assert usable.tolist() == [k >= 100 for k in range(300)]
    assert np.abs(r).max() < 60.0  # a first-order method on a fall of 200 Pa/s
    clogged, _ = residuals(drained(60.0, A=1.0))
    assert clogged[100:].min() > 1000.0  # a narrower outlet keeps the pressure up
    trial = bank.simulate([{}, {"fA": -1.0}], drained(60.0, A=1.0), np.array([1e4]))[:, :, 0]
    np.testing.assert_allclose(trial[:, 0], clogged, atol=1e-9)
    assert np.abs(trial[:, 1]).max() < 60.0


def test_a_state_that_nothing_at_hand_can_start_is_refused() -> None:
    """Test 1 predicts y from u alone once the start is a signal it does not use."""
    extra = MODEL.replace("[unknown.p]", '[known.w]\nunit = "Pa"\nmin = 0.0\nmax = 1.0\nnoise = 1.0\n\n[unknown.p]')
    text = extra.format(flow="q - A*sgsqrt(p)", rate="k*u - q", sensor="y - p", enters="A -> A + fA", initial='["w"]')
    with pytest.raises(InputError, match=r"tank: unknown\.p\.initial: no expression uses only y, u \(t01\); add one"):
        build_bank(parse_model(text, "tank.toml"))

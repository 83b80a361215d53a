"""The implicit step against a stiff solver, and the fused graph against the graphs of single tests."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from scipy.integrate import odeint

from faultline.analysis.graph.bank import Bank, build_bank
from faultline.analysis.graph.network import Values
from faultline.analysis.model import load_model
from faultline.service.core.residuals.generators import Graph

PERIOD_S = 0.2  # of the dosing system


Array = npt.NDArray[np.float64]

ATMOSPHERE, SYSTEM = 101325.0, 1.0e6  # Pa
COLUMN = {"y_p_tp": 0, "y_p_ap": 1, "y_p_du": 2, "n_p": 3, "dc_dose": 4}


@pytest.fixture(scope="module")
def bank() -> Bank:
    return build_bank(load_model("uds"))


def rate(test: Values, x: Array, u: Array) -> Array:
    """dx/dt of a test's network, straight from its definition; u = [1; z].

    The root is rounded off below 0.5 Pa, because no solver steps over an infinite slope.
    """
    d = test.alpha[0] @ x + test.beta[0] @ u
    s = d / np.sqrt(np.hypot(d, 1e-3))
    flows: Array = test.C[0] @ ((test.mu[0] @ u) * s) + test.A[0] @ x + test.B[0] @ u
    return flows


def integrated(test: Values, x: Array, u: Array) -> Array:
    """x one tick later, by LSODA."""
    x1: Array = odeint(lambda x, _: rate(test, x, u), x, [0.0, PERIOD_S], rtol=1e-8, atol=0.1, mxstep=20000)[-1]
    return x1


def stiff(test: Values, z: Array, x0: Array) -> Array:
    """The output of a test for samples `z` (K, nz), by a stiff solver with the newest sample held over each tick."""
    x, outputs = x0, []
    for sample in z:
        u = np.concatenate([[1.0], sample])
        x = integrated(test, x, u)
        outputs.append(float((test.H[0] @ x + test.E[0] @ u).item()))
    return np.array(outputs)


def simulated(bank: Bank, z: Array) -> Array:
    """Predictions (K, T) of the fused graph from atmospheric rest or wherever `z` begins."""
    graph, x, out = Graph(bank.graph()), bank.start(z[0])[None], []
    for sample in z:
        _, y_hat, _, x = graph(z=sample[None], x=x)
        out.append(y_hat[0])
    return np.array(out)


def plant(bank: Bank, n_p: Array, dc_dose: Array) -> Array:
    """Noise-free samples (K, nz) of the model's own four states: the widest test is a simulation."""
    row = next(k for k, test in enumerate(bank.tests) if test.name == "t21")
    test = bank.evaluator([{}])[row]
    x, rows = np.full(4, ATMOSPHERE), []
    order = [test.states.index(name) for name in ("p_tp", "p_ap", "p_du")]
    for speed, dose in zip(n_p, dc_dose, strict=True):
        u = np.array([1.0, 0.0, 0.0, 0.0, speed, dose])
        x = integrated(test, x, u)
        rows.append([*x[order], speed, dose])
    return np.array(rows)


def steps(*levels: float, ticks: int = 100) -> Array:
    return np.repeat(levels, ticks)


def pump_off(rng: np.random.Generator) -> tuple[Array, Array]:
    return steps(0.0, 0.0), steps(0.0, 0.0)


def pressure_ladder(rng: np.random.Generator) -> tuple[Array, Array]:
    return steps(15.0, 18.0, 21.0, 18.0), steps(0.0, 0.0, 0.0, 0.0)


def maximum_dose(rng: np.random.Generator) -> tuple[Array, Array]:
    return steps(20.0, 28.0, 28.0), steps(0.0, 1.0, 1.0)


DISTINCT = {"t02", "t06", "t08", "t12", "t20"}
"""Tests of one to four states; the others are numerically the same as one of these."""

SCENARIOS = [pump_off, pressure_ladder, maximum_dose]


@pytest.mark.parametrize("rippled", [False, True], ids=["clean", "rippled"])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_agrees_with_a_stiff_solver_once_the_hose_has_settled(
    bank: Bank, scenario: Callable[[np.random.Generator], tuple[Array, Array]], rippled: bool
) -> None:
    """Whatever the inputs do, settled predictions are within 2 mbar; ripple on a neighbour must not become a bias."""
    rng = np.random.default_rng(1)
    z = plant(bank, *scenario(rng))
    if rippled:
        z[:, :3] += rng.normal(0.0, [400.0, 8e3, 8e3], (len(z), 3))
    predicted = simulated(bank, z)
    settled = np.arange(len(z)) % 100 >= 85
    x0 = bank.start(z[0])
    first = 0
    for row, test in enumerate(bank.evaluator([{}])):
        start = x0[first : first + len(test.states)]
        first += len(test.states)
        if test.test not in DISTINCT:
            continue
        reference = stiff(test, z, start)
        error = (predicted[:, row] - reference)[settled]
        assert abs(error.mean()) < 200.0, (test.test, error.mean())
        assert np.sqrt((error**2).mean()) < (200.0 if not rippled else 1000.0), test.test


@pytest.mark.parametrize("speed", [0.0, 0.02])
def test_stands_still_with_the_pump(bank: Bank, speed: float) -> None:
    """Two wounds: a Rosenbrock step on the root flipped p_tp by 30 mbar each sample; lost digits put it 26 mbar off."""
    z = np.tile([ATMOSPHERE, ATMOSPHERE, ATMOSPHERE, speed, 0.0], (400, 1))
    z[:, :3] += np.random.default_rng(2).normal(0.0, 400.0, (400, 3))
    predicted = simulated(bank, z)[200:]
    jumps = np.abs(np.diff(predicted, axis=0)).max(axis=0)
    measured = np.abs(np.diff(z[200:, :3], axis=0)).max()
    assert (jumps <= 1.5 * measured).all()
    assert (np.abs(predicted.mean(axis=0) - ATMOSPHERE) < 200.0).all()


def test_a_rippled_neighbour_does_not_make_the_prediction_louder_than_the_ripple(bank: Bank) -> None:
    """The wound: a pressure-domain Newton step made test 2 four times as noisy and its filter twice as narrow."""
    z = plant(bank, *maximum_dose(np.random.default_rng(3)))
    quiet = simulated(bank, z)[240:, 0]
    z[::2, 1] += 1e4  # y_p_ap, by more than the filter's own drop, there and back: no change of its mean
    z[1::2, 1] -= 1e4
    loud = simulated(bank, z)[240:, 0]
    assert bank.generators[0].name == "t02.ode"
    assert loud.std() < 1.02e4
    assert abs(loud.mean() - quiet.mean()) < 100.0


@pytest.mark.parametrize("row", range(10))
def test_the_fused_graph_equals_the_graph_of_each_test(bank: Bank, row: int) -> None:
    single = bank.only([row])
    z = plant(bank, *maximum_dose(np.random.default_rng(4)))
    np.testing.assert_allclose(simulated(single, z)[:, 0], simulated(bank, z)[:, row], rtol=0, atol=1e-5)


def test_the_parametric_graph_equals_the_constant_one(bank: Bank) -> None:
    z = plant(bank, *maximum_dose(np.random.default_rng(5)))
    r = bank.simulate([{}, {"fA_du": -0.5 * bank.model.parameters["A_du"].value}], z, bank.start(z[0]))
    measured = z[:, [COLUMN[test.predicts] for test in bank.tests]]
    np.testing.assert_allclose(r[:, 0], measured - simulated(bank, z), rtol=0, atol=1e-5)
    sensitive = ["fA_du" in test.faults for test in bank.tests]
    moved = np.abs(r[-20:, 1] - r[-20:, 0]).mean(axis=0)
    assert (moved[np.logical_not(sensitive)] < 1e-6).all()
    assert moved[0] > 1e4  # a filter of half its area: four times the pressure drop


def test_the_graph_is_reproducible_to_the_byte(bank: Bank) -> None:
    assert bank.graph() == build_bank(load_model("uds")).graph()

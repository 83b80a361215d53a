"""Models with an effect in them as generators: as exact as the nominal ones, and these where there is no effect.

Here are the effects whose equations are not affine in states and signals: openings and capacities that depend on
either, products of states, and what is smooth otherwise.
"""

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import sympy as sp

from faultline.analysis.codegen import computation_sequence, python_source, residual_program
from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.discrepancy.effects.rewrite import rewritten
from faultline.analysis.graph.bank import Bank, bank_of
from faultline.analysis.graph.formula import write_formulas
from faultline.analysis.graph.linear import expanded
from faultline.analysis.graph.writer import Writer
from faultline.analysis.model import Model, load_model, sgsqrt
from faultline.analysis.model.file import SYSTEMS
from faultline.analysis.simulation import Drive, run, system_of
from faultline.analysis.structure import integral_tests
from faultline.service.core.errors import InputError
from faultline.service.core.residuals.generators import Graph

PERIOD_S = 0.2  # of the dosing system


Array = npt.NDArray[np.float64]

LIBRARY = load_library(SYSTEMS / "uds")
UDS4 = load_model("uds")

EFFECTS = [
    "full_open_gain",
    "valve_opens_late",
    "valve_shuts_late",
    "incomplete_filling",
    "nozzle_deposit",
    "dosing_valve_drifts",
    "return_orifice_wears",
    "tank_filter_loads",
    "du_filter_loads",
    "du_filter_cake",
    "entrained_air",
    "stiff_hose",
    "air_before_pump",
    "pump_slip",
    "pump_yields",
    "relief_valve",
    "viscosity_drift",
    "pump_wears",
    "gain_p_ap",
    "laminar_bores",
    "pulsed_filter_flow",
]

SLOWER = {"entrained_air": 9e3, "stiff_hose": 4e2}
"""Errors [Pa] where the hose is softer than the nominal one, and so not settled at the end of a segment."""

TICKS = 100


def changed(name: str, share: float) -> Model:
    """The model with an effect of so many spreads."""
    effect = LIBRARY[name]
    sizes = {p: share * (strength.spread or 0.0) for p, strength in effect.strengths.items()}
    return rewritten(UDS4, effect).with_parameters(sizes, {})


@cache
def bank(name: str) -> Bank:
    return _bank(changed(name, 1.0))


@cache
def nominal() -> Bank:
    return _bank(UDS4)


def _bank(model: Model) -> Bank:
    """The first test, against a measured neighbour, and the widest, which runs freely on the inputs."""
    tests = integral_tests(model)
    return bank_of(model, [tests[0], max(tests, key=lambda test: (-len(test.known), len(test.states)))])


def signals(speeds: tuple[float, ...], doses: tuple[float, ...]) -> Array:
    """Samples (K, nz) in which the measured pressures are those of a free run of the nominal model."""
    z = np.zeros((TICKS * len(speeds), 5))
    z[:, 3], z[:, 4] = np.repeat(speeds, TICKS), np.repeat(doses, TICKS)
    z[:, :3] = free_run(UDS4, z)
    return z


def free_run(model: Model, z: Array) -> Array:
    """The outputs y_p_tp, y_p_ap, y_p_du (K, 3) of a model on the inputs alone, begun as the generators are."""
    system = system_of(model, [])
    at_hand = {sp.Symbol(name): p.value for name, p in model.parameters.items()}
    firsts = [next(e for e in model.unknown[s].initial if e.free_symbols <= at_hand.keys()) for s in system.states]
    start = np.array([float(e.subs(at_hand)) for e in firsts])
    u = np.vstack([z[:1], z])[:, [3, 4]]
    found = run(system, Drive(PERIOD_S, u, start, np.tile(start, (len(u), 1))), {}).outputs()
    return np.column_stack([found[name][1:] for name in ("y_p_tp", "y_p_ap", "y_p_du")])


def predictions(bank: Bank, z: Array) -> Array:
    graph, x, out = Graph(bank.graph()), bank.start(z[0])[None], []
    for sample in z:
        _, y_hat, _, x = graph(z=sample[None], x=x)
        out.append(y_hat[0])
    return np.array(out)


@pytest.fixture(scope="module")
def driven() -> Array:
    """Idle, a small dose, maximum dose, a middle one, and the pump off."""
    return signals((18.0, 21.0, 30.0, 26.0, 0.0), (0.0, 0.03, 1.0, 0.5, 0.0))


@pytest.mark.parametrize("name", EFFECTS)
def test_without_the_effect_the_generators_are_the_nominal_ones(name: str, driven: Array) -> None:
    z = driven[::5]
    bank_at_null = dataclasses.replace(bank(name), model=changed(name, 0.0))
    assert [test.predicts for test in bank_at_null.tests] == [test.predicts for test in nominal().tests]
    np.testing.assert_allclose(predictions(bank_at_null, z), predictions(nominal(), z), rtol=1e-7)


@pytest.mark.parametrize("name", EFFECTS)
def test_the_widest_test_settles_where_a_free_run_does(name: str, driven: Array) -> None:
    column = ["y_p_tp", "y_p_ap", "y_p_du"].index(bank(name).tests[1].predicts)
    error = predictions(bank(name), driven)[:, 1] - free_run(bank(name).model, driven)[:, column]
    settled = np.arange(len(driven)) % TICKS >= 85
    assert np.abs(error[settled]).max() < SLOWER.get(name, 300.0)


@pytest.mark.parametrize("name", ["valve_shuts_late", "entrained_air", "pump_slip"])
def test_trials_and_code_do_what_the_graph_does(name: str, driven: Array) -> None:
    """The parametric graph has the formulas' parameters as inputs; generated code has the formulas as lines."""
    z, [effect] = driven[::5], LIBRARY[name].strengths
    found, null = bank(name), changed(name, 0.0).parameters[effect].value
    r = found.simulate([{}, {effect: null}], z, found.start(z[0]))
    measured = z[:, [["y_p_tp", "y_p_ap", "y_p_du"].index(test.predicts) for test in found.tests]]
    np.testing.assert_allclose(measured - r[:, 0], predictions(found, z), rtol=1e-9)
    np.testing.assert_allclose(measured - r[:, 1], predictions(nominal(), z), rtol=1e-7)
    names = tuple(channel.signal for channel in found.inputs)
    for row, test in enumerate(found.tests):
        program = residual_program(
            found.model, computation_sequence(found.model, test.equations, test.residual), name="a"
        )
        space: dict[str, Any] = {}
        exec(python_source(program), space)  # noqa: S102  (that is what is tested)
        generator = space["A"]()
        columns = [names.index(signal) for signal in generator.INPUTS]
        code = [generator.step(sample) for sample in z[:, columns].tolist()]
        np.testing.assert_allclose(code, r[:, 0, row], rtol=0, atol=1e-2)


def test_a_lag_of_no_time_is_refused_by_its_parameter() -> None:
    """The wound: the graph was written, and all that it gave was NaN."""
    with pytest.raises(InputError, match=r"uds: divides by zero with these parameters \(lag_p_du_tau = 0\); give them"):
        _bank(changed("lag_p_du", 0.0)).graph()


def test_formulas_in_a_graph_are_the_formulas() -> None:
    x, y = sp.symbols("x y")
    formulas = [x**3 - 2 * y / (x + 3), sgsqrt(x - y), abs(x) ** sp.Rational(3, 4), 1 / (y * y + 1), sp.Float(2.5) - x]
    w = Writer()
    z = w.input("z", ["B", 2])
    given = {"x": w.slice(z, 1, 0, 1), "y": w.slice(z, 1, 1, 2)}
    written = w.concat(write_formulas(w, formulas, given), axis=1)
    for name in Graph.OUTPUTS:
        w.output(name, written, ["B", len(formulas)])
    samples = np.array([[2.0, 1.0], [-1.0, 0.5], [0.3, 0.3]])
    meaning = {"sgsqrt": lambda d: np.sign(d) * np.sqrt(np.abs(d))}
    expected = sp.lambdify([x, y], formulas, modules=[meaning, "numpy"])
    for output in Graph(w.model("formulas"))(z=samples):
        np.testing.assert_allclose(output, [expected(*sample) for sample in samples], rtol=1e-14, atol=1e-14)


def test_what_is_above_and_below_a_fraction_bar_cancels_beside_sums_that_stay() -> None:
    """The wound: a sensor's gain g left 0/0 of a pump that stands still."""
    n, p, g = sp.symbols("n p g")
    flow = expanded(n * (1 - p / (n * (1 + g))))
    assert flow.subs(n, 0).subs({p: 2, g: 1}) == -1

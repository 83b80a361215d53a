"""Residuals that differentiate: what they are worth on the golden log beside one that integrates (thesis 2.3, 5.5)."""

import numpy as np
import numpy.typing as npt
import pytest
from generated import golden_samples, run_python

from faultline.analysis.codegen import computation_sequence, residual_program
from faultline.analysis.model import Model, load_model
from faultline.analysis.structure import mtes_sets, structure_of

PERIOD_S = 0.2  # of the dosing system


Array = npt.NDArray[np.float64]


@pytest.fixture(scope="module")
def model() -> Model:
    return load_model("uds")


def residual(
    model: Model, number: int, equation: str, z: Array, filter_s: float = 0.0, period: float = PERIOD_S
) -> Array:
    sequence = computation_sequence(model, mtes_sets(structure_of(model))[number - 1], equation)
    program = residual_program(model, sequence, name="residual", period=period, filter_s=filter_s)
    return run_python(program, golden_samples()[0], z)


def steady(model: Model, p_du: float, dose: float) -> Array:
    """A sample (nz,) of the model at rest in this pressure [Pa], by hand from its equations."""
    v = {name: parameter.value for name, parameter in model.parameters.items()}

    def drop(q: float, area: float) -> float:
        return float(v["rho"] / 2 * (q / (v["C_q"] * area)) ** 2)

    q = v["C_q"] * (v["A_ori"] + dose * v["A_dos"]) * np.sqrt(2 / v["rho"] * (p_du - v["p_tank"]))
    p_tp = v["p_tank"] - drop(q, v["A_t"])
    p_bp, p_ap = p_tp - drop(q, v["A_p"]), p_du + drop(q, v["A_du"])
    n_p = q / v["D_p"] + v["C_v"] * (p_ap - p_bp) / v["eta"]
    return np.array([p_tp, p_ap, p_du, n_p, dose])


def test_every_derivative_residual_is_zero_at_rest(model: Model) -> None:
    """In Pa, m3/s or, where it is the balance of a volume, Pa/s of which 1e8 are 1 mL/s."""
    z = np.tile(steady(model, 1e6, 0.3), (30, 1))
    structure = structure_of(model)
    found = 0
    for number, equations in enumerate(mtes_sets(structure), start=1):
        for equation in equations:
            sequence = computation_sequence(model, equations, equation, form="derivative")
            if sequence.causality != "derivative":
                continue
            found += 1
            program = residual_program(model, sequence, name="residual")
            r = run_python(program, golden_samples()[0], z)
            assert np.isnan(r[0])  # nothing is known of the past
            scale = 1.0 if program.unit != "unit of e01" else 1e-6
            assert abs(r[-1]) < 0.01 * scale, (number, equation, r[-1])
    assert found == 83


def test_a_ramp_is_differentiated_exactly_and_the_low_pass_follows_it(model: Model) -> None:
    z = np.tile(steady(model, 1e6, 0.3), (100, 1))
    slope = 50.0  # Pa a tick, in every pressure: dp_du V_du/B_du is the flow that fills the volume
    z[:, :3] += slope * np.arange(100)[:, None]
    ramp, slow = (residual(model, 2, "e11", z, filter_s) for filter_s in (0.0, 1.0))
    still = residual(model, 2, "e11", np.tile(z[50], (5, 1)))[-1]
    assert ramp[50] - still == pytest.approx(slope / 0.2, rel=1e-6)
    assert slow[99] == pytest.approx(ramp[99], rel=1e-6)


@pytest.mark.parametrize("filter_s", [0.5, 2.0])
def test_the_low_pass_answers_a_step_of_the_slope_as_its_time_constant_says(model: Model, filter_s: float) -> None:
    """The derivative of the only differentiated pressure steps: what the low-pass lacks decays as exp(-t/filter_s)."""
    period, slope = 0.01, 1000.0  # s, Pa/s
    t = period * np.arange(-100, 500)
    z = np.tile(steady(model, 1e6, 0.3), (len(t), 1))
    z[:, :3] += slope * np.maximum(t, 0.0)[:, None]
    raw, slow = (residual(model, 2, "e11", z, lag, period) for lag in (0.0, filter_s))
    lacking = (raw - slow)[101:]
    assert lacking == pytest.approx(slope * np.exp(-t[101:] / filter_s), abs=0.02 * slope)


def spread_and_shift(r: Array) -> tuple[float, float]:
    """Standard deviation of a residual on the golden log before the fault, and how far its mean moves with it."""
    t = 0.2 * np.arange(len(r))
    before, after = (t > 25) & (t < 70), t >= 78
    return float(r[before].std()), float(r[after].mean() - r[before].mean())


def test_test_6_shows_the_fault_four_times_clearer_integrated_than_differentiated(model: Model) -> None:
    """The same equations and faults; the inverse of a filter's root and a difference quotient amplify the noise."""
    _, z = golden_samples()
    clearness = {}
    for equation in ("e18", "e09"):
        spread, shift = spread_and_shift(residual(model, 6, equation, z))
        clearness[equation] = abs(shift) / spread
    assert clearness["e18"] == pytest.approx(10.3, rel=0.1)
    assert clearness["e09"] == pytest.approx(2.3, rel=0.1)


def test_differentiating_three_pressures_is_noisier_than_integrating_one_and_a_low_pass_helps(model: Model) -> None:
    """Test 1 differentiates all three pressures to predict p_du, test 2 integrates it: both in Pa, both see fA_du."""
    _, z = golden_samples()
    choices = {"integral": (2, 0.0), "derivative": (1, 0.0), "smoothed": (1, 2.0)}
    found = {name: spread_and_shift(residual(model, k, "e16", z, lag)) for name, (k, lag) in choices.items()}
    assert 1.03 < found["derivative"][0] / found["integral"][0] < 1.2
    assert found["integral"][0] < found["smoothed"][0] < found["derivative"][0]
    for spread, shift in found.values():
        assert shift == pytest.approx(-3.1e4, rel=0.02)  # Pa
        assert abs(shift) > 8 * spread

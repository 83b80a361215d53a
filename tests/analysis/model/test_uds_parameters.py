"""The shipped model: its parameters give the pressure drops and flows that their sources state."""

import pytest
import sympy as sp

from faultline.analysis.model import load_model
from faultline.analysis.model.file import shipped_models

UDS4 = load_model("uds")
VALUES = {name: p.value for name, p in UDS4.parameters.items()}


def solved(equation: str, variable: str, **given: float) -> float:
    expression = UDS4.expression(equation, with_fault=False).subs({**VALUES, **given})
    (solution,) = sp.solve(expression, sp.Symbol(variable))
    return float(solution)


@pytest.mark.parametrize(
    ("equation", "flow", "given", "expected"),
    [
        ("e05", "q_filt_t", {"p_tp": 101325 - 2000}, 3.2e-6),
        ("e06", "q_filt_p", {"p_tp": 1e5, "p_bp": 1e5 - 4000}, 3.2e-6),
        ("e07", "q_filt_du", {"p_ap": 1e6, "p_du": 1e6 - 6000}, 3.2e-6),
        ("e07", "q_filt_du", {"p_ap": 1e6 - 6000, "p_du": 1e6}, -3.2e-6),
        ("e03", "q_ori", {"p_du": 101325 + 9e5}, 2.0e-6),
        ("e04", "q_dos", {"p_du": 101325 + 9e5, "dc_dose": 1.0}, 1.2e-6),
        ("e04", "q_dos", {"p_du": 101325 + 9e5, "dc_dose": 0.0}, 0.0),
        ("e01", "q_pump", {"n_p": 25.0, "eta_volp": 0.95}, 0.95 * 2.5e-6),
    ],
)
def test_a_flow_is_what_the_source_states(equation: str, flow: str, given: dict[str, float], expected: float) -> None:
    assert solved(equation, flow, **given) == pytest.approx(expected, rel=1e-3)


def test_five_percent_leak_at_10_bar() -> None:
    assert solved("e02", "eta_volp", p_ap=1.1e6, p_bp=1e5, n_p=25.0) == pytest.approx(0.95)


def test_the_hose_takes_a_third_of_a_millilitre_a_bar() -> None:
    assert VALUES["V_ap"] / VALUES["B_ap"] == pytest.approx(3.5e-12, rel=1e-3)


def test_a_lost_area_and_a_weak_pump_lower_the_flow() -> None:
    for equation, flow, fault in (("e05", "q_filt_t", "fA_t"), ("e01", "q_pump", "fq_pump")):
        for size in UDS4.faults[fault].sizes:
            faulty = UDS4.expression(equation, with_fault=True)
            given = {
                **VALUES,
                "p_tp": 99e3,
                "n_p": 25.0,
                "eta_volp": 0.95,
                fault: UDS4.faults[fault].absolute(size, UDS4),
            }
            (value,) = sp.solve(faulty.subs(given), sp.Symbol(flow))
            assert 0 < value < solved(equation, flow, p_tp=99e3, n_p=25.0, eta_volp=0.95)


@pytest.mark.parametrize("name", list(shipped_models()))
def test_a_shipped_model_bears_the_name_of_its_place_and_describes_itself(name: str) -> None:
    model = load_model(name)
    assert model.name == name.replace("-", "_").replace("/", "_")
    assert model.description
    assert model.source
    assert all(parameter.source for parameter in model.parameters.values())

"""The sentence says where in the operating space an equation was changed, and by how much."""

import re

import numpy as np
import pytest
from made_runs import Missing, dosing, tanks, weights

from faultline.analysis.discrepancy.find.disturbed import disturbed_runs
from faultline.analysis.discrepancy.find.features import Operation
from faultline.analysis.discrepancy.find.latent import Misfit
from faultline.analysis.discrepancy.find.operating_space import Finding, finding_of
from faultline.analysis.discrepancy.find.quantities import quantities
from faultline.analysis.model import load_model

UDS4, TANKS = load_model("uds"), load_model("three-tank")


def told(equation: str, missing: Missing, seed: int = 1) -> Finding:
    problem = dosing(UDS4, {equation: missing}, seed)
    x = np.zeros(problem.unknowns.size)
    operation = Operation(disturbed_runs(problem, x))
    return finding_of(operation, Misfit(problem, x, weights(problem, x)), equation)


@pytest.mark.parametrize(
    ("equation", "missing", "amount", "sd", "words"),
    [
        ("e04", lambda v: 0.17 * v["q_dos"] * (v["dc_dose"] > 0.98), 17.0, 1.0, r"% of q_dos only at maximum dc_dose"),
        ("e04", lambda v: 5e-8 * (v["dc_dose"] > 0) * (v["dc_dose"] < 1), 0.05, 0.005, "mL/s only at partial dc_dose"),
        ("e07", lambda v: -0.3 * v["q_filt_du"] * v["t"] / v["t"][-1], -30.0, 8.0, "% of q_filt_du growing with time"),
        (
            "e10",
            lambda v: 0.3 * v["dp_ap"] * (v["p_ap"] - v["p_ap"].mean()) / np.ptp(v["p_ap"]),
            30.0,
            5.0,
            "% of dp_ap",
        ),
    ],
)
def test_the_feature_is_named_with_its_coefficient(
    equation: str, missing: Missing, amount: float, sd: float, words: str
) -> None:
    found = told(equation, missing)
    sentence = found.sentence(UDS4.equations[equation].description)
    assert re.search(words, sentence), sentence
    said = re.search(r"\): ([+-][\d.e-]+)(?: %)? \+- ([\d.e-]+)", sentence)
    assert said is not None
    assert float(said[1]) == pytest.approx(amount, abs=sd)
    assert float(said[2]) < sd


def test_a_sensors_lag_follows_the_rate_of_its_pressure() -> None:
    """In bar at the fastest rise: minus the time constant times that rate."""
    sentence = told("e16", lambda v: -0.3 * v["dp_du"]).sentence("sensor")
    assert "with the rate of pressure in the dosing unit (p_du), at its fastest rise" in sentence
    assert sentence.startswith("sensor (e16): -0.")


def test_every_quantity_of_a_model_is_known_along_a_run() -> None:
    problem = tanks(TANKS, {}, 1)
    [trajectory] = problem.trajectories(np.zeros(problem.unknowns.size))
    values = quantities(trajectory)
    assert values.keys() >= set(TANKS.unknown)
    balance = 2e-3 * values["dh1"] - (values["q0"] - values["q12"])
    assert np.median(np.abs(balance)) < 1e-3 * values["q0"].max()

"""Ambient pressure as a known signal of a model, in place of parameters: residuals do not depend on the altitude."""

import re

import numpy as np
import pytest

from faultline.analysis.graph.bank import build_bank
from faultline.analysis.graph.runnable import Runnable
from faultline.analysis.model import load_model
from faultline.analysis.model.file import SYSTEMS, parse_model

BAROMETER = """[known.p_amb]
unit = "Pa"
description = "barometric pressure"
min = 50e3
max = 110e3
noise = 250.0

"""
LEVELS = {"y_p_tp": 98e3, "y_p_ap": 1.1e6, "y_p_du": 1.08e6, "n_p": 22.0, "dc_dose": 0.4, "p_amb": 101325.0}
HIGHER = -25e3  # Pa, some 2300 m


def with_barometer() -> str:
    """The urea system's model with a signal in place of the pressures of tank and nozzle."""
    text = (SYSTEMS / "uds" / "model.toml").read_text()
    text = re.sub(r"\[parameter\.p_(tank|exh)\]\n(?:.+\n)+\n", "", text)
    text = re.sub(r"\bp_(tank|exh)\b", "p_amb", text)
    return text.replace("[unknown.q_pump]", BAROMETER + "[unknown.q_pump]", 1)


def residuals(text: str | None, shift: float) -> dict[str, float]:
    """Those of a steady point, with all absolute pressures shifted [Pa]."""
    model = load_model("uds") if text is None else parse_model(text, "test", SYSTEMS / "uds" / "system.toml")
    bank = build_bank(model)
    generators = Runnable(bank).fresh()
    z = np.array([LEVELS[i.signal] + (shift if i.unit == "Pa" else 0.0) for i in bank.inputs])
    for _ in range(500):
        found = generators.step(z, np.ones(len(z), dtype=np.bool_))
    return dict(zip([each.name for each in bank.generators], found.r.tolist(), strict=True))


def test_a_barometer_makes_residuals_independent_of_the_altitude() -> None:
    low, high = residuals(with_barometer(), 0.0), residuals(with_barometer(), HIGHER)
    assert len(low) > 5
    assert high == pytest.approx(low, abs=1.0)
    fixed = residuals(None, 0.0), residuals(None, HIGHER)
    assert max(abs(fixed[1][name] - value) for name, value in fixed[0].items()) > 10e3

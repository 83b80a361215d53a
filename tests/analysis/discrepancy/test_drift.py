"""Parameters that a missing effect has bent are named when they come back, with the values that a fit gave them."""

import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest

from faultline.analysis.calibration.problem import unknowns_of
from faultline.analysis.discrepancy.add.drift import Drifts, drifts
from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.discrepancy.effects.rewrite import rewritten
from faultline.analysis.discrepancy.name.attempt import Attempt
from faultline.analysis.model import Model, load_model
from faultline.analysis.model.file import SYSTEMS
from faultline.analysis.simulation import system_of

UDS4 = load_model("uds")
SHIFTED = dataclasses.replace(
    UDS4,
    parameters={
        **UDS4.parameters,
        "C_v": dataclasses.replace(UDS4.parameters["C_v"], value=2e-9, prior=0.5),
        "h": dataclasses.replace(
            UDS4.parameters["C_v"], unit="Pa", description="spring", value=0.0, prior=None, spread=200.0, min=None
        ),
    },
)


def attempt(model: Model, at: Mapping[str, float]) -> Attempt:
    """One that has found the parameters so many standard deviations of their priors from the model's values."""
    unknowns = unknowns_of(system_of(model, model.calibrated), (), 1, ())
    x = np.zeros(unknowns.size)
    for name, distance in at.items():
        x[unknowns.parameters.index(name)] = distance
    return Attempt(
        effects=("made",),
        unknowns=unknowns,
        x=x,
        curvature=np.eye(len(x)),
        inside=np.ones(len(x), bool),
        cost=0.0,
        promised=0.0,
        training=0.0,
        predicted=0.0,
        blocks=np.zeros(1),
        dispersion=1.0,
    )


def found(without: Mapping[str, float], with_it: Mapping[str, float]) -> Drifts:
    after = rewritten(SHIFTED, load_library(SYSTEMS / "uds")["full_open_gain"])
    return drifts(SHIFTED, attempt(SHIFTED, without), attempt(after, with_it))


def test_what_comes_back_is_said_first_and_with_its_values() -> None:
    d = found(
        {"C_v": np.log(2.4) / 0.5, "h": 2.0, "A_dos": 0.1},
        {"C_v": np.log(1.05) / 0.5, "h": 0.5, "A_dos": 1.1, "full_open_gain_g": 0.9},
    )
    assert [drift.name for drift in d.back] == ["C_v", "h"]
    assert [drift.name for drift in d.away] == ["A_dos"]
    assert d.sentences()[1:3] == [
        "C_v (laminar leakage of the pump): 2.4x the datasheet without the effect, 1.05x with it: moved back towards "
        "the datasheet",
        "h (spring): 400 Pa without the effect, 100 Pa with it; the datasheet says 0 Pa: moved back towards the "
        "datasheet",
    ]
    assert d.sentences()[3].endswith("with it: moved away from the datasheet")
    assert len(d.sentences()) == 4


def test_distances_are_signed_and_in_the_priors_deviations() -> None:
    d = found({"C_v": -1.5, "h": 1.0}, {"C_v": 0.25, "h": -1.0})
    by_name = {drift.name: drift for drift in d.parameters}
    assert [by_name["C_v"].before, by_name["C_v"].after] == pytest.approx([-1.5, 0.25])
    assert by_name["C_v"].without == pytest.approx(2e-9 * np.exp(-0.75))
    assert by_name["h"].nearer == pytest.approx(0.0)
    assert [drift.name for drift in d.back] == ["C_v"]
    n = len(SHIFTED.calibrated)
    assert [*d.distances] == pytest.approx([np.sqrt((1.5**2 + 1.0) / n), np.sqrt((0.25**2 + 1.0) / n)])


def test_the_effects_own_parameters_have_no_datasheet() -> None:
    d = found({}, {"full_open_gain_g": 2.0})
    assert [drift.name for drift in d.parameters] == SHIFTED.calibrated
    assert d.sentences() == [
        f"the {len(SHIFTED.calibrated)} parameters are 0 standard deviations of their priors from the datasheet "
        "without the effect, 0 with it (root mean square)"
    ]


def test_the_datasheet_is_the_model_that_is_given_not_the_one_that_was_fitted() -> None:
    """A model that was calibrated before can be compared with its datasheet."""
    calibrated = SHIFTED.with_parameters({"C_v": 4e-9}, {})
    d = drifts(SHIFTED, attempt(calibrated, {}), attempt(calibrated, {"C_v": -np.log(2.0) / 0.5}))
    [back] = d.back
    assert [back.before, back.after] == pytest.approx([np.log(2.0) / 0.5, 0.0], abs=1e-9)
    assert back.sentence == "C_v (laminar leakage of the pump): 2x the datasheet without the effect, 1x with it"

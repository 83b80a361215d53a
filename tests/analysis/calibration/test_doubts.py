"""A fit that is good gives no doubt; each thing that is wrong gives its own."""

import dataclasses

import numpy as np
import pytest
from made_drive import calibrated

from faultline.analysis.calibration.doubts import doubts
from faultline.analysis.calibration.fit import Fit
from faultline.analysis.calibration.sections import Section
from faultline.analysis.calibration.validate import Agreement, Validation
from faultline.analysis.model import load_model
from faultline.analysis.simulation import Drive, Trajectory, system_of
from faultline.service.core.time_scale import TimeScale


@pytest.fixture(scope="module")
def good() -> Fit:
    return calibrated("uds/production", 0).fit


def off_by(rms: float, mode: str, normalised: float | None = None) -> dict[str, Validation]:
    found = Agreement(100, rms, 0.0, 1000.0, 1500.0, rms / 1500.0 if normalised is None else normalised, 120.0)
    return {"rec": Validation((), (), {"y_p_du": {mode: found}})}


def test_a_good_fit_raises_none(good: Fit) -> None:
    assert list(doubts(good, off_by(2900.0, "idle"))) == []
    assert list(doubts(good, off_by(9e4, "edge"))) == []  # when a step came is not known


def test_a_free_run_that_is_far_off_is_told(good: Fit) -> None:
    assert list(doubts(good, off_by(3100.0, "idle"))) == [
        "rec: the free run of y_p_du is off by 3100 Pa in mode idle; sample by sample that is 2.1 times what is "
        "expected, most from 120 to 140 s of the log: leave that out if something happened there, else let `faultline "
        "discover` look for what the model lacks"
    ]


def test_each_sample_is_judged_by_what_is_expected_of_it(good: Fit) -> None:
    """The wound: a few jumps made the expected mean square so large that anything passed between them."""
    assert list(doubts(good, off_by(1500.0, "idle", normalised=2.1))) != []
    assert list(doubts(good, off_by(9000.0, "idle", normalised=1.9))) == []


def test_what_the_fit_had_to_assume_is_told(good: Fit) -> None:
    x = good.x.copy()
    x[0], x[len(good.unknowns.parameters)] = -3.5, 4.0  # the first parameter, the first sensor's zero
    odd = dataclasses.replace(good, x=x, starts=(4, 1), at_bound=("A_p",))
    sensor = next(iter(good.unknowns.zeros))
    name = good.unknowns.parameters[0]
    told = list(doubts(odd, {}))
    assert told[0].startswith(f"the zero error of {sensor} is ")
    assert told[1:] == [
        f"{name} is 3.5 standard deviations of its prior away from the model file's value",
        "A_p has run into its bound",
        "only 1 of 4 searches came to the same place",
    ]


def test_a_pressure_below_nothing_is_told_with_its_time() -> None:
    model = load_model("uds")
    system = system_of(model, model.varying)
    w = np.full((3, len(system.variables)), 1e5)
    w[1, [str(v) for v in system.variables].index("p_bp")] = -2e4
    drive = Drive(0.1, np.zeros((3, 2)), w[0, :4], w[:, :4])
    section = Section(0, 100.0, drive, np.zeros((3, 2)), {}, {}, TimeScale(0.2, 8.0))
    bent = Validation((section,), (Trajectory(system, drive, {}, w),), {})
    fit = calibrated("uds/production", 0).fit
    assert list(doubts(fit, {"rec": bent})) == [
        "rec: at 100 s p_bp would be -2e+04 Pa, and nothing below 0 Pa is physical; give the parameters that make it "
        "tighter priors"
    ]

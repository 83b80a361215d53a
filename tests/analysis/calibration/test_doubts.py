"""A fit that is good gives no doubt; each thing that is wrong gives its own."""

import dataclasses

import pytest
from made_drive import calibrated

from faultline.analysis.calibration.doubts import doubts
from faultline.analysis.calibration.fit import Fit
from faultline.analysis.calibration.validate import Agreement, Validation


@pytest.fixture(scope="module")
def good() -> Fit:
    return calibrated("uds/production", 0).fit


def off_by(rms: float, mode: str, normalised: float | None = None) -> dict[str, Validation]:
    found = Agreement(100, rms, 0.0, 1000.0, 1500.0, rms / 1500.0 if normalised is None else normalised)
    return {"rec": Validation((), (), {"y_p_du": {mode: found}})}


def test_a_good_fit_raises_none(good: Fit) -> None:
    assert list(doubts(good, off_by(2900.0, "idle"))) == []
    assert list(doubts(good, off_by(9e4, "edge"))) == []  # when a step came is not known


def test_a_free_run_that_is_far_off_is_told(good: Fit) -> None:
    assert list(doubts(good, off_by(3100.0, "idle"))) == [
        "rec: the free run of y_p_du is off by 3100 Pa in mode idle; sample by sample that is 2.1 times what is "
        "expected"
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

"""The calibration's report in numbers that say something, whatever the unit and however short a mode."""

import math

import pytest

from faultline.analysis.calibration.report import _number, _times_floor
from faultline.analysis.calibration.validate import Agreement


def agreement(rms: float, floor: float) -> Agreement:
    return Agreement(
        samples=10, rms=rms, bias=0.0, floor=floor, expected=floor, normalised=rms / floor if floor else math.nan
    )


@pytest.mark.parametrize(
    ("value", "text"), [(0.0123456, "0.0123"), (3.21, "3.21"), (99.96, "100"), (1234.4, "1234"), (0.0, "0")]
)
def test_an_error_of_volts_is_no_zero(value: float, text: str) -> None:
    assert _number(value) == text


@pytest.mark.parametrize(("floor", "text"), [(2.0, "1.50x"), (math.nan, ""), (0.0, "")])
def test_a_mode_that_is_too_short_for_a_floor_has_no_ratio(floor: float, text: str) -> None:
    assert _times_floor(agreement(3.0, floor)) == text

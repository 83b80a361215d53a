"""A few of the campaign over plants of other structures: nothing is claimed in sound ones, an effect is named."""

from pathlib import Path

import pytest
from families import tried
from families_page import page

from faultline.testbench.families.development import DEVELOPMENT


@pytest.mark.parametrize(("family", "number"), [("slow", 1), ("changing", 1)])
def test_nothing_is_claimed_and_the_model_is_accepted(family: str, number: int, tmp_path: Path) -> None:
    found = tried((family, number, {}), tmp_path)
    assert found["verdict"] == "nothing missing", found
    assert found["calibrate"]["doubts"] == []
    within = [abs(error) <= 1.5 * half for error, half, told in found["calibrate"]["errors"].values() if told]
    assert all(within), found["calibrate"]["errors"]
    text = page([found], "0", 1.0, [*DEVELOPMENT])
    assert f"| {family} | 1 | 0 | 0 | 0 | 0 |" in text
    assert "Something claimed: 0 of 1" in text


def test_what_is_hidden_in_one_is_named(tmp_path: Path) -> None:
    found = tried(("stepped", 1, {"full_open": 0.1}), tmp_path)
    assert found["verdict"] == "named", found
    assert found["sets"] == [["full_open_gain"]]

"""The ladder's cases are possible, and its page counts what the records say."""

from typing import Any

import pytest
from by_vehicle import set_of
from ladder import SIZES, VEHICLES, page, rungs

from faultline.testbench.faults import limit


def test_every_component_has_its_sizes_from_a_drive_its_start_and_a_growing_one() -> None:
    cases = [rung for number in VEHICLES for rung in rungs(number, set_of(number))]
    assert len(cases) == len({case.name for case in cases}) == 7 * len(SIZES) * len(VEHICLES) >= 500
    for case in cases:
        [(fault, size)] = case.faults
        assert 0 < abs(size) <= limit(fault)
        [asked] = case.request.faults
        assert (asked.profile == "growing") == case.label.endswith("growing")
        assert (asked.onset_s < 10.0) == case.label.endswith("start")


def record(fault: str, size: float, label: str, said: list[list[Any]]) -> dict[str, Any]:
    """A vehicle with one case, which is told of at 150 s, 30 s after the onset."""
    told = {
        "case": "x",
        "kind": "single",
        "label": label,
        "faults": {fault: size},
        "onset_s": 120.0,
        "seconds": 480.0,
        "cannot_tell": 0.0,
        "alarms": [],
        "events": [[150.0, 20.0, "occurred", said]] if said else [],
    }
    return {"vehicle": 501, "refused": None, "judged": [told], "wall_s": 60.0, "commit": "abc"}


@pytest.mark.parametrize(
    ("said", "excluded", "first"),
    [
        ([["fA_t", 1, 0.9, []]], 0, 1),
        ([["fy_p_tp", 1, 0.9, []], ["fA_t", 2, 0.1, []]], 0, 0),
        ([["fA_t+fq_pump", 1, None, []]], 0, 0),
        ([["fA_p", 1, 0.9, []]], 1, 0),
        ([["unknown", 1, None, ["e05"]]], 1, 0),
    ],
)
def test_the_truth_is_in_where_any_explanation_has_it_and_first_alone(
    said: list[list[Any]], excluded: int, first: int
) -> None:
    made = page([record("fA_t", 0.9, "4", said)])
    assert f"| excluded two minutes later | <= 1 % | {excluded} of 1," in made
    assert f"| of rank 1 then | >= 98 % | {first} of 1," in made
    assert f"| abc | 501 | {excluded} of 1," in made
    assert ("- truck-501 fA_t 0.9 (4): " in made) == bool(excluded)


def test_a_leak_is_right_near_its_equation_and_what_is_not_detected_is_listed() -> None:
    made = page([record("leak_ap", 1.8, "4", [["unknown", 1, None, ["e10"]]])])
    assert "| of rank 1 then | >= 98 % | 1 of 1," in made
    made = page([record("fA_ori", 0.05, "1", [])])
    assert "- truck-501 fA_ori 0.05 (1): not detected" in made
    assert "| fA_ori | 0 of 1 | - |" in made


@pytest.mark.parametrize(("size", "held"), [([-91.0, -89.0, "%"], 1), ([-89.0, -85.0, "%"], 0)])
def test_an_interval_of_the_true_component_holds_its_size_or_not(size: list[Any], held: int) -> None:
    made = page([record("fA_t", 0.9, "4", [["fA_p", 1, 0.5, [], [[0.0, 1.0, "%"]]], ["fA_t", 1, 0.5, [], [size]]])])
    assert f"| the 95 % interval of the size holds it, abrupt | 90 to 98 % | {held} of 1," in made
    assert "| the same, growing | 90 to 98 % | none |" in made

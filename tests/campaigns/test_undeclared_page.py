"""The undeclared faults' cases are possible, and their page counts what the records say."""

from typing import Any

import pytest
from undeclared import SIZES, VEHICLES, cases, page

from faultline.testbench.faults import limit


def test_every_fault_has_two_sizes_or_the_one_there_is() -> None:
    made = [case for number in VEHICLES for case in cases(number)]
    assert len(made) == len({case.name for case in made}) == (2 * len(SIZES) - 1) * len(VEHICLES)
    assert all(0 < size <= limit(fault) for case in made for fault, size in case.faults)
    assert len(SIZES) >= 10


def record(fault: str, said: list[list[Any]]) -> dict[str, Any]:
    """A vehicle with one case, which is told of at 150 s, 30 s after the onset."""
    told = {
        "case": "x",
        "kind": "single",
        "label": "severe",
        "faults": {fault: SIZES[fault][1]},
        "onset_s": 120.0,
        "seconds": 480.0,
        "cannot_tell": 0.0,
        "alarms": [],
        "events": [[150.0, 20.0, "occurred", said]] if said else [],
    }
    return {"vehicle": 601, "refused": None, "judged": [told], "wall_s": 60.0, "commit": "abc"}


@pytest.mark.parametrize(
    ("said", "unknown", "wrong"),
    [
        ([["unknown", 1, None, ["e05"]]], 1, 0),
        ([["fA_t", 1, 0.9, []], ["unknown", 2, 0.1, ["e10"]]], 1, 1),
        ([["fA_t", 1, None, []], ["unknown", 1, None, []]], 1, 0),
        ([["fA_t", 1, 0.5, []], ["fA_p", 1, 0.5, []]], 0, 0),
        ([["fA_t+fq_pump", 1, None, []]], 0, 1),
    ],
)
def test_unknown_is_right_and_one_component_alone_is_wrong(said: list[list[Any]], unknown: int, wrong: int) -> None:
    made = page([record("return_worn", said)])
    assert f"| unknown is among the explanations | >= 90 % | {unknown} of 1," in made
    assert f"| one wrong component, without these three | <= 2 % | {wrong} of 1," in made


def test_what_nothing_tells_apart_is_left_out_in_a_row_of_its_own() -> None:
    made = page([record("air_tp", [["fq_pump", 1, 0.9, []]]), record("fluid", [["unknown", 1, None, []]])])
    assert "| one wrong component | <= 2 % | 1 of 2," in made
    assert "| one wrong component, without these three | <= 2 % | 0 of 1," in made


def test_what_is_not_detected_is_not_named() -> None:
    assert "| return_worn | - | 0 of 1; 0, 0 of 0;  |" in page([record("return_worn", [])])

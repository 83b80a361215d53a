"""The campaign's cases, and its page of records as the campaign writes them."""

from typing import Any

import pytest
from hybrid import FREE, LARGE, SEVERE, cases
from hybrid_page import METHODS, allowed, page, sensitive


def row(method: str, label: str, faults: dict[str, float], said: list[Any], alarmed: list[str]) -> dict[str, Any]:
    """A recording of 480 s with the fault from 120 s on, told of at 130 s; a false suspicion at 50 s."""
    events = [[50.0, 0.0, "suspected", []], [130.0, 9.0, "occurred", said]]
    common = {"case": "c", "kind": "single", "seconds": 480.0, "exciting_s": 100.0, "cannot_tell": 0.0, "alarms": []}
    told = {"onset_s": 120.0, "label": label, "faults": faults, "events": events, "changes": True}
    return {**common, **told, "method": method, "alarmed": alarmed}


def test_every_fault_is_there_in_both_sizes() -> None:
    made = [*cases(901, "A")]
    assert {(c.faults[0][0], c.label) for c in made if c.faults} == {
        (fault, label) for fault in SEVERE for label in ("large", "severe")
    }
    assert len({c.seed for c in made}) == len(made) == 2 * len(SEVERE) + FREE
    assert {*LARGE} == {*SEVERE}


def test_what_the_alarms_allow() -> None:
    signature = sensitive()
    assert allowed(["t08"], signature) > allowed(["t08", "t21"], signature) >= 1
    assert allowed([], signature) == 0
    assert all("leak_ap" in signature[test] for test in ("t06", "t12"))
    assert "leak_ap" not in signature["t02"]


def test_the_page_counts_what_is_in_the_set_and_what_alarms_wrongly() -> None:
    right = [["fA_t", 1, 0.5, [], []], ["fy_p_tp", 1, 0.4, [], []]]
    near = [["unknown", 1, 0.9, ["e10"], []]]
    records = [
        {
            "vehicle": 901,
            "refused": None,
            "commit": "abc",
            "wall_s": 60.0,
            "doubted": True,
            "costs": {method: [300.0, 90, 1800.0] for method in METHODS},
            "judged": [
                row(method, label, faults, said, alarmed)
                for method in METHODS
                for label in ("large", "severe")
                for faults, said, alarmed in (
                    ({"fA_t": 0.3}, right, ["t08", "t02"]),
                    ({"leak_ap": 0.5}, near, ["t06"]),
                )
            ],
        }
    ]
    told = page(records)
    assert told.count("| 2 of 2, 100.0 % (15.8 to 100.0 %)") == 16  # detected and in the set, two sizes, four methods
    assert "| CPU time to the bundle [s] | 300 | 300 | 300 | 300 |" in told
    assert "4 cases; detected, and the truth in the set: equations 4; networks alone 4; both 4." in told
    assert "| 1 vehicles in doubt: names of rank 1, mean | 1.50 |" in told
    assert "| large: names of rank 1, mean | 1.50 |" in told
    decoupled = [line for line in told.splitlines() if line.startswith("| severe: tests that decouple")]
    assert decoupled[0].split("|")[2].strip().startswith("1 of ")
    assert "| false suspicions | 4 in 0.1 h, 30 (" in told
    assert "| fA_t, large | 1 of 1, 1; 2.0 |" in told


@pytest.mark.parametrize("look", ["nothing", "another"])
def test_a_wrong_name_is_not_in_the_set(look: str) -> None:
    said = [] if look == "nothing" else [["fA_du", 1, 0.5, [], []]]
    judged = [row(method, "large", {"fA_t": 0.3}, said, []) for method in METHODS]
    record: dict[str, Any] = {
        "vehicle": 901,
        "refused": None,
        "commit": "abc",
        "wall_s": 1.0,
        "doubted": False,
        "costs": {},
    }
    told = page([{**record, "judged": judged}])
    [line] = [line for line in told.splitlines() if line.startswith("| fA_t, large")]
    assert line.split("|")[2].strip() == ("0 of 1" if look == "nothing" else "1 of 1, 0; 1.0")

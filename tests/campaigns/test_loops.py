"""The page of `loops` counts what is named, alone or in a pair, and what was false before an onset."""

from typing import Any

import pytest
from loops import _Drive, _drives, _read, page
from pump_loop import SIZES


def event(t_s: float, transition: str, *first: list[str]) -> dict[str, Any]:
    diagnoses = [{"faults": faults, "rank": 1} for faults in first]
    return {"t_s": t_s, "transition": transition, "diagnoses": diagnoses}


def test_every_fault_is_there_in_both_sizes() -> None:
    drives = [*_drives()]
    assert {drive.name for drive in drives if drive.fault} == {f"{f}-{s}" for f in SIZES for s in ("large", "severe")}
    assert sum(not drive.fault for drive in drives) == 2


def test_what_is_read_two_minutes_after_the_first_diagnosis() -> None:
    drive = _Drive("f_pump-large", "f_pump", 0.1, 900)
    later = event(600.0, "refined", ["f_motor"])
    events = [event(50.0, "suspected"), event(430.0, "occurred", ["f_pump"], ["f_y_q", "f_y_p"]), later]
    told = _read(events, drive)
    assert told == {
        "delay_s": pytest.approx(30.0),
        "first": [["f_pump"], ["f_y_q", "f_y_p"]],
        "false": 0,
        "suspected": 1,
        "free_s": 400.0,
    }
    records = [{"judged": [{**drive._asdict(), **told}], "commit": "abc", "wall_s": 60.0}]
    assert "| all, large | 1 of 1, 100.0 % (2.5 to 100.0 %) | 30 s | 1 of 1, 100.0 % (2.5 to 100.0 %) | 3.00 |" in page(
        records
    )
    assert "False suspicions: 1 in 0.1 h" in page(records)

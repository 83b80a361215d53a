"""The table of effort: counted in the objects themselves, and every part of the source is there."""

import json
from pathlib import Path

from effort import PARTS, RESULTS, adapted, counted, lines, page

from faultline.analysis.model import load_model
from faultline.training.recipe import DEFAULT


def test_what_is_counted_is_what_is_there() -> None:
    count = counted(load_model("uds"))
    assert (count.tests, count.equations) == (10, 8)
    assert count.networks == DEFAULT.members * count.of_a_member
    assert count.of_a_member > 100 * count.equations
    assert count.network_states >= count.equation_states > 0


def test_every_part_has_lines_and_lines_are_not_empty_ones(tmp_path: Path) -> None:
    for parts in PARTS.values():
        for places in parts.values():
            assert all(Path(place).exists() for place in places), places
            assert lines(places) > 20, places
    (tmp_path / "a.py").write_text('"""Docstring."""\n\n\nx = 1  # comment\n   \n')
    assert lines([str(tmp_path)]) == lines([str(tmp_path / "a.py")]) == 2


def test_the_page_says_both() -> None:
    records = [json.loads(line) for line in (RESULTS / "grey-box.jsonl").read_text().splitlines()]
    count = counted(load_model("uds"))
    said = page(records, count, 12.3)
    assert "| CPU time | 12 s | 65 s (12 trainings, median) |" in said
    assert f"| learnt numbers, 10 tests | 8 | {count.networks}: 5 members of {count.of_a_member} |" in said
    assert "| **networks** | |" in said
    assert "| adapted to another vehicle | - | 120 s made 4 of 10 tests worse, in the one trial measured |" in said


def test_what_a_short_recording_made_worse_is_counted() -> None:
    errors = {"as they are": {"t02": 1.0, "t06": 2.0, "t08": 3.0}, "adapted": {"t02": 1.5, "t06": 2.0, "t08": 2.0}}
    assert adapted({"seconds": 90.0, "errors": errors}).startswith("90 s made 1 of 3 tests worse")

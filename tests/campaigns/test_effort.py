"""The table of effort: counted in the objects themselves, and every part of the source is there."""

import json
from pathlib import Path

from effort import PARTS, RESULTS, counted, lines, page

from analysis.model import load_model
from training.recipe import DEFAULT


def test_what_is_counted_is_what_is_there() -> None:
    count = counted(load_model("uds4"))
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
    count = counted(load_model("uds4"))
    said = page(records, count, 12.3)
    assert "| CPU time | 12 s | 65 s (12 trainings, median) |" in said
    assert f"| learnt numbers, 10 tests | 8 | {count.networks}: 5 members of {count.of_a_member} |" in said
    assert "| **networks** | |" in said

"""A fixed sample of the discrepancy campaign: what is hidden is named, what no entry describes is not."""

from dataclasses import replace

import pytest
from discrepancy import run, tried
from discrepancy_cases import Case, sample
from discrepancy_page import MARKS, named_right, rows, where, wrong

DURATION_S = 300.0

MOST = 3
"""Names of an effect, in recordings that are shorter than the campaign's: clogging has three forms that look alike."""


@pytest.mark.parametrize("case", sample(), ids=lambda case: case.name)
def test_a_case_of_the_campaign(case: Case) -> None:
    result = run(case, DURATION_S, further=False)
    told = f"{case}: {result['verdict']} {result['sets']}, {result['singles']}"
    if case.kind == "nothing":
        assert result["verdict"] == "nothing missing", told
    elif case.kind == "outside":
        assert result["verdict"] == "unnamed", told
    else:
        # a filter's laminar part looks like a tank's pressure of another day: of two effects, one may be lost
        assert named_right(result) or (case.kind == "two" and result["sets"]), told
        assert not wrong(result), told
        assert all(len(names) <= MOST for names in result["sets"]), told  # a set of everything has the truth in it too
    if case.kind == "outside":
        assert {*result["members"]} & where(result), told


def test_an_error_is_no_right_answer() -> None:
    """Nothing named because nothing ran is not silence where nothing is hidden."""
    [broken] = [tried(replace(case, vehicle="no such")) for case in sample() if case.kind == "outside"][:1]
    counted = rows([broken, {**broken, "kind": "nothing"}])
    error = "any: ended with an error, no verdict"
    assert (counted[error], MARKS[error]) == ((2, 2), "none")
    assert counted["in no library: not given a name"] == (0, 1)
    assert counted["in no library: noticed"] == (0, 1)

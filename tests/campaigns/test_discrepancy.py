"""A fixed sample of the discrepancy campaign: what is hidden is named, what no entry describes is not."""

import pytest
from discrepancy import run
from discrepancy_cases import Case, sample
from discrepancy_page import named_right, where, wrong

DURATION_S = 300.0


@pytest.mark.parametrize("case", sample(), ids=lambda case: case.name)
def test_a_case_of_the_campaign(case: Case) -> None:
    result = run(case, DURATION_S, further=False)
    told = f"{case}: {result['verdict']} {result['sets']}, {result['singles']}"
    if case.kind == "nothing":
        assert result["verdict"] == "nothing missing", told
    elif case.kind == "outside":
        assert result["verdict"] == "unnamed", told
    else:
        assert named_right(result), told
        assert not wrong(result), told
    if case.kind == "outside":
        assert {*result["members"]} & where(result), told

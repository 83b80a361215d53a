"""docs/workshop.md says what the code does."""

import re
from pathlib import Path

import pytest

from faultline.service.core.time_scale import TimeScale
from faultline.service.workshop.command import CODES
from faultline.service.workshop.plan import HOLD, PATIENCE, QUIET, STOOD, VISITS
from faultline.service.workshop.result import SCHEMA, Result
from faultline.service.workshop.verdict import ENDS, Verdict

TIME = TimeScale(0.2, 20.0)
"""Of the dosing system."""

PAGE = Path(__file__).resolve().parents[3] / "docs" / "workshop.md"


@pytest.fixture(scope="module")
def page() -> str:
    if not PAGE.exists():
        pytest.fail(f"{PAGE} is not there")
    return PAGE.read_text()


def test_every_exit_code(page: str) -> None:
    told = {int(code) for code in re.findall(r"^\| (\d+) \|", page, flags=re.MULTILINE)}
    assert told == {*CODES.values(), 130}


def test_every_field_verdict_and_end(page: str) -> None:
    fields = {*Result.__struct_fields__, *Verdict.__struct_fields__}
    told = {*re.findall(r"`([\w-]+)`", page)}
    assert fields - told == set()
    assert {*CODES, *ENDS, "idle", "partial", "maximum"} - told == set()
    assert SCHEMA in page


def test_the_times(page: str) -> None:
    for span in (HOLD, PATIENCE, QUIET, STOOD):
        assert f"{TIME.seconds(span):.0f} s" in page
    assert VISITS == 2
    assert "twice" in page

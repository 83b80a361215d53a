"""docs/events.md says what the code does."""

import re
from pathlib import Path
from typing import get_args

import msgspec

from faultline.service.core.records.event import SCHEMA, Diagnosis, Event, Transition
from faultline.service.core.records.fault import CLEARED, Change, Fault
from faultline.service.core.records.fault import SCHEMA as FAULT
from faultline.service.core.records.freeze_frame import SCHEMA as FRAME
from faultline.service.core.records.freeze_frame import Excerpt, FreezeFrame, Input, Verdict
from faultline.service.core.records.health import CLEARED_S, MEANINGS, RAISED_S
from faultline.service.core.records.health import SCHEMA as HEALTH
from faultline.service.outputs.socket import RING
from faultline.service.store.file import KEPT

PAGE = (Path(__file__).parents[3] / "docs" / "events.md").read_text()


def _rows(section: str) -> list[str]:
    """First cells of the tables under a heading, without backquotes."""
    text = PAGE.partition(f"## {section}\n")[2].partition("\n## ")[0]
    return re.findall(r"^\| `(\w+)` \|", text, re.MULTILINE)


def test_names_every_field_in_order() -> None:
    fields = [field.name for struct in (Event, Diagnosis) for field in msgspec.structs.fields(struct)]
    assert _rows("Fields") == fields


def test_names_every_transition() -> None:
    assert _rows("Transitions") == list(get_args(Transition))


def test_names_the_schema_and_the_ring() -> None:
    assert f"Schema `{SCHEMA}`" in PAGE
    assert f"the latest {RING} records" in PAGE
    for kept in KEPT.values():
        assert f"{kept:,}" in PAGE


def test_names_every_field_and_change_of_a_fault() -> None:
    rows = _rows("Faults")
    fields = [field.name for field in msgspec.structs.fields(Fault)]
    assert rows[-len(get_args(Change)) :] == list(get_args(Change))
    assert [row for row in rows if row in fields] == fields
    assert f"`{FAULT}`" in PAGE
    assert f"`{CLEARED}`" in PAGE


def test_names_every_field_of_a_freeze_frame() -> None:
    text = PAGE.partition("## Freeze frames\n")[2].partition("\n## ")[0]
    for struct in (FreezeFrame, Input, Verdict, Excerpt):
        for field in msgspec.structs.fields(struct):
            assert f"`{field.name}`" in text, field.name
    assert f"`{FRAME}`" in text


def test_names_every_condition() -> None:
    text = PAGE.partition("## Health\n")[2]
    assert re.findall(r"^\| `([\w-]+)` \| \w+ \|", text.partition("| kind |")[2], re.MULTILINE) == list(MEANINGS)
    assert f"`{HEALTH}`" in text
    assert f"has lasted {RAISED_S:.0f} s and is gone once it was away for {CLEARED_S:.0f} s" in text

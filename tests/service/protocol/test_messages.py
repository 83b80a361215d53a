"""One struct a message, from which pages and schemas are made; each is read whatever a newer service says besides."""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import msgspec
import pytest

from faultline.service.core.records.event import Event, decode
from faultline.service.core.records.health import Standing, meaning
from faultline.service.protocol import document
from faultline.service.protocol.client import decode as answer
from faultline.service.protocol.document import MESSAGES, PAGES, SENT
from faultline.service.protocol.errors import Code, GarbledError, RefusedError
from faultline.service.protocol.live import LiveTick
from faultline.service.protocol.records import RecordError, part_of, read

ROOT = Path(__file__).resolve().parents[3]
GOLDEN = ROOT / "tests" / "golden" / "events.jsonl"
DEFINE = ("core", "protocol")


@pytest.mark.parametrize("name", PAGES)
def test_the_tables_of_the_pages_are_those_of_the_messages(name: str) -> None:
    page = (ROOT / "docs" / name).read_text()
    assert document.documented(page) == page, "run python -m faultline.service.protocol.document docs"


def test_every_message_has_a_table_and_every_field_a_meaning() -> None:
    pages = "".join((ROOT / "docs" / name).read_text() for name in PAGES)
    in_words = {"Subscription", "Rejection", "ErrorAnswer"}  # of one field each
    assert [each.__name__ for each in MESSAGES if f"<!-- fields {each.__name__} -->" not in pages] == [
        each.__name__ for each in MESSAGES if each.__name__ in in_words
    ]
    assert document.undocumented() == []


def test_a_table_changes_with_its_message() -> None:
    page = "a\n<!-- fields Dtc -->\nold\n<!-- end -->\nb\n"
    assert document.documented(page).splitlines()[3:] == [
        "|---|---|---|",
        "| `spn` | integer | suspect parameter number |",
        "| `fmi` | integer | failure mode identifier |",
        "<!-- end -->",
        "b",
    ]
    with pytest.raises(KeyError):
        document.documented("<!-- fields Nothing -->\n<!-- end -->")


@pytest.mark.parametrize("name", SENT)
def test_the_schemas_are_those_of_the_messages(name: str) -> None:
    assert document.file_of(name).read_bytes() == document.schema(name), "run python -m ...protocol.document docs"


def test_no_schema_is_left_of_a_message_that_is_gone() -> None:
    assert {*document.SCHEMAS.iterdir()} == {document.file_of(name) for name in SENT}


def test_the_schema_of_events_names_what_events_have() -> None:
    schema = msgspec.json.decode(document.schema("faultline.event/1"), type=dict[str, Any])
    for line in GOLDEN.read_bytes().splitlines():
        event = msgspec.json.decode(line, type=dict[str, Any])
        assert [*event] == [*schema["properties"]]
        assert {*schema["required"]} <= {*event}
        assert event["schema"] == schema["properties"]["schema"]["const"]
        assert event["transition"] in schema["properties"]["transition"]["enum"]


def test_the_page_names_every_code() -> None:
    table = (ROOT / "docs" / "control.md").read_text().partition("| code | when |\n|---|---|\n")[2].partition("\n\n")[0]
    assert [row.split("`")[1] for row in table.splitlines()] == list(get_args(Code))


def structs() -> Iterator[tuple[Path, str, set[str]]]:
    """Structs of the service outside of those packages that define what is sent: file, name, fields."""
    for path in sorted((ROOT / "service").rglob("*.py")):
        if path.relative_to(ROOT / "service").parts[0] in DEFINE:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef) and any("Struct" in ast.unparse(base) for base in node.bases):
                fields = {each.target.id for each in node.body if _is_field(each)}  # type: ignore[attr-defined]
                yield path, node.name, fields


def _is_field(node: ast.stmt) -> bool:
    return isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name)


def test_no_message_is_declared_twice() -> None:
    """A struct elsewhere with no field but some of a message's would be read from, or written to, a socket as that."""
    fields = {each.__name__: {*each.__struct_fields__} for each in MESSAGES}
    found = [*structs()]
    assert len(found) > 10
    assert [
        (path.name, name, message)
        for path, name, own in found
        for message, all_of_it in fields.items()
        if len(own) > 1 and own <= all_of_it
    ] == [("verdict.py", "Candidate", "Diagnosis")]  # with what its faults mean; the workshop prints it
    names = [each.__name__ for each in MESSAGES]
    assert len(names) == len({*names})


def test_what_a_newer_service_says_besides_is_ignored() -> None:
    line = GOLDEN.read_bytes().splitlines()[0]
    assert decode(line[:-1] + b',"later":{"more":1}}') == decode(line)
    assert decode(line).schema == "faultline.event/1"
    tick: dict[str, object] = {name: [] for name in ("z", "quality", "y_hat", "r", "sigma", "sums", "usable")}
    tick |= {"system": "uds", "bundle": "ab", "tick": 1, "t_s": 0.2, "mode": "idle", "alarm": [], "cannot_tell": []}
    tick |= {"suspected": False, "anomaly": True, "diagnoses": [], "later": [1]}
    assert answer(msgspec.json.encode(tick), LiveTick).anomaly
    of_tomorrow = answer(b'{"kind":"of-tomorrow","of":"can0"}', Standing)
    assert (meaning(of_tomorrow.kind), of_tomorrow.since) == ("of-tomorrow", None)


def test_a_tick_of_before_is_of_another_version() -> None:
    with pytest.raises(GarbledError, match=r"^s: answers as another version of faultline: .*; use the `faultline` of"):
        answer(b'{"schema":"faultline.live/1","suspected":true}', LiveTick, "s")


def test_a_refusal_with_a_code_of_tomorrow_is_one() -> None:
    with pytest.raises(RefusedError, match="no reason") as refused:
        answer(b'{"error":{"code":"of-tomorrow","message":"no reason","more":1}}', dict)
    assert refused.value.code == "of-tomorrow"


def test_a_record_keeps_its_line_and_gives_its_parts_as_they_came() -> None:
    record = read(b'{"schema":"faultline.fault/1","id":"a-1","seq":1,"fault":{"number": 3,  "p":0.10}}\n', epoch=2)
    assert (record.kind, record.vehicle, record.epoch, record.wall) == ("fault", "a", 2, None)
    assert bytes(record.parts["fault"]) == b'{"number": 3,  "p":0.10}'
    assert part_of(record.parts, "seq", int) == 1
    with pytest.raises(RecordError, match="has no field `change`"):
        part_of(record.parts, "change", str)
    with pytest.raises(RecordError, match="`fault`: Expected `str`"):
        part_of(record.parts, "fault", str)


def test_an_event_is_written_as_the_golden_ones_are() -> None:
    for line in GOLDEN.read_bytes().splitlines():
        assert msgspec.json.encode(msgspec.json.decode(line, type=Event)) == line

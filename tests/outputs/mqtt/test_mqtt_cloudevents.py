"""The SDK of those who wrote the specification takes what we publish for CloudEvents."""

import datetime
import json
import re
from pathlib import Path

import pytest
from cloudevents.core.base import BaseCloudEvent
from cloudevents.core.formats.json import JSONFormat
from cloudevents.core.v1.event import CloudEvent
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as some

from faultline.service.core.records.event import SCHEMA, Diagnosis, Event
from faultline.service.core.records.health import SCHEMA as HEALTH
from faultline.service.core.records.health import Health, Standing
from faultline.service.core.records.line import encode
from faultline.service.mqtt.cloudevent import CONTENT_TYPE, structured
from faultline.service.protocol.records import RecordError, read

GOLDEN = Path(__file__).parents[2] / "golden" / "events.jsonl"

URI_REFERENCE = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:[A-Za-z0-9._~!$&'()*+,;=:@/?#-]+")
"""RFC 3986, of those with a scheme: enough for ours."""

EVENT = Event(
    schema=SCHEMA,
    id="truck-17-5e0c72b1-17",
    seq=17,
    tick=1050,
    t_s=210.0,
    wall="2026-03-01T10:00:00.250Z",
    transition="occurred",
    diagnoses=[Diagnosis(faults=["fA_du"], rank=1, p=0.912), Diagnosis(faults=[], rank=2, p=None, near=["e7"])],
    alarm=["t02", "t08"],
    cannot_tell=[],
    since_tick=1005,
    bundle="ab" * 32,
)


def taken(line: bytes, vehicle: str = "truck-17") -> BaseCloudEvent:
    """What the SDK makes of it; it raises where that is none."""
    return JSONFormat().read(CloudEvent, structured(read(line), vehicle))


def test_an_event_is_one() -> None:
    event = taken(encode(EVENT))
    assert event.get_id() == EVENT.id
    assert event.get_source() == "urn:faultline:truck-17"
    assert event.get_type() == "io.faultline.event.occurred"
    assert event.get_specversion() == "1.0"
    assert event.get_datacontenttype() == "application/json"
    assert event.get_subject() == EVENT.bundle
    assert event.get_time() == datetime.datetime(2026, 3, 1, 10, 0, 0, 250_000, tzinfo=datetime.UTC)
    assert event.get_extension("sequence") == "00000000000000000017"
    assert event.get_data() == json.loads(encode(EVENT))


def test_health_is_one() -> None:
    standing = Standing(kind="missing", of="p_du", since="2026-03-01T10:00:00Z")
    health = Health(schema=HEALTH, id="truck-17-5e0c72b1-18", seq=18, wall=None, conditions=[standing])
    assert taken(encode(health)).get_type() == "io.faultline.health"
    assert "time" not in json.loads(structured(read(encode(health)), "truck-17"))  # the SDK would make one up


@pytest.mark.parametrize("number", range(1, len(GOLDEN.read_bytes().splitlines()) + 1))
def test_every_event_of_the_golden_log_is_one(number: int) -> None:
    line = GOLDEN.read_bytes().splitlines()[number - 1]
    event = taken(line)
    assert event.get_data() == json.loads(line)
    assert event.get_type().startswith("io.faultline.event.")


def test_their_order_is_that_of_the_characters_of_the_sequence() -> None:
    numbers = [1, 9, 10, 99, 100, 12345, 2**62]
    sequences = [json.loads(structured(read(b'{"id":"a-%d","seq":%d}' % (n, n)), "a"))["sequence"] for n in numbers]
    assert sequences == sorted(sequences)


@pytest.mark.parametrize("vehicle", ["truck-17", "A", "x" * 80, "a.b_c-d", "0"])
def test_the_source_is_a_uri_reference_whatever_the_vehicle_is_called(vehicle: str) -> None:
    assert URI_REFERENCE.fullmatch(taken(encode(EVENT), vehicle).get_source())


def test_the_content_type_is_that_of_structured_mode() -> None:
    """CloudEvents MQTT binding 1.0.2, 3: `application/cloudevents` and the format."""
    assert CONTENT_TYPE == "application/cloudevents+json"


words = some.text(max_size=20)
anything = some.recursive(
    some.none() | some.booleans() | some.integers() | some.floats(allow_nan=False, allow_infinity=False) | words,
    lambda inner: some.lists(inner, max_size=3) | some.dictionaries(words, inner, max_size=3),
    max_leaves=5,
)
records = some.fixed_dictionaries(
    {"id": words, "seq": some.integers(-1, 2**64)},
    optional={
        "schema": some.sampled_from(["faultline.event/1", "faultline.fault/1", "faultline.cleared/1", "x"]) | words,
        **dict.fromkeys(("wall", "transition", "change", "fault", "numbers", "bundle", "system", "other"), anything),
    },
)


@settings(suppress_health_check=[HealthCheck.too_slow])  # which measures how busy the machine is
@given(records)
def test_whatever_is_taken_for_a_record_makes_a_cloud_event(record: dict[str, object]) -> None:
    line = json.dumps(record).encode()
    try:
        read(line)
    except RecordError:
        return
    event = taken(line)
    assert event.get_id() == record["id"]
    assert event.get_data() == record
    assert re.fullmatch(r"io\.faultline\.[a-z0-9_.-]+", event.get_type())


@given(some.binary(max_size=60) | records.map(lambda one: json.dumps(one).encode()[:-1]))
def test_what_is_no_json_is_no_record(line: bytes) -> None:
    try:
        read(line)
    except RecordError:
        return
    json.loads(line)

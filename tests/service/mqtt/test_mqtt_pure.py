"""Topics, answers, names, back-off, throttled messages: what is decided without a broker."""

import json

import pytest

from faultline.service.mqtt import puback_policy
from faultline.service.mqtt.cloudevent import structured
from faultline.service.mqtt.naming import Naming
from faultline.service.mqtt.puback_policy import PATIENCE_S, PubackPolicy, Verdict, name_of
from faultline.service.mqtt.throttled import SAID, SAID_S, Said
from faultline.service.mqtt.topics import LEVEL, TopicError, Topics, level, levels
from faultline.service.protocol.backoff import Backoff
from faultline.service.protocol.records import RecordError, read

BAD_NAMES = ["a/b", "+", "#", "a+b", "a#", "a\0b", "a\nb", "", "../x", "$SYS", "Lkw-ü", "a b", "-a", "\ud800", "\x7f"]


@pytest.mark.parametrize("name", BAD_NAMES)
def test_a_name_that_means_something_in_a_topic_is_refused(name: str) -> None:
    with pytest.raises(TopicError, match=r"^vehicle '.*' cannot be part of a topic: letters, digits"):
        level(name, "vehicle")
    with pytest.raises(TopicError, match="cannot be part of a topic"):
        Topics("faultline", name)


@pytest.mark.parametrize("prefix", [*BAD_NAMES[1:], "/a", "a/", "a//b", "a/+/b", "a/#"])
def test_a_prefix_is_of_such_names(prefix: str) -> None:
    with pytest.raises(TopicError, match="cannot be part of a topic"):
        levels(prefix)


def test_a_name_that_is_too_long_is_refused_in_a_short_line() -> None:
    assert level("a" * LEVEL, "vehicle") == "a" * LEVEL
    with pytest.raises(TopicError, match="is longer than 80 characters") as caught:
        level("a" * 100_000, "vehicle")
    assert len(str(caught.value)) < 300
    with pytest.raises(TopicError, match="is longer than 200 characters"):
        levels("/".join(["abc"] * 60))


def test_topics_are_the_vehicles() -> None:
    topics = Topics("fleet/north", "truck-17")
    assert topics.events == "fleet/north/truck-17/events"
    assert topics.health == "fleet/north/truck-17/health"
    assert topics.number(topics.fault(12)) == 12


@pytest.mark.parametrize("tail", ["0", "-1", "01", "1/2", "x", "", "1" * 11, "١"])
def test_what_is_no_number_of_a_fault_is_left_alone(tail: str) -> None:
    topics = Topics("faultline", "truck-17")
    assert topics.number(f"faultline/truck-17/faults/{tail}") is None
    assert topics.number("faultline/truck-18/faults/1") is None


@pytest.mark.parametrize(
    ("code", "verdict"),
    [
        *((0x00, "taken"), (0x10, "taken")),
        *((0x90, "given up"), (0x95, "given up"), (0x99, "given up")),
        *((0x80, "again"), (0x83, "again"), (0x87, "again"), (0x91, "again"), (0x97, "again"), (0xFF, "again")),
    ],
)
def test_every_reason_code_has_its_verdict(code: int, verdict: Verdict) -> None:
    assert PubackPolicy().judge(code, 0.0) == verdict


def test_a_refusal_is_borne_for_a_while_then_each_is_given_up_until_one_is_taken() -> None:
    judge = PubackPolicy()
    assert judge.judge(0x87, 100.0) == "again"
    refusing = [judge.refusing]
    assert judge.judge(0x87, 99.0 + PATIENCE_S) == "again"
    assert judge.judge(0x87, 100.0 + PATIENCE_S) == "given up"
    assert judge.judge(0x97, 101.0 + PATIENCE_S) == "given up"
    assert judge.judge(0x00, 102.0 + PATIENCE_S) == "taken"
    refusing.append(judge.refusing)
    assert refusing == [True, False]
    assert judge.judge(0x87, 103.0 + PATIENCE_S) == "again"


def test_what_is_about_one_message_says_nothing_about_the_next() -> None:
    judge = PubackPolicy()
    assert judge.judge(0x99, 0.0) == "given up"
    assert not judge.refusing
    assert judge.judge(0x87, PATIENCE_S) == "again"


def test_every_code_has_a_name() -> None:
    assert name_of(0x87) == "not authorized"
    assert name_of(0xC3) == "reason code 0xc3"
    assert not {*puback_policy.OF_THE_MESSAGE} & {*puback_policy.OF_THE_MOMENT}


def test_the_configured_name_stays_whoever_answers() -> None:
    naming = Naming("truck-1", "truck-2")
    naming.answered("truck-3")
    naming.answered("a/b")
    assert naming.name == "truck-1"


def test_the_daemons_name_counts_before_what_was_kept_and_before_records() -> None:
    naming = Naming(None, "truck-2")
    assert naming.name == "truck-2"
    naming.seen("truck-4")
    assert naming.name == "truck-2"
    naming.answered("truck-3")
    assert naming.name == "truck-3"


def test_a_record_names_the_vehicle_where_nobody_else_does() -> None:
    naming = Naming(None, None)
    naming.seen("truck-4")
    assert naming.name == "truck-4"


def test_a_name_that_the_daemon_must_not_have_is_none_and_no_record_gives_another() -> None:
    naming = Naming(None, "truck-2")
    with pytest.raises(TopicError, match=r"the daemon's name \(`source`\) 'a/#' cannot be part of a topic"):
        naming.answered("a/#")
    naming.seen("truck-4")
    assert naming.name is None


def test_a_name_that_was_kept_and_is_not_taken_any_more_is_forgotten() -> None:
    assert Naming(None, "a/b").name is None


@pytest.mark.parametrize(
    ("identifier", "vehicle"),
    [("truck-17-5e0c72b1-3", "truck-17"), ("log-7", "log"), ("a-b-1", "a-b"), ("7", None), ("truck", None)],
)
def test_a_records_id_begins_with_the_vehicle(identifier: str, vehicle: str | None) -> None:
    assert read(json.dumps({"id": identifier, "seq": 1}).encode()).vehicle == vehicle


def test_tries_come_after_twice_the_time_each_and_by_chance_sooner() -> None:
    late, soon = Backoff(1.0, 60.0, lambda: 0.0), Backoff(1.0, 60.0, lambda: 1.0)
    assert [late.failed(100.0) - 100.0 for _ in range(8)] == [1, 2, 4, 8, 16, 32, 60, 60]
    assert [soon.failed(100.0) - 100.0 for _ in range(8)] == [0.5, 1, 2, 4, 8, 16, 30, 30]
    late.well()
    assert late.failed(0.0) == 1.0


def test_two_vehicles_do_not_come_back_at_once() -> None:
    assert len({Backoff(1.0, 60.0).failed(0.0) for _ in range(10)}) > 1


def test_the_same_is_said_once_a_minute_and_how_often_it_was() -> None:
    now, said = [0.0], list[str]()
    say = Said(said.append, lambda: now[0])
    for t in (0.0, 1.0, SAID_S - 0.1):
        now[0] = t
        say("refused")
    say("wrong password")
    assert said == ["refused", "wrong password"]
    now[0] = SAID_S
    say("refused")
    assert said[2:] == ["refused (2 times more since the last time)"]


def test_what_is_about_the_same_is_said_once_whatever_is_in_it() -> None:
    said = list[str]()
    say = Said(said.append, lambda: 0.0)
    for number in range(1000):
        say(f"record {number} is refused", "refused")
    assert said == ["record 0 is refused"]


def test_what_was_said_is_not_remembered_for_ever() -> None:
    say = Said(lambda _: None, lambda: 0.0)
    for number in range(10 * SAID):
        say(f"{number}")
    assert len(say._last) == SAID


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"{}",
        b"[]",
        b"null",
        b'{"error":"too many clients"}',
        b'{"id":"","seq":1}',
        b'{"id":"a","seq":0}',
        b'{"id":"a","seq":1.5}',
        b'{"id":"a","seq":9223372036854775808}',
        b'{"id":7,"seq":1}',
        b'{"id":"a","seq":1',
        b'{"id":"a","seq":1,"x":"\xff"}',
        b'{"id":"a","seq":1,"x":' + b"[" * 100_000 + b"]" * 100_000 + b"}",
    ],
)
def test_what_is_no_record_is_refused(line: bytes) -> None:
    with pytest.raises(RecordError):
        read(line)


@pytest.mark.parametrize(
    ("fields", "kind", "subject"),
    [
        (
            {"schema": "faultline.event/1", "transition": "occurred", "bundle": "b0"},
            "io.faultline.event.occurred",
            "b0",
        ),
        (
            {"schema": "faultline.event/1", "transition": "healed", "system": "uds"},
            "io.faultline.event.healed",
            "uds",
        ),
        ({"schema": "faultline.event/1", "transition": "A b/c"}, "io.faultline.event", None),
        ({"schema": "faultline.health/1", "conditions": []}, "io.faultline.health", None),
        (
            {"schema": "faultline.fault/1", "change": "confirmed", "fault": {"number": 3}},
            "io.faultline.fault.confirmed",
            "3",
        ),
        ({"schema": "faultline.cleared/1", "numbers": [4]}, "io.faultline.cleared", "4"),
        ({"schema": "faultline.cleared/1", "numbers": [4, 5]}, "io.faultline.cleared", None),
        ({"schema": "faultline.fault/2", "change": "x"}, "io.faultline.fault.v2", None),
        ({"schema": "faultline.weather/1"}, "io.faultline.weather.v1", None),
        ({"schema": "somebody's own"}, "io.faultline.record", None),
        ({}, "io.faultline.record", None),
    ],
)
def test_a_record_is_of_a_type_and_about_something(fields: dict[str, object], kind: str, subject: str | None) -> None:
    record = read(json.dumps({"id": "truck-1", "seq": 7, **fields}).encode())
    event = json.loads(structured(record, "truck"))
    assert (event["type"], event.get("subject")) == (kind, subject)
    assert event["data"] == {"id": "truck-1", "seq": 7, **fields}
    assert event["sequence"] == "00000000000000000007"


@pytest.mark.parametrize("wall", [None, 7, "", "yesterday", "2026-03-01T10:00:00", "2026-03-01"])
def test_a_time_that_is_none_is_left_out(wall: object) -> None:
    record = read(json.dumps({"id": "truck-1", "seq": 7, "wall": wall}).encode())
    assert "time" not in json.loads(structured(record, "truck"))


def test_numbers_in_a_record_stay_as_they_were_written() -> None:
    line = b'{"id":"truck-1","seq":7,"p":0.120,"big":12345678901234567890123,"t":1e-7}'
    assert b'"data":' + line in structured(read(line), "truck")

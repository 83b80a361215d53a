"""What is retained: right again after whatever was missed, and never set back by what is old."""

import json
from typing import Any

import msgspec
import pytest

from faultline.service.mqtt.states import FOUND, FaultStates
from faultline.service.mqtt.topics import Topics
from faultline.service.mqtt.vehicle_health import VehicleHealth
from faultline.service.protocol.records import Record, RecordError, read

TOPICS = Topics("faultline", "truck-17")


def told(number: int, seq: int, change: str = "confirmed", epoch: int = 1) -> Record:
    fault = {"number": number, "seq": seq}
    return made(seq, epoch, schema="faultline.fault/1", change=change, fault=fault)


def cleared(*numbers: int, seq: int) -> Record:
    return made(seq, 1, schema="faultline.cleared/1", numbers=list(numbers))


def made(seq: int, epoch: int = 1, **fields: Any) -> Record:
    return read(json.dumps({"id": f"truck-17-{seq}", "seq": seq, **fields}).encode(), epoch)


def published(states: FaultStates, record: Record) -> dict[str, bytes]:
    publications = states.after(record, TOPICS)
    assert all(one.retain and one.content_type == "application/json" for one in publications)
    return {one.topic.removeprefix("faultline/truck-17/faults/"): one.payload for one in publications}


def test_a_fault_that_is_told_is_retained_as_it_is() -> None:
    states = FaultStates()
    assert published(states, told(3, 10)) == {"3": b'{"number": 3, "seq": 10}'}
    assert states.there == {3}


@pytest.mark.parametrize("change", ["aged", "displaced"])
def test_a_fault_that_is_not_remembered_any_more_is_erased(change: str) -> None:
    states = FaultStates([3])
    assert published(states, told(3, 10, change)) == {"3": b""}
    assert states.there == set()


@pytest.mark.parametrize("change", ["pending", "failed", "refined", "withdrawn", "passed", "settled"])
def test_a_fault_that_passed_or_settled_is_still_remembered(change: str) -> None:
    assert published(FaultStates(), told(3, 10, change))["3"] != b""


def test_faults_that_a_person_cleared_are_erased() -> None:
    states = FaultStates([3, 4, 5])
    assert published(states, cleared(3, 4, 9, seq=11)) == {"3": b"", "4": b""}
    assert states.there == {5}


def test_other_records_change_no_fault() -> None:
    assert published(FaultStates(), made(1, schema="faultline.event/1", transition="healed")) == {}


@pytest.mark.parametrize(
    "fields",
    [
        {"schema": "faultline.fault/1"},
        {"schema": "faultline.fault/1", "change": "failed", "fault": {"number": "../3"}},
        {"schema": "faultline.fault/1", "change": "failed", "fault": {"number": 0}},
        {"schema": "faultline.fault/1", "change": "failed", "fault": [3]},
        {"schema": "faultline.cleared/1", "numbers": ["#"]},
    ],
)
def test_a_record_that_is_not_as_its_schema_says_is_an_error(fields: dict[str, Any]) -> None:
    with pytest.raises(RecordError):
        FaultStates().after(made(1, **fields), TOPICS)


def test_with_each_connection_what_is_remembered_is_published_and_the_rest_erased() -> None:
    states = FaultStates([1, 2])
    found = states.remembered({2: b"two", 7: b"seven"}, epoch=1, seq=100, topics=TOPICS)
    assert [(one.topic.rpartition("/")[2], one.payload) for one in found] == [
        ("1", b""),
        ("2", b"two"),
        ("7", b"seven"),
    ]
    assert states.there == {2, 7}


def test_what_the_answer_contains_already_changes_nothing() -> None:
    """The broker was away for a day: records of yesterday must not bring back what has aged since."""
    states = FaultStates()
    states.remembered({2: b"two"}, epoch=1, seq=100, topics=TOPICS)
    assert published(states, told(1, 50)) == {}
    assert published(states, told(2, 100, "aged")) == {}
    assert published(states, told(2, 101, "aged")) == {"2": b""}


def test_records_of_another_run_of_the_daemon_are_older_than_its_answer() -> None:
    """Its store was lost, its numbers begin anew: 500 comes from before, 5 from after."""
    states = FaultStates()
    states.remembered({}, epoch=2, seq=5, topics=TOPICS)
    assert published(states, told(1, 500, epoch=1)) == {}
    assert published(states, told(1, 5, epoch=2)) == {}
    assert list(published(states, told(1, 6, epoch=2))) == ["1"]


def test_a_stale_state_is_erased_when_the_broker_shows_it() -> None:
    states = FaultStates()
    states.remembered({2: b"two"}, epoch=1, seq=1, topics=TOPICS)
    assert states.found(2, TOPICS) == []
    [erased] = states.found(9, TOPICS)
    assert (erased.topic, erased.payload, erased.retain) == ("faultline/truck-17/faults/9", b"", True)


def test_what_the_broker_shows_first_waits_for_the_daemons_answer() -> None:
    states = FaultStates()
    states.connected()
    assert states.found(9, TOPICS) == states.found(2, TOPICS) == []
    found = states.remembered({2: b"two"}, epoch=1, seq=1, topics=TOPICS)
    assert [(one.topic.rpartition("/")[2], one.payload) for one in found] == [("9", b""), ("2", b"two")]


def test_a_new_connection_forgets_what_another_broker_showed() -> None:
    states = FaultStates()
    states.remembered({}, epoch=1, seq=1, topics=TOPICS)
    states.connected()
    assert states.found(9, TOPICS) == []
    states.connected()
    assert states.remembered({}, epoch=1, seq=1, topics=TOPICS) == []


def test_a_broker_that_shows_ever_more_fills_no_memory() -> None:
    states = FaultStates()
    for number in range(1, 10 * FOUND):
        states.found(number, TOPICS)
    assert len(states.remembered({}, epoch=1, seq=1, topics=TOPICS)) == FOUND


def status(health: VehicleHealth) -> object:
    due = health.due(TOPICS)
    return json.loads(due.payload) if due is not None else None


def test_health_is_published_when_it_changes_and_with_each_connection() -> None:
    health = VehicleHealth("1.2", lost=3)
    assert status(health) == {"status": "daemon-away", "conditions": None, "lost": 3, "version": "1.2"}
    assert status(health) is None
    health.daemon_is_there = True
    assert status(health) == {"status": "online", "conditions": None, "lost": 3, "version": "1.2"}
    health.lost = 4
    assert status(health) == {"status": "online", "conditions": None, "lost": 4, "version": "1.2"}
    health.connected()
    assert status(health) == {"status": "online", "conditions": None, "lost": 4, "version": "1.2"}


def test_conditions_that_are_not_known_are_not_none() -> None:
    health = VehicleHealth("1.2", lost=0)
    health.daemon_is_there = True
    health.after(made(5, schema="faultline.health/1", conditions=[{"kind": "missing", "of": "p_du"}]))
    standing = [{"kind": "missing", "of": "p_du"}]
    assert status(health) == {"status": "online", "conditions": standing, "lost": 0, "version": "1.2"}
    health.daemon_is_there = False
    assert status(health) == {"status": "daemon-away", "conditions": None, "lost": 0, "version": "1.2"}
    offline = health.offline(TOPICS)
    assert json.loads(offline.payload) == {"status": "offline", "conditions": None, "lost": 0, "version": "1.2"}
    assert offline.retain


def test_old_conditions_do_not_come_back() -> None:
    health = VehicleHealth("1.2", lost=0)
    health.daemon_is_there = True
    health.now(msgspec.Raw(b"[]"), epoch=1, seq=100)
    health.after(made(50, schema="faultline.health/1", conditions=[{"kind": "missing"}]))
    assert status(health) == {"status": "online", "conditions": [], "lost": 0, "version": "1.2"}
    health.after(made(101, schema="faultline.health/1", conditions=[{"kind": "jump"}]))
    assert status(health) == {"status": "online", "conditions": [{"kind": "jump"}], "lost": 0, "version": "1.2"}
    with pytest.raises(RecordError):
        health.after(made(102, schema="faultline.health/1"))

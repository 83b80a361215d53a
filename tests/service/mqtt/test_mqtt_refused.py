"""A broker that refuses, limits, answers backwards or hangs up: what becomes of each record, and what is said."""

import time
from pathlib import Path
from typing import Any

import mqtt_fixtures
import pytest
from mqtt_daemon import FakeDaemon
from mqtt_fake_broker import Answer, FakeBroker, Published
from mqtt_process import Process, write_config

from faultline.service.mqtt.outbox import IN_FLIGHT

daemon, fake = mqtt_fixtures.daemon, mqtt_fixtures.fake


def started(tmp_path: Path, fake: FakeBroker, acknowledged_within: int = 30) -> Process:
    config = write_config(tmp_path, fake.port, vehicle="truck-17", acknowledged_within=acknowledged_within)
    return Process(config)


def refuse(*ids: str, code: int, times: int = 1) -> Any:
    """Refuses the events with these ids the first so many times."""
    left = dict.fromkeys(ids, times)

    def answer(one: Published) -> Answer:
        if one.topic.endswith("/events") and left.get(one.id, 0):
            left[one.id] -= 1
            return code
        return 0

    return answer


def test_at_most_twenty_are_in_flight_and_all_come_as_fast_as_they_are_acknowledged(
    tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker
) -> None:
    fake.backwards = IN_FLIGHT
    told = daemon.storm(2000)
    process = started(tmp_path, fake)
    fake.wait(lambda: len(fake.published) >= 2001)
    assert process.stop() == 0
    assert fake.events() == told
    assert fake.most_unanswered == IN_FLIGHT
    fake.wait(lambda: fake.goodbyes == [0])


def test_a_broker_that_takes_fewer_at_once_gets_no_more(tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker) -> None:
    fake.properties = bytes([0x21, 0, 3])  # Receive Maximum
    fake.answer = lambda one: None if one.connection == 1 else 0
    told = daemon.storm(300)
    process = started(tmp_path, fake, acknowledged_within=3)
    process.wait_said("what was sent 3 s ago is not acknowledged")
    assert len([one for one in fake.published if one.connection == 1]) == 3
    fake.wait(lambda: told[-1] in fake.events())
    assert process.stop() == 0
    assert fake.events()[-300:] == told
    assert fake.most_unanswered == 3


def test_answers_that_come_backwards_move_the_place_in_order(
    tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker
) -> None:
    """The broker answers the last of ten, not the first, and hangs up: all ten come again."""
    silent = {0: True}
    fake.answer = lambda one: None if silent[0] and one.topic.endswith("/events") and one.id.endswith("-1") else 0
    told = daemon.storm(10)
    process = started(tmp_path, fake)
    fake.wait(lambda: len(fake.events()) == 10)
    silent[0] = False
    fake.hang_up()
    fake.wait(lambda: len(fake.events()) == 20)
    assert process.stop() == 0
    assert fake.events() == told + told


@pytest.mark.parametrize("code", [0x90, 0x95, 0x99])
def test_a_record_that_is_never_taken_is_said_counted_and_passed_over(
    tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker, code: int
) -> None:
    told = daemon.storm(30)
    fake.answer = refuse(told[3], code=code, times=99)
    process = started(tmp_path, fake)
    fake.wait(lambda: told[-1] in fake.events() and fake.statuses()[-1]["lost"] == 1)
    process.wait_said(f"the broker refuses record {told[3]}: ")
    assert process.stop() == 0
    assert fake.events() == told
    again = started(tmp_path, fake)
    fake.wait(lambda: fake.statuses()[-1]["status"] == "online")
    assert fake.statuses()[-1]["lost"] == 1
    assert again.stop() == 0
    assert fake.events() == told


@pytest.mark.parametrize("code", [0x80, 0x83, 0x87, 0x97])
def test_a_record_that_may_be_taken_later_is_sent_again_with_all_after_it(
    tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker, code: int
) -> None:
    told = daemon.storm(30)
    fake.answer = refuse(told[3], code=code)
    process = started(tmp_path, fake)
    fake.wait(lambda: len(fake.events()) >= 30 and fake.events()[-1] == told[-1] and told[3] in fake.events()[10:])
    said = process.wait_said(f"the broker refuses record {told[3]}: ")
    assert "it is tried again, check what is allowed at faultline/truck-17/events" in said
    assert process.stop() == 0
    came = fake.events()
    assert came[came.index(told[3], 4) :] == told[3:]
    assert fake.statuses()[-2]["lost"] == 0
    assert fake.connections == 1


def test_an_acl_that_forbids_everything_loses_nothing_at_once(
    tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker
) -> None:
    """One publication at a time finds out, less and less often; once it is allowed all come."""
    allowed = {0: False}
    fake.answer = lambda one: 0 if allowed[0] or not one.topic.endswith("/events") else 0x87
    told = daemon.storm(100)
    process = started(tmp_path, fake)
    fake.wait(lambda: len(fake.events()) > IN_FLIGHT)
    time.sleep(0.4)
    assert len(fake.events()) < IN_FLIGHT + 8
    assert set(fake.events()[IN_FLIGHT:]) == {told[0]}
    allowed[0] = True
    fake.wait(lambda: told[-1] in fake.events())
    assert process.stop() == 0
    assert fake.events()[-100:] == told
    assert len([line for line in process.said if "refuses" in line]) == 1


def test_a_state_that_is_refused_holds_nothing_up_and_is_no_lost_record(
    tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker
) -> None:
    fake.answer = lambda one: 0x99 if "/faults/" in one.topic else 0
    told = [daemon.tell_fault(number) for number in (1, 2, 3)]
    process = started(tmp_path, fake)
    fake.wait(lambda: len(fake.events()) == 3)
    told.append(daemon.tell_fault(4))
    fake.wait(lambda: len(fake.events()) == 4)
    process.wait_said("the broker refuses the state of fault ")
    assert process.stop() == 0
    assert fake.events() == told
    assert {one["lost"] for one in fake.statuses()} == {0}


def test_what_is_larger_than_the_broker_takes_is_not_sent(tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker) -> None:
    fake.properties = bytes([0x27, *(4000).to_bytes(4, "big")])  # Maximum Packet Size
    first, large = daemon.tell(), daemon.tell(alarm=["t02"] * 1000)
    last = daemon.tell()
    process = started(tmp_path, fake)
    fake.wait(lambda: fake.statuses()[-1:] != [] and fake.statuses()[-1]["lost"] == 1)
    process.wait_said(f"record {large} is larger than the broker takes: it is lost")
    assert process.stop() == 0
    assert fake.events() == [first, last]
    assert max(len(one.payload) for one in fake.published) < 4000


@pytest.mark.parametrize("code", [0x90, 0x95, 0x99])
def test_a_broker_that_hangs_up_on_a_record_gets_it_alone_then_no_more(
    tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker, code: int
) -> None:
    """It does not say which of the twenty it was: sent one by one it shows."""
    told = daemon.storm(30)
    fake.answer = lambda one: -code if one.id == told[3] else 0
    process = started(tmp_path, fake)
    fake.wait(lambda: told[-1] in fake.events() and fake.statuses()[-1]["lost"] == 1)
    process.wait_said(f"the broker refuses record {told[3]}: ")
    assert process.stop() == 0
    assert fake.connections == 3
    assert sorted(set(told) - set(fake.events())) == []


def test_a_broker_that_hangs_up_on_a_state_gets_it_no_more(
    tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker
) -> None:
    fake.answer = lambda one: -0x87 if one.topic.endswith("/health") else 0
    told = daemon.storm(3)
    process = started(tmp_path, fake)
    fake.wait(lambda: told[-1] in fake.events())
    process.wait_said("the broker refuses health: not authorized")
    process.kill()


def test_a_broker_that_never_acknowledges_is_left_and_tried_again(
    tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker
) -> None:
    silent = {0: True}
    fake.answer = lambda _: None if silent[0] else 0
    told = daemon.storm(50)
    process = started(tmp_path, fake, acknowledged_within=3)
    process.wait_said("what was sent 3 s ago is not acknowledged")
    assert len([one for one in fake.published if one.connection == 1]) == IN_FLIGHT
    silent[0] = False
    fake.wait(lambda: told[-1] in fake.events())
    assert fake.events()[-50:] == told
    assert process.stop() == 0


def test_a_broker_without_subscriptions_or_that_hangs_up_on_one_is_used_without(
    tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker
) -> None:
    fake.hangs_up_on_subscribe = True
    daemon.tell_fault(1)
    process = started(tmp_path, fake)
    fake.wait(lambda: len(fake.events()) >= 1 and fake.connections >= 2)
    assert fake.subscriptions == 1
    fake.wait(lambda: any(one.topic.endswith("/faults/1") for one in fake.published))
    assert process.stop() == 0


def test_a_broker_that_shows_nothing_is_said_and_the_cursor_knows_what_to_erase(
    tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker
) -> None:
    fake.suback = 0x87
    daemon.tell_fault(1)
    process = started(tmp_path, fake)
    process.wait_said("it does not let us see what it holds at faultline/truck-17/faults/+: not authorized")
    fake.wait(lambda: any(one.topic.endswith("/faults/1") for one in fake.published))
    assert process.stop() == 0
    daemon.faults.clear()
    again = started(tmp_path, fake)
    fake.wait(lambda: any(one.topic.endswith("/faults/1") and not one.payload for one in fake.published))
    assert again.stop() == 0


@pytest.mark.parametrize(
    ("code", "properties", "said"),
    [
        (0x86, b"", "it refuses us: bad user name or password; check `user` and `password_file`"),
        (0x87, b"", "it refuses us: not authorized; check `user`, `password_file` and what the broker allows them"),
        (0x84, b"", "it refuses us: unsupported protocol version; it takes no MQTT 5"),
        (0x85, b"", "it refuses us: client identifier not valid; give another `client_id`"),
        (0x9C, b"", "it refuses us: use another server"),
        (0x00, bytes([0x24, 0]), "it refuses us: qos not supported; it takes no QoS 1; faultline needs it"),
        (0x00, bytes([0x25, 0]), "it refuses us: retain not supported; it keeps no retained messages"),
    ],
)
def test_a_broker_that_does_not_take_us_is_said_in_one_line(
    tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker, code: int, properties: bytes, said: str
) -> None:
    fake.connack, fake.properties = code, properties
    told = daemon.tell()
    process = started(tmp_path, fake)
    line = process.wait_said("it refuses us")
    assert line.startswith(f"faultline mqtt: 127.0.0.1:{fake.port}: {said}")
    assert line.endswith("it is tried again, records wait")
    process.kill()
    assert told not in fake.events()


def test_the_same_refusal_is_one_line_a_minute_and_once_it_ends_all_comes(
    tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker
) -> None:
    fake.connack = 0x87
    told = daemon.tell()
    process = started(tmp_path, fake)
    fake.wait(lambda: fake.connections >= 2)
    fake.connack = 0
    fake.wait(lambda: fake.events() == [told])
    assert process.stop() == 0
    assert len([one for one in process.said if "it refuses us" in one]) == 1


def test_another_client_of_the_same_name_is_said(tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker) -> None:
    process = started(tmp_path, fake)
    fake.wait(lambda: fake.statuses() != [])
    fake._socks[-1].sendall(bytes([0xE0, 1, 0x8E]))
    said = process.wait_said("it has ended the connection")
    assert "session taken over; another client has the same name; give another `client_id`" in said
    assert process.stop() == 0


@pytest.mark.parametrize(
    "noise", [b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\x20\xff\xff\xff\xff\xff", b"\x20\x03\x00\x00\x05", b"\x00" * 64]
)
def test_what_is_no_mqtt_is_said_and_ends_nothing(
    tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker, noise: bytes
) -> None:
    process = started(tmp_path, fake)
    fake.wait(lambda: fake.statuses() != [])
    fake._socks[-1].sendall(noise)
    fake._socks[-1].shutdown(1)
    process.wait_said("it is tried again, records wait")
    fake.wait(lambda: fake.connections >= 2)
    assert process.is_running()
    assert process.stop() == 0


def test_what_is_left_to_the_broker_says_offline(tmp_path: Path, daemon: FakeDaemon, fake: FakeBroker) -> None:
    """A stop that the broker does not acknowledge ends with the will; one that it does, without."""
    silent = {0: False}
    fake.answer = lambda _: None if silent[0] else 0
    process = started(tmp_path, fake)
    fake.wait(lambda: fake.statuses() != [])
    silent[0] = True
    assert process.stop() == 0
    fake.wait(lambda: fake.goodbyes == [4])
    assert fake.statuses()[-1]["status"] == "offline"

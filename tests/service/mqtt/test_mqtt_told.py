"""With a real broker: what a fleet's backend hears of one vehicle."""

import signal
import socket
from pathlib import Path

import mqtt_fixtures
import pytest
from mqtt_daemon import FakeDaemon
from mqtt_mosquitto import Mosquitto, Subscriber, retained
from mqtt_process import Process, write_config

daemon, broker = mqtt_fixtures.daemon, mqtt_fixtures.broker
backend, process = mqtt_fixtures.backend, mqtt_fixtures.process

BASE = "faultline/truck-17"


def test_events_come_in_order_as_cloud_events(daemon: FakeDaemon, backend: Subscriber, process: Process) -> None:
    told = [daemon.tell(transition="started", bundle="b" * 64), *daemon.storm(50), daemon.tell_fault(3)]
    backend.wait(lambda: len(backend.events()) == len(told))
    assert backend.ids() == told
    first = backend.last(f"{BASE}/events")
    assert first is not None
    assert (first.content_type, first.retain) == ("application/cloudevents+json", False)
    assert backend.events()[0] == {
        "specversion": "1.0",
        "id": told[0],
        "source": "urn:faultline:truck-17",
        "type": "io.faultline.event.started",
        "subject": "b" * 64,
        "time": "2026-03-01T10:00:00.250Z",
        "datacontenttype": "application/json",
        "sequence": "00000000000000000001",
        "data": {
            "schema": "faultline.event/1",
            "id": told[0],
            "seq": 1,
            "wall": "2026-03-01T10:00:00.250Z",
            "transition": "started",
            "bundle": "b" * 64,
        },
    }


def test_records_of_every_schema_are_told_known_or_not(
    daemon: FakeDaemon, backend: Subscriber, process: Process
) -> None:
    daemon.tell("faultline.health/1", conditions=[])
    daemon.tell_fault(2)
    daemon.tell_cleared(2)
    daemon.tell("faultline.weather/7", rain=True)
    backend.wait(lambda: len(backend.events()) == 4)
    kinds = ["health", "fault.confirmed", "cleared", "weather.v7"]
    assert [one["type"] for one in backend.events()] == [f"io.faultline.{kind}" for kind in kinds]
    assert [one.get("subject") for one in backend.events()] == [None, "2", "2", None]


def test_each_remembered_fault_has_a_retained_state_until_it_is_erased(
    daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, process: Process
) -> None:
    backend.wait_status("online")
    for number in (1, 2, 3, 4):
        daemon.tell_fault(number)
    daemon.tell_fault(1, "aged")
    daemon.tell_fault(2, "displaced")
    daemon.tell_fault(3, "passed")
    last = daemon.tell_cleared(4)
    backend.wait(lambda: last in backend.ids())
    backend.wait(lambda: (one := backend.last(f"{BASE}/faults/4")) is not None and not one.payload)
    kept = retained(broker.port, f"{BASE}/")
    assert sorted(kept) == [f"{BASE}/faults/3", f"{BASE}/health"]
    state = backend.last(f"{BASE}/faults/3")
    assert state is not None
    assert (state.json["number"], state.json["change"], state.content_type) == (3, "passed", "application/json")


def test_what_an_earlier_run_left_is_made_right_with_the_next_connection(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, process: Process
) -> None:
    """A fault aged and another came while nobody was connected; and the records on that are still to come."""
    for number in (1, 2):
        daemon.tell_fault(number)
    backend.wait(lambda: len(backend.events()) == 2)
    assert process.stop() == 0
    daemon.tell_fault(1, "aged")
    daemon.tell_fault(3, "pending")
    last = daemon.tell_fault(3, "confirmed")
    again = Process(write_config(tmp_path, broker.port))
    backend.wait(lambda: last in backend.ids())
    again.wait_said("connected, as truck-17")
    backend.wait(lambda: backend.last(f"{BASE}/faults/3") is not None)
    backend.wait(lambda: (one := backend.last(f"{BASE}/faults/1")) is not None and not one.payload)
    assert again.stop() == 0
    kept = retained(broker.port, f"{BASE}/")
    assert sorted(kept) == [f"{BASE}/faults/2", f"{BASE}/faults/3", f"{BASE}/health"]
    told = [one.json["change"] for one in backend.messages if one.topic == f"{BASE}/faults/3"]
    assert told == ["confirmed"]  # as it is now, never as it was


@pytest.mark.parametrize("loses", ["cursor", "daemon"])
def test_states_that_nobody_remembers_are_found_at_the_broker(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, process: Process, loses: str
) -> None:
    daemon.tell_fault(1)
    backend.wait(lambda: backend.last(f"{BASE}/faults/1") is not None)
    backend.wait(lambda: len(backend.events()) == 1)
    assert process.stop() == 0
    if loses == "cursor":
        (tmp_path / "cursor").unlink()
        daemon.faults.clear()
    else:  # its store, and the run before is not known to it either
        daemon.records.clear()
        daemon.faults.clear()
        daemon.run = "00000002"
        daemon.tell(transition="started")
    again = Process(write_config(tmp_path, broker.port))
    backend.wait(lambda: (one := backend.last(f"{BASE}/faults/1")) is not None and not one.payload)
    assert again.stop() == 0
    assert sorted(retained(broker.port, f"{BASE}/")) == [f"{BASE}/health"]


def test_a_service_that_lost_its_memory_changes_what_is_retained(
    daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, process: Process
) -> None:
    """Without a record on it, and with the connection to the broker as it is."""
    daemon.tell_fault(1)
    backend.wait(lambda: (one := backend.last(f"{BASE}/faults/1")) is not None and bool(one.payload))
    daemon.stop()
    daemon.faults = {2: {"number": 2}}
    daemon.start()
    backend.wait(lambda: (one := backend.last(f"{BASE}/faults/1")) is not None and not one.payload)
    backend.wait(lambda: backend.last(f"{BASE}/faults/2") is not None)
    assert process.stop() == 0


def test_what_is_only_passing_there_is_left_alone(
    daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, process: Process
) -> None:
    backend.wait_status("online")
    backend.publish(f"{BASE}/faults/77", b"somebody's")
    told = daemon.tell()
    backend.wait(lambda: told in backend.ids())
    assert process.stop() == 0
    backend.wait_status("offline")
    assert [one.payload for one in backend.messages if one.topic.endswith("/77")] == [b"somebody's"]


def test_what_others_retain_there_is_left_alone(
    daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, tmp_path: Path
) -> None:
    backend.publish(f"{BASE}/faults/somebody", b"else", retain=True)
    backend.publish("faultline/truck-18/faults/1", b"other", retain=True)
    process = Process(write_config(tmp_path, broker.port))
    backend.wait_status("online")
    last = daemon.tell()
    backend.wait(lambda: last in backend.ids())
    assert process.stop() == 0
    kept = retained(broker.port)
    assert kept[f"{BASE}/faults/somebody"] == b"else"
    assert kept["faultline/truck-18/faults/1"] == b"other"


def test_health_says_online_conditions_daemon_away_and_offline(
    daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, process: Process
) -> None:
    backend.wait_status("online")
    standing = {"kind": "missing", "of": "p_du", "since": "2026-03-01T10:00:00Z"}
    daemon.tell("faultline.health/1", conditions=[standing])
    backend.wait(lambda: backend.health()["conditions"] == [standing])
    assert backend.health()["lost"] == 0
    daemon.stop()
    backend.wait_status("daemon-away")
    daemon.start()
    backend.wait_status("online")
    assert process.stop() == 0
    backend.wait_status("offline")
    assert b'"offline"' in retained(broker.port, f"{BASE}/health")[f"{BASE}/health"]


def test_health_begins_with_what_stands_already(
    daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, tmp_path: Path
) -> None:
    daemon.conditions = [{"kind": "bus-down", "of": "powertrain", "since": "2026-03-01T10:00:00Z"}]
    process = Process(write_config(tmp_path, broker.port))
    backend.wait(lambda: any(one.topic.endswith("health") and one.json["conditions"] for one in backend.messages))
    assert process.stop() == 0


def test_who_is_killed_is_offline_by_the_brokers_word(
    daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, process: Process
) -> None:
    backend.wait_status("online")
    process.kill()
    backend.wait_status("offline")
    assert b'"offline"' in retained(broker.port, f"{BASE}/health")[f"{BASE}/health"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_stop_takes_what_is_in_flight_along(
    tmp_path: Path, daemon: FakeDaemon, backend: Subscriber, process: Process, number: int
) -> None:
    """After a stop nothing comes twice: all that was sent is acknowledged and kept."""
    told = daemon.storm(12_000)  # more than go while nobody looks
    backend.wait(lambda: len(backend.events()) > 300)
    process.signal(number)
    assert process.wait() == 0
    backend.wait_status("offline")
    assert len(backend.ids()) < len(told)
    again = Process(tmp_path / "mqtt.toml")
    backend.wait(lambda: len(backend.ids()) >= len(told), 60)
    assert again.stop() == 0
    assert backend.ids() == told


def test_a_second_process_on_the_same_cursor_is_refused(tmp_path: Path, backend: Subscriber, process: Process) -> None:
    backend.wait_status("online")
    second = Process(tmp_path / "mqtt.toml")
    assert second.wait() == 2
    assert "another faultline mqtt uses it" in second.said[-1]


def test_the_daemon_says_who_it_is(tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber) -> None:
    daemon.source = "truck-18"
    process = Process(write_config(tmp_path, broker.port, prefix="faultline/north"))
    backend.wait(lambda: backend.status("faultline/north/truck-18/health") == "online")
    daemon.stop()
    daemon.source = "truck-19"
    daemon.start()
    backend.wait(lambda: backend.status("faultline/north/truck-19/health") == "online")
    backend.wait(lambda: backend.status("faultline/north/truck-18/health") == "offline")
    assert process.stop() == 0


def test_the_configuration_says_who_it_is(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber
) -> None:
    process = Process(write_config(tmp_path, broker.port, vehicle="vin-7"))
    daemon.tell()
    backend.wait(lambda: backend.last("faultline/vin-7/events") is not None)
    assert backend.events()[0]["source"] == "urn:faultline:vin-7"
    assert process.stop() == 0


def test_before_the_daemon_is_there_the_broker_hears_that(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber
) -> None:
    daemon.stop()
    process = Process(write_config(tmp_path, broker.port, vehicle="truck-17"))
    backend.wait_status("daemon-away")
    told = daemon.tell()
    daemon.start()
    backend.wait(lambda: told in backend.ids())
    backend.wait_status("online")
    assert process.stop() == 0


@pytest.mark.parametrize("source", ["a/b", "#", "truck\u0000", "x" * 81, "../truck"])
def test_a_name_that_would_reach_other_topics_is_not_connected_with(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, source: str
) -> None:
    daemon.source = source
    daemon.tell()
    process = Process(write_config(tmp_path, broker.port))
    said = process.wait_said("the daemon's name (`source`)")
    assert "give `vehicle` in the configuration. Nothing is published until then" in said
    daemon.stop()
    daemon.source = "truck-17"
    daemon.start()
    backend.wait_status("online")
    assert process.stop() == 0
    assert {one.topic.split("/")[1] for one in backend.messages} == {"truck-17"}


def test_without_a_control_socket_records_name_the_vehicle_and_states_follow_them(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber
) -> None:
    daemon.answers = lambda _: b"{}\n"
    told = daemon.tell_fault(3)
    process = Process(write_config(tmp_path, broker.port))
    backend.wait(lambda: told in backend.ids() and backend.last(f"{BASE}/faults/3") is not None)
    process.wait_said("control.sock: sent no state: has no field")
    daemon.answers = None
    daemon.faults.clear()
    backend.wait(lambda: (one := backend.last(f"{BASE}/faults/3")) is not None and not one.payload)
    assert process.stop() == 0


def test_a_gap_in_the_numbers_is_said_and_counted_once(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, process: Process
) -> None:
    daemon.tell()
    daemon.tell(missing=5)
    backend.wait(lambda: backend.health()["lost"] == 5)
    process.wait_said("the daemon no longer holds 5 records before truck-17-5e0c72b1-7: they are lost")
    process.kill()
    again = Process(write_config(tmp_path, broker.port))
    told = daemon.tell(missing=2)
    backend.wait(lambda: told in backend.ids() and backend.health()["lost"] == 7)
    assert again.stop() == 0


def test_what_the_daemon_no_longer_holds_is_counted(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, process: Process
) -> None:
    daemon.storm(10)
    backend.wait(lambda: len(backend.events()) == 10)
    assert process.stop() == 0
    daemon.storm(100)
    daemon.first = 60
    again = Process(write_config(tmp_path, broker.port))
    again.wait_said("no longer holds 50 records before truck-17-5e0c72b1-61")
    backend.wait(lambda: len(backend.events()) == 60 and backend.health()["lost"] == 50)
    assert again.stop() == 0


def test_what_came_before_the_first_start_is_not_lost(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber
) -> None:
    told = daemon.storm(100)
    daemon.first = 60
    process = Process(write_config(tmp_path, broker.port))
    backend.wait(lambda: backend.ids() == told[60:])
    assert process.stop() == 0
    backend.wait_status("offline")
    assert backend.health()["lost"] == 0


def test_a_record_that_the_daemon_gives_twice_is_told_once(
    daemon: FakeDaemon, backend: Subscriber, process: Process
) -> None:
    first = daemon.tell()
    daemon.records.append(daemon.records[-1])
    last = daemon.tell()
    backend.wait(lambda: last in backend.ids())
    assert backend.ids() == [first, last]


def test_numbers_that_begin_anew_are_said_and_no_loss(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, process: Process
) -> None:
    daemon.storm(10)
    backend.wait(lambda: len(backend.events()) == 10)
    daemon.stop()
    daemon.records.clear()
    daemon.run = "00000002"
    told = daemon.storm(3)
    daemon.start()
    backend.wait(lambda: backend.ids()[10:] == told)
    process.wait_said("the daemon does not know truck-17-5e0c72b1-10 and begins with truck-17-00000002-1")
    assert {one.json["lost"] for one in backend.messages if one.topic.endswith("health")} == {0}


def test_a_line_that_is_no_record_is_said_and_passed_over(
    daemon: FakeDaemon, backend: Subscriber, process: Process
) -> None:
    daemon.tell()
    daemon.records.append(("", 1, b'{"schema":"faultline.event/1","id":"x"\n'))
    daemon.records.append(("", 1, b"x" * (3 << 20) + b"\n"))
    told = daemon.tell()
    backend.wait(lambda: told in backend.ids())
    assert len(backend.events()) == 2
    process.wait_said("sent what is no record")


def test_the_service_manager_hears_that_it_is_ready_once_sockets_were_tried(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(10)
        process = Process(
            write_config(tmp_path, broker.port), NOTIFY_SOCKET=str(tmp_path / "notify"), WATCHDOG_USEC="300000"
        )
        told = set[str]()
        wanted = {"READY=1", "WATCHDOG=1", "STATUS=connected to the broker, connected to the daemon"}
        while not wanted <= told:
            told.add(manager.recv(4096).decode())
        process.signal(signal.SIGTERM)
        while "STOPPING=1" not in told:
            told.add(manager.recv(4096).decode())
        assert process.wait() == 0

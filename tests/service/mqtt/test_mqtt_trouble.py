"""A broker that goes, a process that is killed, a disk that is full, clocks that jump: nothing is lost."""

import random
import signal
import sys
import threading
import time
from pathlib import Path

import mqtt_fixtures
import pytest
from mqtt_daemon import FakeDaemon
from mqtt_fake_broker import FakeBroker
from mqtt_mosquitto import Mosquitto, Subscriber
from mqtt_process import Process, wait_until, write_config

from faultline.service.mqtt.outbox import IN_FLIGHT, WINDOW

daemon, broker = mqtt_fixtures.daemon, mqtt_fixtures.broker
backend, process = mqtt_fixtures.backend, mqtt_fixtures.process

MEBI = 1 << 20
READ_AHEAD = WINDOW + 400
"""Records that are read at most while the broker is away: the window, one chunk, and what the kernel holds."""


def first_come(ids: list[str]) -> list[str]:
    """Without what came again."""
    return list(dict.fromkeys(ids))


def test_ten_thousand_records_over_a_broker_that_is_killed_all_come_in_order(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto
) -> None:
    backend = Subscriber(broker.port, qos=0)
    broker.save()  # the backend's subscription; what is published later is not in it
    process = Process(write_config(tmp_path, broker.port))
    told = daemon.storm(1800)
    backend.wait(lambda: len(backend.ids()) >= 1500)  # the kernel has room for the rest, so the broker keeps none back
    broker.stop(signal.SIGKILL)
    process.wait_said("records wait")
    before = process.memory
    told += daemon.storm(8200)
    time.sleep(0.3)  # however long it has, it reads no further
    given = daemon.given
    assert given < 1800 + READ_AHEAD
    assert process.memory - before < 2 * MEBI
    broker.start()
    backend.wait(lambda: told[-1] in backend.ids()[-200:], 40)
    assert first_come(backend.ids()) == told
    assert len(backend.ids()) < len(told) + 5 * IN_FLIGHT
    assert process.memory - before < 4 * MEBI
    assert process.stop() == 0
    backend.close()


@pytest.mark.parametrize("seed", [1])
def test_killed_at_any_moment_it_leaves_nothing_out(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, seed: int
) -> None:
    """Twenty times, while records flow."""
    chance = random.Random(seed)  # noqa: S311
    config = write_config(tmp_path, broker.port)
    told, ended = list[str](), threading.Event()

    def flow() -> None:
        while not ended.wait(0.002):
            told.append(daemon.tell_fault(len(told) % 5 + 1, "refined") if chance.random() < 0.1 else daemon.tell())

    flowing = threading.Thread(target=flow)
    flowing.start()
    for turn in range(20):
        process = Process(config)
        if turn % 2:  # however long it takes to begin: it is at work
            heard = len(backend.ids())
            backend.wait(lambda heard=heard: len(backend.ids()) > heard)  # type: ignore[misc]
        time.sleep(chance.uniform(0.05, 0.4))
        process.kill()
    ended.set()
    flowing.join()
    last = Process(config)
    backend.wait(lambda: told[-1] in backend.ids()[-3:])
    assert last.stop() == 0
    assert first_come(backend.ids()) == told
    assert len(backend.ids()) > len(told)  # it was killed between an acknowledgement and what is kept of it


def test_a_cursor_that_is_damaged_costs_duplicates_and_no_record(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, process: Process
) -> None:
    told = daemon.storm(20)
    backend.wait(lambda: len(backend.ids()) == 20)
    assert process.stop() == 0
    cursor = tmp_path / "cursor"
    cursor.write_bytes(cursor.read_bytes()[:30])
    again = Process(write_config(tmp_path, broker.port))
    again.wait_said(f"{cursor}: is damaged; it is now {cursor}.damaged-1; beginning with the oldest record there is")
    backend.wait(lambda: len(backend.ids()) == 40)
    assert again.stop() == 0
    assert backend.ids() == told + told
    assert daemon.asked == [0, 0]


def test_it_asks_for_what_came_after_the_last_acknowledged(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber, process: Process
) -> None:
    told = daemon.storm(5)
    backend.wait(lambda: len(backend.ids()) == 5)
    assert process.stop() == 0
    assert Process(tmp_path / "mqtt.toml").stop() in (0, -signal.SIGTERM)
    third = Process(tmp_path / "mqtt.toml")
    third.wait_said(f"connected to the daemon, after {told[-1]}")
    wait_until(lambda: daemon.asked[-1] == told[-1])  # it has asked; who answers may be still to read that
    third.kill()


def test_a_folder_that_takes_nothing_more_is_said_and_events_come_all_the_same(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber
) -> None:
    """A full disk, as a process of ours sees it: every write fails (no file may have a byte)."""
    config = write_config(tmp_path, broker.port)
    process = Process(config, largest_file=0)
    told = daemon.storm(300)
    backend.wait(lambda: len(backend.ids()) == 300)
    process.wait_said("how far it is cannot be kept: ")
    told += daemon.storm(300)
    backend.wait(lambda: len(backend.ids()) == 600)
    assert process.stop() == 0
    assert backend.ids() == told
    assert not (tmp_path / "cursor").exists()
    assert not [*tmp_path.glob(".cursor.*")]


def test_a_daemon_that_dies_in_the_middle_is_found_again(
    daemon: FakeDaemon, backend: Subscriber, process: Process
) -> None:
    told = daemon.storm(2000)
    for count in (200, 700, 1200):
        backend.wait(lambda count=count: len(backend.ids()) > count)  # type: ignore[misc]
        daemon.stop()
        daemon.start()
    told += daemon.storm(10)
    backend.wait(lambda: told[-1] in backend.ids()[-3:])
    assert backend.ids() == told
    process.wait_said("the daemon is away")


def test_a_broker_that_hangs_is_noticed_and_left(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber
) -> None:
    process = Process(write_config(tmp_path, broker.port, acknowledged_within=1))
    backend.wait_status("online")
    broker.freeze()
    told = daemon.storm(50)
    process.wait_said("what was sent 1 s ago is not acknowledged; it is tried again, records wait")
    broker.thaw()
    backend.wait(lambda: told[-1] in backend.ids())
    assert first_come(backend.ids()) == told
    assert process.stop() == 0


def test_it_stops_at_once_while_the_broker_hangs(tmp_path: Path, daemon: FakeDaemon) -> None:
    """A broker that takes a connection and says nothing, and one that is not there."""
    silent = FakeBroker(lambda _: None)
    for port in (silent.port, 1):
        process = Process(write_config(tmp_path, port, vehicle="truck-17"))
        process.wait_said("connected to the daemon")
        begun = time.monotonic()
        assert process.stop() == 0
        assert time.monotonic() - begun < 5
    silent.close()


def test_no_more_is_read_than_can_be_kept_while_there_is_no_broker(tmp_path: Path, daemon: FakeDaemon) -> None:
    daemon.storm(20_000)
    process = Process(write_config(tmp_path, 1, vehicle="truck-17"))
    said = process.wait_said("127.0.0.1:1: ")
    assert "nobody listens there; is the broker running?; it is tried again, records wait" in said
    wait_until(lambda: daemon.given > WINDOW)
    time.sleep(0.3)
    assert daemon.given < READ_AHEAD + 2000  # the kernel holds some 200 kB
    assert process.memory < 40 * MEBI
    process.kill()


PROGRAM = """
import random, sys, threading, time
chance = random.Random(7)
true_time, true_ns = time.time, time.time_ns
time.time = lambda: true_time() + chance.choice([-86400 * 400, 0, 86400 * 400])
time.time_ns = lambda: int(time.time() * 1e9)
"""


def test_steps_of_the_wall_clock_have_no_influence(
    tmp_path: Path, daemon: FakeDaemon, broker: Mosquitto, backend: Subscriber
) -> None:
    """As if somebody set the clock by a year, back and forth, all the time."""
    process = Process(write_config(tmp_path, broker.port, keepalive=20, acknowledged_within=10), before=PROGRAM)
    told = list[str]()
    for _ in range(10):
        told += daemon.storm(20)
        time.sleep(0.05)
    backend.wait(lambda: len(backend.ids()) == len(told))
    assert process.stop() == 0
    assert backend.ids() == told
    assert [line for line in process.said if "connected" not in line] == []


def test_no_part_of_it_reads_the_wall_clock() -> None:
    folder = Path(str(sys.modules["faultline.service.mqtt.outbox"].__file__)).parent
    used = [each.name for each in folder.glob("*.py") if "time.time" in each.read_text() or "now()" in each.read_text()]
    assert used == []

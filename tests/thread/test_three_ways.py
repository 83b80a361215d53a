"""The same recording over a bus, in real time and ten times faster, gives the verdicts of the log.

A machine under load may hold up the sender, and then the bus carries another log: late frames, or silence. So what was
on the bus is recorded beside the daemon, and its verdicts are those of this recording; where the sender was punctual,
they are those of the golden log besides.
"""

import contextlib
import json
import os
import re
import selectors
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import msgspec
import pytest
from ports import multicast

from faultline.service.bundle.load import load_bundle
from faultline.service.bus import open_bus
from faultline.service.core.records.event import Event, decode, is_other, schema_of
from faultline.service.core.records.fault import SCHEMA as FAULT
from faultline.service.core.records.fault import FaultRecord
from faultline.service.logs import open_log

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
OFFLINE = [decode(line) for line in (GOLDEN / "events.jsonl").read_bytes().splitlines()]
BEGIN = 1767225600.0  # the golden log's first frame [s]
FAULTLINE = str(Path(sys.executable).with_name("faultline"))


@contextlib.contextmanager
def daemon(tmp_path: Path, bus: str, speed: float, out: IO[bytes] | None = None) -> Iterator["subprocess.Popen[bytes]"]:
    """A running daemon that prints to `out`, stopped at the end as systemd would."""
    command = [FAULTLINE, "run", "--bundle", str(GOLDEN / "bundle"), "--bus", bus, "--socket", str(tmp_path / "s")]
    process = subprocess.Popen([*command, "--speed", str(speed), "--source", "golden"], stdout=out)
    try:
        for _ in range(600):
            if (tmp_path / "s").exists() or process.poll() is not None:
                break
            time.sleep(0.1)
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(30)


@contextlib.contextmanager
def recorder(bus: str, speed: float, path: Path) -> Iterator[None]:
    """Writes what the bus carries to a log, as `candump -L` does, in log time."""
    joined, ended = threading.Event(), threading.Event()

    def record() -> None:
        first = None
        with open_bus(bus) as ours, selectors.DefaultSelector() as ready, path.open("w") as log:
            ready.register(ours.fileno(), selectors.EVENT_READ)
            joined.set()
            while ready.select(0.1) or not ended.is_set():
                for frame in ours.receive():
                    first = frame.t if first is None else first
                    t = BEGIN + (frame.t - first) * speed
                    log.write(f"({t:.6f}) can0 {frame.can_id:08X}#{frame.data.hex().upper()}\n")

    thread = threading.Thread(target=record)
    thread.start()
    assert joined.wait(10.0)
    try:
        yield
    finally:
        ended.set()
        thread.join()


def of_the_log(path: Path) -> list[Event]:
    """The events of the system that the diagnosis of a whole log gives."""
    command = [FAULTLINE, "diagnose", str(path), "--bundle", str(GOLDEN / "bundle"), "--json"]
    done = subprocess.run(command, capture_output=True, check=False)
    assert done.returncode == 1  # a fault was found
    return [decode(line) for line in done.stdout.splitlines() if not is_other(line)]


def told(event: Event) -> tuple[str, list[tuple[list[str], int | None, list[str]]]]:
    """What an event says, without the probabilities."""
    return event.transition, [(d.faults, d.rank, d.near) for d in event.diagnoses]


def events_in(path: Path) -> int:
    """How many events of the system it has, of other records besides."""
    return sum(line.endswith(b"\n") and not is_other(line) for line in path.read_bytes().splitlines(keepends=True))


@pytest.mark.parametrize(
    "speed", [pytest.param(10.0, marks=pytest.mark.alone), pytest.param(1.0, marks=pytest.mark.waits)]
)
def test_live_over_the_bus_within_two_samples(tmp_path: Path, speed: float) -> None:
    bus = multicast()
    with (
        (tmp_path / "out").open("wb") as out,
        daemon(tmp_path, bus, speed, out) as process,
        recorder(bus, speed, tmp_path / "can.log"),
    ):
        watch = subprocess.Popen(
            [FAULTLINE, "watch", "--socket", str(tmp_path / "s"), "--after", "0", "--json", "--wait", "10"],
            stdout=subprocess.PIPE,
        )
        replay = [FAULTLINE, "replay", str(GOLDEN / "log"), "--bus", bus, "--speed", str(speed), "--json"]
        sent = json.loads(subprocess.run(replay, stdout=subprocess.PIPE, check=True).stdout)
        end = time.monotonic() + 20.0
        while events_in(tmp_path / "out") < len(OFFLINE) and time.monotonic() < end:
            time.sleep(0.1)
        time.sleep(1.0)  # and what should not come
    lines, _ = watch.communicate(timeout=30)
    assert process.returncode == 0
    assert lines == (tmp_path / "out").read_bytes()  # the subscriber and standard output hear the same
    everything = lines.splitlines()
    ids = [json.loads(line)["id"] for line in everything]
    live = [decode(line) for line in everything if not is_other(line)]
    log, period_s = open_log(tmp_path / "can.log"), load_bundle(GOLDEN / "bundle").manifest.period_s
    assert len(list(log.frames())) == sent["frames"]
    offline = of_the_log(tmp_path / "can.log")
    during = [event for event in live if event.tick <= int(log.duration_s / period_s)]
    if sent["worst_s"] * speed < period_s:
        assert [told(event) for event in offline] == [told(event) for event in OFFLINE]
    pairs: tuple[list[Event], ...] = during, offline
    if sent["worst_s"] * speed >= period_s:
        # a silence of nearly the maximum age may be one for one of two receivers, and none for the other
        print(f"the sender was {sent['worst_s']:.3f} s late")
        pairs = tuple([each for each in of if each.transition != "cannot_tell"] for of in pairs)
    assert [told(event) for event in pairs[0]] == [told(event) for event in pairs[1]]
    for ours, theirs in zip(*pairs, strict=True):
        for diagnosis, exact in zip(ours.diagnoses, theirs.diagnoses, strict=True):
            ours_p, exact_p = diagnosis.p, exact.p
            assert (ours_p is None) == (exact_p is None)
            # at ten times the speed a frame that waits for 20 ms falls into the next sample: other evidence, a little
            assert ours_p is None or exact_p is None or abs(ours_p - exact_p) <= 0.15
    assert all(abs(ours.tick - theirs.tick) <= 2 for ours, theirs in zip(*pairs, strict=True))
    run = ids[0].removesuffix("-1")
    assert re.fullmatch("golden-[0-9a-f]{8}", run)
    assert ids == [f"{run}-{k}" for k in range(1, len(ids) + 1)]
    remembered = [msgspec.json.decode(line, type=FaultRecord) for line in everything if schema_of(line) == FAULT]
    changes = {"occurred": "confirmed", "refined": "refined"}
    expected = [changes[event.transition] for event in during if event.transition in changes]
    assert [record.change for record in remembered] == expected != []
    assert remembered[-1].fault.diagnoses == during[-1].diagnoses
    assert all(event.wall is not None for event in live)
    silence: list[Event] = live[len(during) :]  # after the end the bus is silent: no verdict, and no healing
    assert [event.transition for event in silence] in ([], ["cannot_tell"])
    assert all(event.diagnoses == during[-1].diagnoses for event in silence)


def test_a_subscriber_that_comes_late_hears_what_it_missed(tmp_path: Path) -> None:
    bus = multicast()
    with daemon(tmp_path, bus, 20.0):
        subprocess.run([FAULTLINE, "replay", str(GOLDEN / "log"), "--bus", bus, "--speed", "20"], check=True)
        with socket.socket(socket.AF_UNIX) as client:
            client.connect(str(tmp_path / "s"))
            client.sendall(b'{"after": 2}\n')
            with client.makefile("rb") as stream:
                line = stream.readline()
    assert json.loads(line)["seq"] == 3  # an event, or a health record where the busy machine sends the log late


def test_the_daemon_outlives_a_closed_standard_output(tmp_path: Path) -> None:
    bus = multicast()
    read, write = os.pipe()
    with os.fdopen(write, "wb") as out, daemon(tmp_path, bus, 20.0, out) as process:
        os.close(read)
        subprocess.run([FAULTLINE, "replay", str(GOLDEN / "log"), "--bus", bus, "--speed", "20"], check=True)
        assert process.poll() is None
    assert process.returncode == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--bus", "socketcan:nocan7"], "nocan7"),
        (["--bus", "carrier_pigeon:1"], "no bus 'carrier_pigeon:1'"),
        (["--bundle", "nowhere"], "nowhere/manifest.json: not found"),
    ],
)
def test_what_the_daemon_cannot_use_ends_it_with_one_line(tmp_path: Path, arguments: list[str], words: str) -> None:
    given = {"--bundle": str(GOLDEN / "bundle"), "--bus": "udp_multicast:239.74.163.2:40000"}
    given |= {"--socket": str(tmp_path / "s"), arguments[0]: arguments[1]}
    command = [FAULTLINE, "run", *(word for pair in given.items() for word in pair)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 2
    assert words in done.stderr
    assert done.stderr.count("\n") == 1

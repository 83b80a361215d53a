"""A vehicle's whole alarm chain on one machine, killed at random instants: who was told what, and when.

The daemon, `faultline mqtt` with a real broker, and `faultline serve`; a subscriber of each kind that comes back where
it was. What is played makes alarms over and over.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from faultline.service.store.file import StoreFile

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "service" / "mqtt"))
from mqtt_mosquitto import Mosquitto
from ports import free_port

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
FAULTLINE = str(Path(sys.executable).with_name("faultline"))
SPEED = 20.0
READY_S, RECORDS_S, CAUGHT_UP_S = 30.0, 120.0, 60.0


class Heard(NamedTuple):
    """A record as a subscriber got it: its id, and how long after it was numbered [s, wall clock]."""

    id: str
    delay_s: float


class Subscriber(threading.Thread):
    """Hears one kind of output until it is over, and connects again where it was."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.heard: list[Heard] = []
        self.is_over = False

    def take(self, line: bytes | str) -> None:
        record = json.loads(line)
        self.heard.append(Heard(record["id"], time.time() - datetime.fromisoformat(record["wall"]).timestamp()))

    @property
    def last(self) -> str | None:
        return self.heard[-1].id if self.heard else None

    def run(self) -> None:
        while not self.is_over:
            try:
                self.listen()
            except OSError:  # not there, or gone again
                time.sleep(0.02)

    def listen(self) -> None:
        raise NotImplementedError


class OfSocket(Subscriber):
    """Of the daemon's own socket."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path

    def listen(self) -> None:
        with socket.socket(socket.AF_UNIX) as client:
            client.settimeout(1.0)
            client.connect(str(self._path))
            client.sendall(json.dumps({"after": self.last or 0}).encode() + b"\n")
            client.settimeout(None)
            with client.makefile("rb") as lines:
                for line in lines:
                    if line.endswith(b"\n"):
                        self.take(line)


class OfHttp(Subscriber):
    """Of server-sent events."""

    def __init__(self, port: int) -> None:
        super().__init__()
        self._port = port

    def listen(self) -> None:
        with socket.create_connection(("127.0.0.1", self._port), 1.0) as client:
            client.settimeout(None)
            resume = f"Last-Event-ID: {self.last}\r\n" if self.last else ""
            path = "/v1/events" if self.last else "/v1/events?after=0"
            client.sendall(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{self._port}\r\n{resume}\r\n".encode())
            with client.makefile("rb") as lines:
                status = lines.readline()
                if b" 200 " not in status:
                    raise OSError(f"answered {status!r}")
                for line in lines:
                    if line.startswith(b"data: "):
                        self.take(line[6:])
        raise OSError("broke off")


class OfBroker(Subscriber):
    """Of the broker, which is never killed."""

    def __init__(self, port: int) -> None:
        super().__init__()
        self._client = Client(CallbackAPIVersion.VERSION2, "backend", protocol=MQTTProtocolVersion.MQTTv5)
        self._client.on_message = self._on_message
        self._client.connect("127.0.0.1", port)
        self._client.subscribe("faultline/+/events", qos=1)
        self._client.loop_start()

    def _on_message(self, _client: Client, _data: object, message: MQTTMessage) -> None:
        self.take(json.dumps(json.loads(message.payload)["data"]))

    def run(self) -> None:
        while not self.is_over:
            time.sleep(0.05)
        self._client.loop_stop()


class Chain:
    """The processes, each with a way to begin anew."""

    def __init__(self, folder: Path, speed: float) -> None:
        self.folder = folder
        self.broker = Mosquitto(folder)
        self.broker.start()
        self.port = free_port()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            bus = f"udp_multicast:239.74.163.2:{probe.getsockname()[1]}"
        sockets = f'events = "{folder}/events.sock"\ncontrol = "{folder}/control.sock"\n'
        files = {
            "run": f'source = "truck-17"\n[[bus]]\nname = "bus"\ninterface = "{bus}"\n'
            f'[[bundle]]\npath = "{GOLDEN / "bundle"}"\nbus = "bus"\n[trust]\nallow_unsigned = true\n'
            f'[events]\nsocket = "{folder}/events.sock"\n[store]\npath = "{folder}/store.sqlite"\n'
            f'[control]\nsocket = "{folder}/control.sock"\n',
            "mqtt": f'[mqtt]\nhost = "127.0.0.1"\nport = {self.broker.port}\ncursor = "{folder}/cursor"\n' + sockets,
            "serve": f'listen = "127.0.0.1:{self.port}"\n' + sockets,
        }
        for name, text in files.items():
            (folder / f"{name}.toml").write_text(text)
        self._speed = speed
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        for name in files:
            self.start(name)
        replay = [FAULTLINE, "replay", str(GOLDEN / "log"), "--bus", bus, "--speed", f"{speed:g}"]
        again = ["/bin/sh", "-c", 'while "$@"; do :; done', "replay", *replay]
        self._player = subprocess.Popen(again, start_new_session=True, stderr=subprocess.DEVNULL)

    def start(self, name: str) -> None:
        command = [FAULTLINE, name, "--config", str(self.folder / f"{name}.toml")]
        command += ["--speed", f"{self._speed:g}"] if name == "run" else []
        with (self.folder / f"{name}.log").open("ab") as log:
            self._running[name] = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=log)

    def kill(self, name: str) -> None:
        """At once, and started again."""
        self._running[name].kill()
        self._running[name].wait()
        self.start(name)

    def quiet(self) -> None:
        """Nothing is played any more."""
        os.killpg(self._player.pid, signal.SIGKILL)
        self._player.wait()

    def end(self) -> None:
        for process in self._running.values():
            process.send_signal(signal.SIGTERM)
        for process in self._running.values():
            process.wait(20)
        self.broker.stop()

    def stored(self) -> list[str]:
        """The ids in the store, in their order."""
        store = StoreFile(self.folder / "store.sqlite")
        try:
            assert store.aside is None, "the store was damaged"
            return [json.loads(record.line)["id"] for record in store.before(None, 1_000_000)]
        finally:
            store.close()


class Outcome(NamedTuple):
    """Ids in the store, and by kind of subscriber what it heard; how often each process was killed."""

    stored: list[str]
    heard: dict[str, list[Heard]]
    kills: dict[str, int]

    def missing(self, kind: str) -> int:
        """Records of the store that a subscriber never heard."""
        return len({*self.stored} - {each.id for each in self.heard[kind]})

    def unknown(self, kind: str) -> int:
        """What a subscriber heard that is not in the store."""
        return len({each.id for each in self.heard[kind]} - {*self.stored})


def killed(
    folder: Path,
    kills: int,
    seed: int,
    undisturbed_s: float = 5.0,
    records: int = 1,
    say: Callable[[str], None] = print,
) -> Outcome:
    """So many kills, each of a process drawn by chance (the daemon twice as often), at instants drawn by chance.

    After them it runs for `undisturbed_s` [s], and on until there are `records` of them: a busy machine needs longer.
    """
    chance = np.random.default_rng(seed)
    chain = Chain(folder, SPEED)
    subscribers: dict[str, Subscriber] = {
        "socket": OfSocket(folder / "events.sock"),
        "SSE": OfHttp(chain.port),
        "MQTT": OfBroker(chain.broker.port),
    }
    for each in subscribers.values():
        each.start()
    counts = {"run": 0, "mqtt": 0, "serve": 0}
    try:
        _until(lambda: all(each.heard for each in subscribers.values()), READY_S, "each subscriber hears something")
        for turn in range(kills):
            time.sleep(float(chance.uniform(0.0, 2.5)))
            name = str(chance.choice(["run", "run", "mqtt", "serve"]))
            chain.kill(name)
            counts[name] += 1
            if turn % 20 == 19:
                say(f"{turn + 1} of {kills}, {len(subscribers['socket'].heard)} heard")
        time.sleep(undisturbed_s)
        _until(lambda: len(subscribers["socket"].heard) >= records, RECORDS_S, f"{records} records")
        chain.quiet()
        last, since = subscribers["socket"].last, time.monotonic()
        while time.monotonic() - since < 5.0:  # until nothing comes any more
            if subscribers["socket"].last != last:
                last, since = subscribers["socket"].last, time.monotonic()
            time.sleep(0.1)
        _until(lambda: all(each.last == last for each in subscribers.values()), CAUGHT_UP_S, "all have caught up")
    finally:
        for each in subscribers.values():
            each.is_over = True
        chain.end()
    return Outcome(chain.stored(), {name: each.heard for name, each in subscribers.items()}, counts)


def _until(check: Callable[[], bool], seconds: float, what: str) -> None:
    end = time.monotonic() + seconds
    while not check():
        assert time.monotonic() < end, f"not within {seconds:.0f} s: {what}"
        time.sleep(0.02)

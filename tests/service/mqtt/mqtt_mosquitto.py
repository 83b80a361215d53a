"""The system's mosquitto on a port of its own, and a subscriber."""

import ctypes
import getpass
import json
import shutil
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from ports import free_port

PATIENCE_S = 20.0


class Mosquitto:
    """A broker on `port`, with `lines` for other listeners; it keeps its port and its sessions through restarts."""

    def __init__(self, folder: Path, *lines: str) -> None:
        found = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")
        if found is None:
            pytest.skip("there is no mosquitto: install the package `mosquitto`, these tests need a real broker")
        self._program, self._folder, self.port = found, folder, free_port()
        self._config = folder / f"mosquitto-{self.port}.conf"
        rows = ["per_listener_settings true", f"user {getpass.getuser()}"]
        rows += [f"listener {self.port} 127.0.0.1", "allow_anonymous true", *lines]
        rows += ["persistence true", f"persistence_location {folder}/", f"persistence_file {self.port}.db"]
        rows += ["max_inflight_messages 0", "max_queued_messages 0", "set_tcp_nodelay true"]
        rows += ["queue_qos0_messages true"]
        self._config.write_text("\n".join(rows) + "\n")
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        with (self._folder / "mosquitto.log").open("ab") as log:
            command = [self._program, "-c", str(self._config)]
            self._process = subprocess.Popen(command, stdout=log, stderr=log, preexec_fn=_ends_with_us)
        end = time.monotonic() + PATIENCE_S
        while True:
            try:
                socket.create_connection(("127.0.0.1", self.port), 1).close()
            except OSError:
                log_text = (self._folder / "mosquitto.log").read_text()
                assert self._process.poll() is None, f"mosquitto ended: {log_text}"
                assert time.monotonic() < end, "mosquitto does not listen"
                time.sleep(0.01)
            else:
                return

    def save(self) -> None:
        """Writes its sessions to the disk: a kill does not lose them."""
        assert self._process is not None
        self._process.send_signal(signal.SIGUSR1)
        end = time.monotonic() + PATIENCE_S
        while not (self._folder / f"{self.port}.db").exists():
            assert time.monotonic() < end
            time.sleep(0.01)

    def stop(self, number: int = signal.SIGTERM) -> None:
        if self._process is not None:
            self._process.send_signal(number)
            self._process.wait(PATIENCE_S)
            self._process = None

    def freeze(self) -> None:
        """It accepts connections and bytes, and does nothing."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        assert self._process is not None
        self._process.send_signal(signal.SIGCONT)


def _ends_with_us() -> None:
    """PR_SET_PDEATHSIG: a test that fails leaves nothing running."""
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)


class Message(NamedTuple):
    topic: str
    payload: bytes
    retain: bool
    content_type: str | None

    @property
    def json(self) -> Any:
        return json.loads(self.payload)


class Subscriber:
    """Hears all that is published under a filter; its session outlives its connections.

    With `qos` 0 it answers nothing: what the kernel has of a broker that was killed, it still reads.
    """

    def __init__(
        self, port: int, topics: str = "faultline/#", name: str = "backend", keeps: bool = True, qos: int = 1
    ) -> None:
        self.messages: list[Message] = []
        self._events: list[Any] = []
        self._ids: list[str] = []
        self._changed = threading.Condition()
        self._subscribed = threading.Event()
        self._client = Client(CallbackAPIVersion.VERSION2, name, protocol=MQTTProtocolVersion.MQTTv5)
        self._client.on_connect = lambda client, *_: client.subscribe(topics, qos=qos)
        self._client.on_subscribe = lambda *_: self._subscribed.set()
        self._client.on_message = self._heard
        self._client.reconnect_delay_set(1, 1)
        properties: Properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.ReceiveMaximum = 65535
        if keeps:
            properties.SessionExpiryInterval = 3600
        self._client.connect("127.0.0.1", port, clean_start=not keeps, properties=properties)
        self._client.loop_start()
        assert self._subscribed.wait(PATIENCE_S)

    def _heard(self, _client: Client, _data: object, message: MQTTMessage) -> None:
        content_type = getattr(message.properties, "ContentType", None)
        with self._changed:
            self.messages.append(Message(message.topic, bytes(message.payload), message.retain, content_type))
            if message.topic.endswith("/events"):
                self._events.append(self.messages[-1].json)
                self._ids.append(self._events[-1]["id"])
            self._changed.notify_all()

    def wait(self, what: Callable[[], bool], within_s: float = PATIENCE_S) -> None:
        with self._changed:
            assert self._changed.wait_for(what, within_s), [
                (one.topic, one.payload[:80]) for one in self.messages[-12:]
            ]

    def events(self) -> list[Any]:
        """CloudEvents, in the order in which they came."""
        return self._events

    def ids(self) -> list[str]:
        return self._ids

    def last(self, topic: str) -> Message | None:
        """The last message there."""
        return next((one for one in reversed(self.messages) if one.topic == topic), None)

    def health(self, topic: str = "faultline/truck-17/health") -> dict[str, Any]:
        """The last health; nothing in it before the first."""
        found = self.last(topic)
        return {"status": None, "conditions": None, "lost": None} if found is None else found.json

    def status(self, topic: str = "faultline/truck-17/health") -> Any:
        return self.health(topic)["status"]

    def wait_status(self, status: str, within_s: float = PATIENCE_S) -> None:
        self.wait(lambda: self.status() == status, within_s)

    def publish(self, topic: str, payload: bytes, *, retain: bool = False) -> None:
        """As somebody else who may write there."""
        self._client.publish(topic, payload, qos=1, retain=retain).wait_for_publish(PATIENCE_S)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


def retained(port: int, below: str = "faultline/") -> dict[str, bytes]:
    """What the broker retains below that topic, as whoever comes new sees it."""
    marker = "faultline/marker-of-the-test"
    late = Subscriber(port, name="late", keeps=False)
    client = Client(CallbackAPIVersion.VERSION2, "marker", protocol=MQTTProtocolVersion.MQTTv5)
    client.connect("127.0.0.1", port)
    client.loop_start()
    client.publish(marker, b"1", qos=1).wait_for_publish(PATIENCE_S)
    client.disconnect()
    client.loop_stop()
    late.wait(lambda: late.last(marker) is not None)
    late.close()
    return {one.topic: one.payload for one in late.messages if one.retain and one.topic.startswith(below)}

"""A broker that answers what a test says: as much of MQTT 5.0 as `faultline mqtt` speaks."""

import json
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

CONNECT, CONNACK, PUBLISH, PUBACK, SUBSCRIBE, SUBACK, PINGREQ, PINGRESP, DISCONNECT = 1, 2, 3, 4, 8, 9, 12, 13, 14


class Published(NamedTuple):
    connection: int
    identifier: int
    topic: str
    payload: bytes
    retain: bool

    id: str = ""
    """Of the record in it, if there is one."""


Answer = int | None
"""A reason code; None: never; one below 0: it is the connection that ends with it."""


class FakeBroker:
    """`answer` says what becomes of a publication, `connack` and `suback` are reason codes, `properties` of CONNACK."""

    def __init__(self, answer: Callable[[Published], Answer] = lambda _: 0) -> None:
        self.answer = answer
        self.connack, self.suback, self.properties = 0, 0, b""
        self.hangs_up_on_subscribe = False
        self.backwards = 1  # so many answers are held, and given the last one first
        self.published: list[Published] = []
        self.connections = 0
        self.subscriptions = 0
        self.goodbyes: list[int] = []
        self.most_unanswered = 0
        self.changed = threading.Condition()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._socks: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def events(self) -> list[str]:
        """Ids of the records that came, in order, as often as they came."""
        return [one.id for one in self.published if one.topic.endswith("/events")]

    def statuses(self) -> list[Any]:
        return [json.loads(one.payload) for one in self.published if one.topic.endswith("/health")]

    def wait(self, what: Callable[[], bool], within_s: float = 20.0) -> None:
        with self.changed:
            assert self.changed.wait_for(what, within_s), self.published[-5:]

    def hang_up(self) -> None:
        """Ends every connection."""
        for sock in self._socks:
            with suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
        self._socks.clear()

    def close(self) -> None:
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.hang_up()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                sock, _ = self._listener.accept()
                self._socks.append(sock)
                self.connections += 1
                threading.Thread(target=self._serve, args=(sock, self.connections), daemon=True).start()

    def _serve(self, sock: socket.socket, number: int) -> None:
        connection = _Connection(sock)
        with sock, sock.makefile("rb") as stream, suppress(OSError, IndexError):
            while True:
                head = stream.read(1)[0]
                content = stream.read(_length(stream.read))
                with self.changed:
                    goes_on = self._take(connection, number, head, content)
                    self.changed.notify_all()
                if not goes_on:
                    return

    def _take(self, connection: "_Connection", number: int, head: int, content: bytes) -> bool:
        """Answers a packet; whether the connection goes on."""
        kind = head >> 4
        if kind == CONNECT:
            connection.send(CONNACK, bytes([0, self.connack, len(self.properties)]) + self.properties)
        elif kind == SUBSCRIBE:
            self.subscriptions += 1
            if self.hangs_up_on_subscribe:
                return False
            connection.send(SUBACK, content[:2] + bytes([0, self.suback]))
        elif kind == PINGREQ:
            connection.send(PINGRESP, b"")
        elif kind == DISCONNECT:
            self.goodbyes.append(content[0] if content else 0)
        elif kind == PUBLISH:
            return self._take_publication(connection, _published(number, head, content))
        return True

    def _take_publication(self, connection: "_Connection", one: Published) -> bool:
        self.published.append(one)
        connection.unanswered += 1
        self.most_unanswered = max(self.most_unanswered, connection.unanswered)
        code = self.answer(one)
        if code is not None and code < 0:
            connection.send(DISCONNECT, bytes([-code]))
            return False
        if code is not None:
            connection.held.append(one.identifier.to_bytes(2, "big") + (bytes([code]) if code else b""))
        if len(connection.held) >= self.backwards or not one.topic.endswith("/events"):
            connection.unanswered -= len(connection.held)
            while connection.held:
                connection.send(PUBACK, connection.held.pop())
        return True


class _Connection:
    """What the broker knows of one: answers that it holds, and how many publications are not answered."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self.held: list[bytes] = []
        self.unanswered = 0

    def send(self, kind: int, content: bytes) -> None:
        self._sock.sendall(bytes([kind << 4, len(content)]) + content)


def _length(read: Callable[[int], bytes]) -> int:
    value = shift = 0
    while True:
        byte = read(1)[0]
        value |= (byte & 127) << shift
        if byte < 128:
            return value
        shift += 7


def _published(number: int, head: int, content: bytes) -> Published:
    size = int.from_bytes(content[:2], "big")
    topic, rest = content[2 : 2 + size].decode(), content[2 + size :]
    identifier, rest = int.from_bytes(rest[:2], "big"), rest[2:]
    payload = rest[1 + rest[0] :]
    record = str(json.loads(payload)["id"]) if topic.endswith("/events") else ""
    return Published(number, identifier, topic, payload, bool(head & 1), record)

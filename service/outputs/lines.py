"""Server of JSON lines on a Unix socket, in one selectors loop: any number of clients, none can hold it up.

A client is sent what it takes, and asked for no more than a line at a time; what is waiting for it is bounded by who
derives from this. Where all places are taken, the client that has been idle longest makes room; where none is idle, or
the process is short of descriptors, the new one is refused, and that is a condition (`conditions`).
"""

import errno
import resource
import selectors
import socket
import time
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Generic, Self, TypeVar

from faultline.service.core.records.health import Condition
from faultline.service.core.records.line import encode
from faultline.service.outputs.listening import listen
from faultline.service.protocol.errors import Rejection

CLIENTS = 32  # at most
IDLE_S = 5.0  # a client that could ask again and has not for so long is idle
RESERVED = 16  # descriptors, or a quarter, that clients leave to the rest of the process: buses, store, /proc, journal
AGAIN_S = 1.0  # where no connection can be accepted, this is tried again after so long
REFUSED_S = 10.0  # for so long after a client was refused, that is a condition
REQUEST_SIZE = 4096  # bytes of a client's line


_SHORT = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)


class Client:
    """Connection of a client: received part of a line, unsent part of a line, time of the last question."""

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self.active = time.monotonic()  # when it connected or asked last [s]
        self.request = b""
        self.rest = b""
        self.has_asked = False


C = TypeVar("C", bound=Client)


class LineServer(ABC, Generic[C]):
    """Server at a path; raises InputError if the path cannot be used, or another process serves it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._listener = listen(path, "--socket")
        self._selector: selectors.BaseSelector | None = None
        self._clients: list[C] = []
        self._accept_at = 0.0  # monotonic time before which nothing is accepted [s]
        self._refused_at = -float("inf")

    @property
    def conditions(self) -> set[Condition]:
        """Return a condition if clients were refused lately."""
        lately = time.monotonic() - self._refused_at < REFUSED_S
        return {Condition("clients-refused", str(self._path))} if lately else set()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def register(self, selector: selectors.BaseSelector) -> None:
        """Register the listening socket, and later each client's, with the loop's selector."""
        self._selector = selector
        selector.register(self._listener, selectors.EVENT_READ, self)

    def serve(self, ready: list[tuple[selectors.SelectorKey, int]]) -> None:
        """Handle the events of a `select`; keys of others are left alone."""
        if self._accept_at and time.monotonic() >= self._accept_at and self._selector is not None:
            self._accept_at = 0.0
            self._selector.register(self._listener, selectors.EVENT_READ, self)
        for key, events in ready:
            if key.data in self._clients:
                if events & selectors.EVENT_READ:
                    self._read(key.data)
                if events & selectors.EVENT_WRITE and key.data in self._clients:
                    self._flush(key.data)
        if any(key.data is self for key, _ in ready):  # last: who has asked meanwhile is not idle
            self._accept()

    def close(self) -> None:
        """Close every connection and remove the socket file."""
        for client in list(self._clients):
            self._drop(client)
        self._forget(self._listener)
        self._listener.close()
        self._path.unlink(missing_ok=True)

    @abstractmethod
    def _made(self, sock: socket.socket) -> C:
        """Return the client of a new connection."""

    @abstractmethod
    def _asked(self, client: C, line: bytes) -> None:
        """Handle a line of a client."""

    @abstractmethod
    def _next(self, client: C) -> bytes | None:
        """Return the next line for the client, None for nothing now."""

    def _is_idle(self, client: C) -> bool:
        """True if the client may make room for another: it has asked for nothing."""
        return not client.has_asked

    def _accept(self) -> None:
        try:
            sock, _ = self._listener.accept()
        except OSError as error:
            if error.errno in _SHORT and not self._make_room():
                self._pause()  # who waits would be found again at once, and the loop would turn at full speed
            return  # else it is gone again, or accepted at the next turn
        while (len(self._clients) >= CLIENTS or _is_among_the_last(sock)) and self._make_room():
            sock = _lowest(sock)  # what was freed is this one's, and the reserve is none's
        sock.setblocking(False)
        client = self._made(sock)
        if len(self._clients) >= CLIENTS or _is_among_the_last(sock):
            self._refused_at = client.active
            self._clients.append(client)
            self._refuse(client, "too many clients")
            return
        self._clients.append(client)
        if self._selector is not None:
            self._selector.register(sock, selectors.EVENT_READ, client)

    def _make_room(self) -> bool:
        """Disconnect the client that has been idle longest; False if none is."""
        idle = [each for each in self._clients if self._is_idle(each)]
        if not idle:
            return False
        self._refuse(min(idle, key=lambda each: each.active), "too many clients")
        return True

    def _pause(self) -> None:
        self._refused_at = time.monotonic()
        self._accept_at = self._refused_at + AGAIN_S
        self._forget(self._listener)

    def _read(self, client: C) -> None:
        try:
            content = client.sock.recv(REQUEST_SIZE)
        except BlockingIOError:
            return
        except OSError:
            content = b""
        if not content:
            self._drop(client)
            return
        client.request += content
        if len(client.request) > 2 * REQUEST_SIZE:
            self._refuse(client, "asks faster than it takes answers")
            return
        self._take(client)

    def _take(self, client: C) -> None:
        """Take a question of the client, if it is a whole line."""
        line, end, rest = client.request.partition(b"\n")
        if end:
            client.request, client.has_asked, client.active = rest, True, time.monotonic()
            self._asked(client, line)
        elif len(client.request) >= REQUEST_SIZE:
            self._refuse(client, "the request has no end")

    def _refuse(self, client: C, reason: str) -> None:
        client.rest += encode(Rejection(error=reason))
        self._send(client)
        self._drop(client)

    def _flush(self, client: C) -> None:
        """Send until the client takes no more or has all."""
        while client in self._clients:
            if client.rest:
                if not self._send(client):
                    return
            elif (line := self._next(client)) is not None:
                client.rest = line
            else:
                if client in self._clients and not client.rest:
                    self._want(client, selectors.EVENT_READ)
                return

    def _send(self, client: C) -> bool:
        """Send; return True if the client took all of `rest`."""
        try:
            sent = client.sock.send(client.rest)
        except BlockingIOError:
            sent = 0
        except OSError:  # the other end is gone
            self._drop(client)
            return False
        client.rest = client.rest[sent:]
        if client.rest:
            self._want(client, selectors.EVENT_READ | selectors.EVENT_WRITE)
        return not client.rest

    def _want(self, client: C, events: int) -> None:
        if self._selector is not None:
            self._selector.modify(client.sock, events, client)

    def _drop(self, client: C) -> None:
        if client in self._clients:
            self._clients.remove(client)
            self._forget(client.sock)
            client.sock.close()

    def _forget(self, sock: socket.socket) -> None:
        """Remove it from the selector, if that is still open and knows it."""
        known = self._selector.get_map() if self._selector is not None else None
        if self._selector is not None and known is not None and sock in known:
            self._selector.unregister(sock)


def _is_among_the_last(sock: socket.socket) -> bool:
    """True if the descriptor is one of those reserved for the rest of the process: the lowest is given out first."""
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return limit != resource.RLIM_INFINITY and sock.fileno() >= limit - min(RESERVED, limit // 4)


def _lowest(sock: socket.socket) -> socket.socket:
    """Return the connection under the lowest free descriptor."""
    try:
        lower = sock.dup()
    except OSError:
        return sock
    sock.close()
    return lower

"""Events over a Unix stream socket, as lines of JSON; for subscribers see docs/events.md.

One ring holds the latest events and every client has a place in it. A client that reads slowly falls behind in the ring
and is dropped when it falls out of it: memory is bounded by the ring, and no client can hold up an alarm.
"""

import os
import selectors
import socket
import stat
from collections import deque
from pathlib import Path
from types import TracebackType

import msgspec

from service.core.errors import InputError

RING = 4096  # events that a client may be behind, and that can be asked for again
CLIENTS = 32  # more are turned away
REQUEST_SIZE = 4096  # bytes of a client's one line
MODE = 0o660  # the daemon's user and group


class _Request(msgspec.Struct, forbid_unknown_fields=True):
    """A client's one line: `{}` for events from now on, `{"after": seq}` for all later than that one."""

    after: int | None = None


class _Client:
    """A connection: what it has sent so far, its place in the ring (None before its request) and what is half sent."""

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        self.request = b""
        self.place: int | None = None
        self.rest = b""


class EventSocket:
    """Serves events to any number of clients from one selectors loop, without ever blocking.

    Raises:
        InputError: the path cannot be used, or another process serves it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._listener = _listen(path)
        self._selector: selectors.BaseSelector | None = None
        self._clients: list[_Client] = []
        self._ring: deque[tuple[int, bytes]] = deque(maxlen=RING)  # (seq, line)
        self._published = 0  # events so far: place of the next one

    def __enter__(self) -> "EventSocket":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def register(self, selector: selectors.BaseSelector) -> None:
        """Puts the listening socket, and later each client's, into the loop's selector."""
        self._selector = selector
        selector.register(self._listener, selectors.EVENT_READ, self)

    def serve(self, ready: list[tuple[selectors.SelectorKey, int]]) -> None:
        """Does what a `select` found to do; keys of others are left alone."""
        for key, events in ready:
            if key.data is self:
                self._accept()
            elif isinstance(key.data, _Client) and key.data in self._clients:
                if events & selectors.EVENT_READ:
                    self._read(key.data)
                if events & selectors.EVENT_WRITE and key.data in self._clients:
                    self._flush(key.data)

    def publish(self, seq: int, line: bytes) -> None:
        """Puts a line, which is number `seq`, into the ring and sends what each client takes at once."""
        self._ring.append((seq, line))
        self._published += 1
        for client in list(self._clients):
            self._flush(client)

    def close(self) -> None:
        """Ends every connection and removes the socket file."""
        for client in list(self._clients):
            self._drop(client)
        self._forget(self._listener)
        self._listener.close()
        self._path.unlink(missing_ok=True)

    def _accept(self) -> None:
        try:
            sock, _ = self._listener.accept()
        except OSError:  # gone again, or no descriptor left: the loop must go on either way
            return
        sock.setblocking(False)
        client = _Client(sock)
        self._clients.append(client)
        if self._selector is not None:
            self._selector.register(sock, selectors.EVENT_READ, client)
        if len(self._clients) > CLIENTS:
            self._refuse(client, "too many clients")

    def _read(self, client: _Client) -> None:
        try:
            content = client.sock.recv(REQUEST_SIZE)
        except BlockingIOError:
            return
        except OSError:
            content = b""
        if not content:
            self._drop(client)
        elif client.place is None:
            client.request += content
            if b"\n" in client.request:
                self._begin(client, client.request.partition(b"\n")[0])
            elif len(client.request) >= REQUEST_SIZE:
                self._refuse(client, "the request has no end")

    def _begin(self, client: _Client, line: bytes) -> None:
        try:
            request = msgspec.json.decode(line, type=_Request)
        except (msgspec.DecodeError, msgspec.ValidationError) as error:
            self._refuse(client, str(error))
            return
        client.place = self._published if request.after is None else self._place(request.after)
        self._flush(client)

    def _place(self, after: int) -> int:
        """Place of the first event later than `after`; of the oldest where that is not from this process."""
        oldest = self._published - len(self._ring)
        if self._ring and after > self._ring[-1][0]:
            return oldest
        return oldest + sum(seq <= after for seq, _ in self._ring)

    def _refuse(self, client: _Client, reason: str) -> None:
        client.rest = msgspec.json.encode({"error": reason}) + b"\n"
        self._send(client)
        self._drop(client)

    def _flush(self, client: _Client) -> None:
        """Sends until the client takes no more or has all."""
        while client.place is not None and client in self._clients:
            behind = self._published - client.place
            if behind > len(self._ring):
                self._drop(client)  # fell out of the ring
            elif client.rest:
                if not self._send(client):
                    return
            elif behind:
                client.rest = self._ring[-behind][1]
                client.place += 1
            else:
                self._want(client, selectors.EVENT_READ)
                return

    def _send(self, client: _Client) -> bool:
        """Whether the client took all of `rest`."""
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

    def _want(self, client: _Client, events: int) -> None:
        if self._selector is not None:
            self._selector.modify(client.sock, events, client)

    def _drop(self, client: _Client) -> None:
        if client in self._clients:
            self._clients.remove(client)
            self._forget(client.sock)
            client.sock.close()

    def _forget(self, sock: socket.socket) -> None:
        """Out of the selector, if that is still open and knows it."""
        known = self._selector.get_map() if self._selector is not None else None
        if self._selector is not None and known is not None and sock in known:
            self._selector.unregister(sock)


def _listen(path: Path) -> socket.socket:
    """A listening socket at `path`; the file that a dead process left there is replaced."""
    _clear(path)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    mask = os.umask(~MODE & 0o777)
    try:
        listener.bind(str(path))
        listener.listen()
    except OSError as error:
        listener.close()
        raise InputError(f"{path}: cannot listen there: {error.strerror or error}; give another --socket") from error
    finally:
        os.umask(mask)
    listener.setblocking(False)
    return listener


def _clear(path: Path) -> None:
    try:
        if not stat.S_ISSOCK(path.stat().st_mode):
            raise InputError(f"{path}: is there already and is no socket; give another --socket")
    except FileNotFoundError:
        return
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; give another --socket") from error
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
        except OSError as error:
            raise InputError(f"{path}: {error.strerror}; give another --socket") from error
        else:
            raise InputError(f"{path}: another process serves events there; stop it or give another --socket")

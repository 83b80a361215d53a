"""Control socket: questions of other processes; see docs/control.md.

A connection asks as often as it likes, one question at a time. Who asks for live values is sent the newest when it can
take them: what lies between is left out.
"""

import os
import pwd
import selectors
import socket
import struct
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import msgspec

from faultline.service.core.records.line import encode
from faultline.service.outputs.lines import IDLE_S, Client, LineServer
from faultline.service.protocol.errors import UNREADABLE, Code, ErrorAnswer, Refusal, RefusedError
from faultline.service.protocol.questions import Question

_PEER = struct.Struct("3i")  # pid, uid, gid: unix(7), SO_PEERCRED


class Asker(NamedTuple):
    """Client's user, as the kernel says it, and whether it may erase faults."""

    user: str
    may_clear: bool


Then = Callable[[msgspec.Struct], None]
"""Takes the answer to a question."""
Live = Callable[[int], tuple[int, bytes] | None]
"""The newest tick, by its number, as a line; None where it is the one of the number given."""


class Answers(Protocol):
    """Interface of the server that answers."""

    def answer(self, question: Question, asker: Asker, then: Then) -> None:
        """Call `then` with the answer, now or from the loop later on; raises `RefusedError`."""

    def live(self, name: str | None) -> Live:
        """Return the source of a system's newest tick; raises `RefusedError`."""


class _Connection(Client):
    def __init__(self, sock: socket.socket) -> None:
        super().__init__(sock)
        self.is_waiting = False
        self.live: Live | None = None
        self.sent = -1  # number of the tick that was sent last
        uid = _PEER.unpack(sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size))[1]
        self.uid: int = uid


class ControlSocket(LineServer[_Connection]):
    """Serves `answers`; the users named in `clear`, root and our own may erase faults.

    Raises:
        InputError: the path cannot be used, or another process serves it.
    """

    def __init__(self, path: Path, clear: Sequence[str] = ()) -> None:
        super().__init__(path)
        self._clear = frozenset(clear)
        self.answers: Answers | None = None

    def serve(self, ready: list[tuple[selectors.SelectorKey, int]]) -> None:
        """Serve as any; and take what was asked while an answer was on its way."""
        super().serve(ready)
        for client in list(self._clients):
            if client.request:
                self._take(client)

    def tick(self) -> None:
        """Send new live values, if there are any."""
        for client in list(self._clients):
            if client.live is not None and not client.rest:
                self._flush(client)

    def _made(self, sock: socket.socket) -> _Connection:
        return _Connection(sock)

    def _is_idle(self, client: _Connection) -> bool:
        """True also if it asked, got its answer, and has asked nothing since for `IDLE_S`."""
        if client.is_waiting or client.live is not None or client.rest:
            return False
        return not client.has_asked or time.monotonic() - client.active > IDLE_S

    def _take(self, client: _Connection) -> None:
        """Take the next question, unless an answer is on its way: then it waits for its turn."""
        if client.live is not None:
            self._refuse(client, "live values are the last that is asked")
        while client in self._clients and not client.is_waiting and not client.rest:
            before = client.request
            super()._take(client)
            if client.request == before:
                return

    def _asked(self, client: _Connection, line: bytes) -> None:
        try:
            self._answer(client, _question(line))
        except RefusedError as refused:
            self._say(client, refusal(refused.code, refused.message))

    def _answer(self, client: _Connection, question: Question) -> None:
        if self.answers is None:
            raise RefusedError("busy", "the service is starting")
        if question.ask == "live":
            client.live = self.answers.live(question.name)
            self._flush(client)
            return
        client.is_waiting = True
        self.answers.answer(question, _asker(client.uid, self._clear), lambda answer: self._say(client, answer))

    def _say(self, client: _Connection, answer: msgspec.Struct) -> None:
        if client not in self._clients:
            return
        client.is_waiting = False
        client.rest += encode(answer)
        self._flush(client)

    def _next(self, client: _Connection) -> bytes | None:
        found = client.live(client.sent) if client.live is not None else None
        if found is None:
            return None
        client.sent = found[0]
        return found[1]

    def _refuse(self, client: _Connection, reason: str) -> None:
        code: Code = "busy" if reason == "too many clients" else "bad-request"
        client.rest += encode(refusal(code, reason))
        self._send(client)
        self._drop(client)


def refusal(code: str, message: str) -> ErrorAnswer:
    """Return the answer of a refusal."""
    return ErrorAnswer(error=Refusal(code=code, message=message))


def _question(line: bytes) -> Question:
    try:
        return msgspec.json.decode(line, type=Question)
    except UNREADABLE as error:
        raise RefusedError("bad-request", str(error)) from error


def _asker(uid: int, clear: frozenset[str]) -> Asker:
    try:
        user = pwd.getpwuid(uid).pw_name
    except (KeyError, OSError):  # the list of users cannot be read where no descriptor is left
        user = str(uid)
    return Asker(user, uid in (0, os.geteuid()) or user in clear)

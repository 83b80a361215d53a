"""The blocking client of both sockets."""

import select
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from faultline.service.core.records.line import encode
from faultline.service.protocol.connection import LONGEST, Connection
from faultline.service.protocol.errors import UNREADABLE, AwayError, ErrorAnswer, GarbledError, RefusedError
from faultline.service.protocol.live import LiveTick
from faultline.service.protocol.questions import Ask, Question
from faultline.service.protocol.records import Subscription

ANSWER_S = 10.0
"""So long an answer may take as a whole [s]: erasing waits for the disk."""
CONNECT_S = 0.05
"""Between two tries to connect where `wait_s` is given [s]."""
REMEDY = "; is the service running, with a [control] socket there?"

T = TypeVar("T")


def decode(line: bytes, kind: type[T], where: object = "") -> T:
    """Return the answer in a line.

    Raises:
        RefusedError: it is an error.
        GarbledError: it is neither, or another version's.
    """
    try:
        error = msgspec.json.decode(line, type=ErrorAnswer).error
        if error is None:
            return msgspec.json.decode(line, type=kind)
    except msgspec.ValidationError as wrong:
        remedy = "use the `faultline` of its version"
        raise GarbledError(f"answers as another version of faultline: {wrong}; {remedy}", where) from wrong
    except UNREADABLE as wrong:
        raise GarbledError(f"sent no answer: {line[:80]!r} ({wrong})", where) from wrong
    raise RefusedError(error.code, error.message, where)


class ControlClient:
    """Client of the control socket at `path`, on which an answer may take `answer_s` [s].

    Raises:
        AwayError: nobody serves there.
    """

    def __init__(self, path: Path, answer_s: float = ANSWER_S, longest: int = LONGEST) -> None:
        self._path, self._answer_s = path, answer_s
        self._came: deque[bytes] = deque()
        self._end = 0.0  # when the next line must have come [s, monotonic]
        try:
            self._connection = Connection(path, longest=longest, connect_s=answer_s)
        except AwayError as error:
            raise AwayError(f"{error.message}{REMEDY}", path) from error

    def __enter__(self) -> "ControlClient":
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def ask(self, question: Question, kind: type[T]) -> T:
        """Return the answer to a question; raises AwayError, RefusedError, GarbledError if there is none."""
        self._send(question)
        line = self._line()
        assert line is not None
        return decode(line, kind, self._path)

    def ask_json(self, ask: Ask, **fields: Any) -> dict[str, Any]:
        """Return the answer as it came, with what a newer service says besides; raises as `ask`."""
        return self.ask(Question(ask=ask, **fields), dict[str, Any])

    def live(self, name: str | None) -> Iterator[LiveTick]:
        """Yield the ticks of a system; raises as `ask`, caused by a TimeoutError if none comes for long."""
        return (tick for tick in self.live_or_silent(name, None) if isinstance(tick, LiveTick))

    def live_or_silent(self, name: str | None, silent_s: float | None) -> Iterator[LiveTick | float]:
        """Yield ticks as `live`, and `silent_s` [s] each time that none has come for so long."""
        self._send(Question(ask="live", name=name))
        while True:
            line = self._line(silent_s)
            yield silent_s or 0.0 if line is None else decode(line, LiveTick, self._path)

    @property
    def is_behind(self) -> bool:
        """True if more has come than was taken."""
        return bool(self._came) or _is_readable(self._connection, 0.0)

    def _send(self, question: Question) -> None:
        self._end = time.monotonic() + self._answer_s
        try:
            self._connection.send(encode(question))
        except AwayError as error:
            raise AwayError(f"{error.message}{REMEDY}", self._path) from error

    def _line(self, silent_s: float | None = None) -> bytes | None:
        """Return the next line, within `answer_s` of the one before; None if none came for `silent_s`."""
        if not self._came:
            until = self._end if silent_s is None else min(self._end, time.monotonic() + silent_s)
            try:
                self._came.extend(_within(self._connection, until))
            except TimeoutError as error:
                if until < self._end:
                    return None
                raise AwayError(f"no answer within {self._answer_s:g} s{REMEDY}", self._path) from error
            except AwayError as error:
                raise AwayError(f"{error.message}{REMEDY}", self._path) from error
        self._end = time.monotonic() + self._answer_s
        return self._came.popleft()


def subscribe(path: Path, after: int | str | None, wait_s: float = 0.0) -> Iterator[bytes]:
    """Yield the lines, with their ends, that the event socket at `path` sends until the service ends.

    Raises:
        AwayError: nobody serves there within `wait_s` [s].
    """
    connection = _connected(path, encode(Subscription(after)), wait_s)
    try:
        while True:
            yield from (line + b"\n" for line in _within(connection, None))
    except AwayError as error:
        if error.__cause__ is not None:  # else the service has ended; a last line without its end is no record
            raise
    finally:
        connection.close()


def _connected(path: Path, first: bytes, wait_s: float) -> Connection:
    end = time.monotonic() + wait_s
    while True:
        try:
            return Connection(path, first)
        except AwayError as error:
            absent = isinstance(error.__cause__, FileNotFoundError | ConnectionRefusedError)
            if not absent or time.monotonic() >= end:
                raise AwayError(f"{error.message}; is `faultline run --socket {path}` running?", path) from error
            time.sleep(CONNECT_S)


def _within(connection: Connection, end: float | None) -> list[bytes]:
    """Return the next lines, one at least; raises TimeoutError at the monotonic time `end` [s], AwayError as `read`."""
    while True:  # what is there is read, however late it is asked for
        if not _is_readable(connection, None if end is None else max(0.0, end - time.monotonic())):
            raise TimeoutError
        if lines := connection.read():
            return lines
        if end is not None and time.monotonic() >= end:
            raise TimeoutError


def _is_readable(connection: Connection, within_s: float | None) -> bool:
    poll = select.poll()
    poll.register(connection, select.POLLIN)
    return bool(poll.poll(None if within_s is None else 1000.0 * within_s))

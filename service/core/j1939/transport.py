"""Messages of 9 to 1785 bytes that come in parts (SAE J1939-21, transport protocol), put together by a listener.

A message to all is announced (BAM) and then sent part by part. One to a single receiver is asked for (RTS), and sent as
the receiver clears it (CTS) until it acknowledges the whole (EOM). Both are a session of one sender with one
destination; sessions of several senders interleave. The listener sends nothing, and holds no clock.

    state      event                                        next state
    none       BAM or RTS of a message that is wanted       open, the first part is expected
    open       the expected part                            open, the next one is expected; after the last: complete
    open       the part before once more, same bytes        open
    open       another part, of a BAM                       none: lost
    open       another part, else                           open, and waits for a CTS that asks for the expected one
    open       CTS for a part up to the expected one        open, that one is expected
    open       CTS for a later part, or EOM                 none: lost
    open       abort by sender or receiver                  none: aborted
    open       BAM or RTS of the same sender, destination   none: restarted; then as from none
    open       nothing for T1 (BAM) or T2                   none: timeout, or lost where a part was missed

The extended transport protocol (ETP, more than 1785 bytes) and that of CAN FD (J1939-22) are not understood.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from faultline.service.core.j1939.identifiers import FRAME, GLOBAL, TP_CM, TP_DT, identifier_of, is_addressed

PART = 7
"""Bytes of a part."""
LARGEST = 1785
"""Bytes of a message: 255 parts."""
RTS, CTS, END, BAM, ABORT = 0x10, 0x11, 0x13, 0x20, 0xFF
"""Kinds: request to send, clear to send, end of message acknowledged, broadcast announcement, connection abort."""
T1_S, T2_S = 0.75, 1.25
"""Longest time to the next part [s]: of a broadcast; and after a CTS, which the receiver may take as long to send."""
SESSIONS = 64
"""Messages that may be open at once, of 1785 bytes each."""

Loss = Literal["lost", "aborted", "restarted", "timeout", "malformed", "crowded out"]
"""Why a message was not put together: a part is missing, sender or receiver gave up, its sender began another one, no
further part came, its announcement or a part makes no sense, more than `SESSIONS` were open."""


class Whole(NamedTuple):
    """A message that is complete: its identifier, without priority, as if it had come in one frame; and its bytes."""

    identifier: int
    data: bytes


@dataclass(slots=True)
class _Session:
    """A message of which parts are missing; `expected` is the number of the next one, from 1."""

    name: str
    pgn: int
    identifier: int
    size: int
    count: int
    to_all: bool
    due: float  # latest log time of the next frame [s]
    expected: int = 1
    missed: bool = False
    data: bytearray = field(default_factory=bytearray)

    def begin(self, number: int) -> int:
        """Offset of a part."""
        return (number - 1) * PART


class Reassembler:
    """Puts together the messages that `name_of` (their identifier) names. State: at most `most` open sessions.

    `complete` counts messages by name, `losses` those that were not, by name and why. `speed`: seconds of log time a
    second, 1 on a vehicle; time-outs are of real time.
    """

    def __init__(self, name_of: Callable[[int], str | None], most: int = SESSIONS) -> None:
        """`name_of` is called once for each message that is announced; None: it is not wanted."""
        self._name_of, self._most = name_of, most
        self._open: dict[tuple[int, int], _Session] = {}  # by sender and destination
        self._now = -float("inf")
        self.speed = 1.0
        self.complete: Counter[str] = Counter()
        self.losses: Counter[tuple[str, Loss]] = Counter()

    def __len__(self) -> int:
        """Return how many messages are open."""
        return len(self._open)

    @property
    def unfinished(self) -> Counter[str]:
        """Messages by name that are open: where the log has ended, they are incomplete."""
        return Counter(session.name for session in self._open.values())

    def not_whole(self) -> list[str]:
        """Return what was not put together up to the end of a log, a phrase each; nothing where all was."""
        lost = [f"{count} {name} in parts ({why})" for (name, why), count in sorted(self.losses.items())]
        return lost + [
            f"{count} {name} in parts (cut off by the end)" for name, count in sorted(self.unfinished.items())
        ]

    def take(self, t: float, identifier: int, data: bytes) -> Whole | None:
        """Take a frame of TP.CM or TP.DT that came at log time `t` [s]; return the message that it completes.

        A time before the last one begins a new log: what is open is left incomplete.
        """
        if t < self._now:
            for key in [*self._open]:
                self._lose(key, "timeout")
        self._now = t
        source, destination, format_ = identifier & 0xFF, identifier >> 8 & 0xFF, identifier >> 16 & 0x3FF
        if format_ == TP_DT >> 8:
            return self._part((source, destination), data)
        if format_ == TP_CM >> 8 and len(data) == FRAME:
            self._control(source, destination, data)
        return None

    def _control(self, source: int, destination: int, data: bytes) -> None:
        kind, pgn = data[0], int.from_bytes(data[5:8], "little") & 0x3FFFF
        pgn = pgn & 0x3FF00 if is_addressed(pgn) else pgn
        sent, received = (source, destination), (destination, source)  # the session's key, seen from either end
        if kind in (BAM, RTS):
            self._begin(sent, kind == BAM, pgn, data)
        elif kind == CTS and self._is_of(received, pgn):
            self._clear(received, data[1], data[2])
        elif kind == END and self._is_of(received, pgn):
            self._lose(received, "lost")
        elif kind == ABORT:
            for key in (sent, received):
                if self._is_of(key, pgn):
                    self._lose(key, "aborted")

    def _begin(self, key: tuple[int, int], to_all: bool, pgn: int, data: bytes) -> None:
        before = self._open.get(key)
        if before is not None:
            is_alike = (before.pgn, before.size, before.expected) == (pgn, int.from_bytes(data[1:3], "little"), 1)
            if self._is_late(before):
                self._lose(key, "timeout")
            elif is_alike:  # announced once more: by a gateway, or as nobody has answered
                del self._open[key]
            else:
                self._lose(key, "restarted")
        name = self._name_of(identifier_of(pgn, *key))
        if name is None:
            return
        size, count = int.from_bytes(data[1:3], "little"), data[3]
        fits = PART + 1 < size <= LARGEST and count == -(-size // PART)
        if not fits or to_all != (key[1] == GLOBAL):
            self.losses[name, "malformed"] += 1
            return
        self._make_room()
        session = _Session(name, pgn, identifier_of(pgn, *key), size, count, to_all, self._now)
        self._open[key] = session
        self._wait(session)

    def _part(self, key: tuple[int, int], data: bytes) -> Whole | None:
        session = self._open.get(key)
        if session is None:
            return None
        if self._is_late(session):
            self._lose(key, "lost" if session.missed else "timeout")
            return None
        number, content = (data[0], data[1:]) if data else (0, b"")
        begin = session.begin(number)
        if 0 < number == session.expected - 1 and content[: session.size - begin] == session.data[begin:]:
            return None  # a repetition, as of a gateway
        if number != session.expected:
            session.missed = True
            if session.to_all:
                self._lose(key, "lost")
            return None
        if len(content) < min(PART, session.size - begin):
            self._lose(key, "malformed")
            return None
        session.data += content[: min(PART, session.size - begin)]
        session.expected += 1
        self._wait(session)
        if session.expected <= session.count:
            return None
        del self._open[key]
        self.complete[session.name] += 1
        return Whole(session.identifier, bytes(session.data))

    def _clear(self, key: tuple[int, int], count: int, first: int) -> None:
        """The receiver asks for `count` parts from the `first`; none: its sender has to wait."""
        session = self._open[key]
        if count and (first > session.expected or not first):
            self._lose(key, "lost")
            return
        if count:
            session.expected, session.missed = first, False
            del session.data[session.begin(first) :]
        self._wait(session)

    def _is_of(self, key: tuple[int, int], pgn: int) -> bool:
        session = self._open.get(key)
        return session is not None and session.pgn == pgn

    def _is_late(self, session: _Session) -> bool:
        return self._now > session.due

    def _wait(self, session: _Session) -> None:
        session.due = self._now + (T1_S if session.to_all else T2_S) * self.speed

    def _make_room(self) -> None:
        for key, session in [*self._open.items()]:
            if self._is_late(session):
                self._lose(key, "lost" if session.missed else "timeout")
        if len(self._open) >= self._most:
            self._lose(min(self._open, key=lambda key: self._open[key].due), "crowded out")

    def _lose(self, key: tuple[int, int], why: Loss) -> None:
        self.losses[self._open.pop(key).name, why] += 1

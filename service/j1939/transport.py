"""Messages of more than 8 bytes sent in parts, SAE J1939-21: to all (BAM), or to one that says when (RTS/CTS).

Both are senders that are asked with the time what to send now; they hold no clock. Control messages (TP.CM) begin with
their kind and end with the group that is carried; parts (TP.DT) are a number from 1 and 7 bytes, filled up with FF.
"""

from collections import Counter
from enum import IntEnum
from typing import Literal

from faultline.service.core.j1939.identifiers import GLOBAL, TP_CM, TP_DT
from faultline.service.core.j1939.transport import ABORT, BAM, CTS, END, LARGEST, PART, RTS
from faultline.service.j1939.frames import TP_PRIORITY, Message, pgn_bytes

GAP_S = 0.05
"""Between the parts of a broadcast, 50 to 200 ms."""
PACE_S = 0.01
"""Between parts for one receiver, which may come at once, 200 ms (Tr) are the most; and between two broadcasts."""
T3_S, T4_S = 1.25, 1.05
"""How long a receiver may take to answer: what it was sent; and to go on, once it has asked to wait."""
RETRIES = 2  # that any part may be asked for again
LONGEST_S = 30.0  # in which a message is over, however often its receiver asks to wait


class Reason(IntEnum):
    """Why a connection is aborted."""

    RESOURCES = 2
    TIMEOUT = 3
    CLEARED_WHILE_SENDING = 4
    RETRIES = 5
    BAD_SEQUENCE = 7


class Parts:
    """A message of 9 to 1785 bytes, cut.

    Raises:
        ValueError: it is shorter or longer.
    """

    def __init__(self, pgn: int, payload: bytes, destination: int) -> None:
        if not 8 < len(payload) <= LARGEST:
            raise ValueError(f"{len(payload)} bytes do not go in parts: 9 to {LARGEST} do")
        self.pgn, self.destination = pgn, destination
        self._payload = payload
        self.count = -(-len(payload) // PART)

    def part(self, number: int) -> Message:
        """The `number`th part, from 1."""
        content = self._payload[(number - 1) * PART : number * PART].ljust(PART, b"\xff")
        return Message(TP_DT, bytes([number]) + content, self.destination, TP_PRIORITY)

    def announced(self, kind: int) -> Message:
        """Size, number of parts, and that as many may be asked for at once as there are."""
        size = len(self._payload).to_bytes(2, "little")
        return control(self.pgn, self.destination, bytes([kind]) + size + bytes([self.count, 0xFF]))


def control(pgn: int, destination: int, begin: bytes) -> Message:
    """A control message of the five bytes that it begins with."""
    return Message(TP_CM, begin + pgn_bytes(pgn), destination, TP_PRIORITY)


def aborted(pgn: int, destination: int, reason: Reason) -> Message:
    """What ends a connection before its time."""
    return control(pgn, destination, bytes([ABORT, reason, 0xFF, 0xFF, 0xFF]))


class Broadcast:
    """Sends to all, a part each `GAP_S`, counted from when the one before was asked for: never closer."""

    def __init__(self, pgn: int, payload: bytes, now: float) -> None:
        self._parts = Parts(pgn, payload, GLOBAL)
        self.pgn = pgn
        self._next = 0  # 0: the announcement
        self.due = now

    @property
    def done(self) -> bool:
        """Whether all was sent; another one may begin at `due`."""
        return self._next > self._parts.count

    def poll(self, now: float) -> list[Message]:
        """What is to be sent now."""
        if self.done or now < self.due:
            return []
        number, self._next = self._next, self._next + 1
        self.due = now + (PACE_S if self.done else GAP_S)
        return [self._parts.part(number) if number else self._parts.announced(BAM)]


class Connection:
    """Sends to one receiver, as it asks; ends with its acknowledgement, an abort of either side, or in time."""

    def __init__(self, pgn: int, payload: bytes, destination: int, now: float) -> None:
        self._parts = Parts(pgn, payload, destination)
        self.pgn, self.destination = pgn, destination
        self._phase: Literal["asking", "waiting", "sending", "done"] = "asking"
        self._next = self._last = self._highest = 0
        self._again: Counter[int] = Counter()
        self._until, self._end = now, now + LONGEST_S
        self._out: list[Message] = []

    @property
    def done(self) -> bool:
        """Whether nothing is to be sent any more."""
        return self._phase == "done" and not self._out

    @property
    def due(self) -> float:
        """When it is to be asked again [s]."""
        return 0.0 if self._out else min(self._until, self._end)

    def poll(self, now: float) -> list[Message]:
        """What is to be sent now."""
        if self._phase != "done" and now >= self._end:
            self._abort(Reason.TIMEOUT)
        elif self._phase != "done" and now >= self._until:
            self._step(now)
        out, self._out = self._out, []
        return out

    def _step(self, now: float) -> None:
        if self._phase == "asking":
            self._out.append(self._parts.announced(RTS))
            self._wait(now, T3_S)
        elif self._phase == "sending":
            self._out.append(self._parts.part(self._next))
            self._highest = max(self._highest, self._next)
            self._next += 1
            self._until = now + PACE_S
            if self._next > self._last:
                self._wait(now, T3_S)
        else:
            self._abort(Reason.TIMEOUT)

    def hear(self, data: bytes, now: float) -> None:
        """Takes a control message of the receiver about this group."""
        if self._phase in ("asking", "done"):  # about another connection than this
            return
        if data[0] in (END, ABORT):
            self._phase = "done"
        elif data[0] == CTS and self._phase == "sending":
            self._abort(Reason.CLEARED_WHILE_SENDING)
        elif data[0] == CTS:
            self._cleared(data[1], data[2], now)

    def _cleared(self, count: int, first: int, now: float) -> None:
        """`count` parts from `first` on are asked for; none: to wait."""
        if not count:
            self._wait(now, T4_S)
            return
        if not 1 <= first <= self._parts.count:
            self._abort(Reason.BAD_SEQUENCE)
            return
        if first <= self._highest:
            self._again[first] += 1
            if self._again[first] > RETRIES:
                self._abort(Reason.RETRIES)
                return
        self._next, self._last = first, min(first + count - 1, self._parts.count)
        self._phase, self._until = "sending", now

    def _wait(self, now: float, seconds: float) -> None:
        self._phase, self._until = "waiting", now + seconds

    def _abort(self, reason: Reason) -> None:
        self._phase = "done"
        self._out.append(aborted(self.pgn, self.destination, reason))

"""Outgoing records: waiting, in flight, and how far the broker has acknowledged.

Records go in order. The place moves over a record once all that was published of it, and of every record before it, is
acknowledged, in whatever order the acknowledgements come. After a broken connection, or a refusal, what lies behind the
place is sent again.
"""

from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

import msgspec

from faultline.service.protocol.records import Record

IN_FLIGHT = 20
"""Publications that the broker has not acknowledged, at most."""
WINDOW = 100
"""Records that are read ahead, at most; those of one read more."""
WINDOW_BYTES = 1 << 20
"""The same in bytes."""


class Publication(msgspec.Struct, frozen=True, kw_only=True):
    """Message to publish, QoS 1. `of` names it for a person; an empty retained one erases what is there."""

    topic: str
    payload: bytes
    of: str
    content_type: str = "application/json"
    retain: bool = False

    @property
    def size(self) -> int:
        """Return an upper bound of its packet's bytes (MQTT 5.0, 3.3): 32 for header, lengths, property names."""
        return len(self.topic) + len(self.payload) + len(self.content_type) + 32


class Passed(msgspec.Struct, frozen=True):
    """A record that is done: acknowledged, or given up."""

    record: Record
    given_up: bool


class _Flying(NamedTuple):
    """Publication in flight: since when [s], and of which record; of none if it is sent again anyway."""

    at: float
    publication: Publication
    of: "_Sent | None"


class _Sent:
    """A record that was published in parts, or is about to be."""

    def __init__(self, record: Record, parts: Sequence[Publication]) -> None:
        self.record = record
        self.waiting = deque(parts)  # not sent yet
        self.unanswered = len(parts)
        self.given_up = False


class Outbox:
    """Records between the daemon and the broker, and what else is in flight, each by the link's identifier."""

    def __init__(self) -> None:
        self._records: deque[Record] = deque()
        self._bytes = 0
        self._sent: deque[_Sent] = deque()  # the oldest first; of the last one parts may wait
        self._flight: dict[int, _Flying] = {}

    @property
    def has_room(self) -> bool:
        """Return True if more records are to be read."""
        return len(self._records) + len(self._sent) < WINDOW and self._bytes < WINDOW_BYTES

    @property
    def in_flight(self) -> int:
        """Return the number of unacknowledged publications."""
        return len(self._flight)

    @property
    def oldest(self) -> float | None:
        """Return when the oldest of them was sent [s]; None if there is none."""
        return next((flying.at for flying in self._flight.values()), None)

    @property
    def only(self) -> int | None:
        """Return the identifier in flight if there is exactly one; else None."""
        return next(iter(self._flight)) if len(self._flight) == 1 else None

    def add(self, record: Record) -> None:
        """Append a record."""
        self._records.append(record)
        self._bytes += len(record.line)

    def next_part(self, parts_of: Callable[[Record], Sequence[Publication]]) -> Publication | None:
        """Return the next publication, None if there is none; `parts_of` is called as late as that.

        Whoever takes it calls `sent` or `give_up` before he asks again.
        """
        if (not self._sent or not self._sent[-1].waiting) and self._records:
            record = self._records.popleft()
            self._sent.append(_Sent(record, parts_of(record)))
        return self._sent[-1].waiting[0] if self._sent and self._sent[-1].waiting else None

    def sent(self, identifier: int, now: float) -> None:
        """Note that the publication of `next_part` is in flight."""
        record = self._sent[-1]
        self._flight[identifier] = _Flying(now, record.waiting.popleft(), record)

    def sent_besides(self, identifier: int, publication: Publication, now: float) -> None:
        """Note a publication in flight that is no part of a record."""
        self._flight[identifier] = _Flying(now, publication, None)

    def give_up_next(self) -> list[Passed]:
        """Give up the publication of `next_part`."""
        record = self._sent[-1]
        return self._done(record, record.waiting.popleft(), given_up=True)

    def find(self, identifier: int) -> tuple[Publication | None, bool]:
        """Return the publication with that identifier, and whether a record waits for its answer."""
        flying = self._flight.get(identifier)
        return (None, False) if flying is None else (flying.publication, flying.of is not None)

    def answered(self, identifier: int, *, given_up: bool = False) -> list[Passed]:
        """Handle an acknowledgement, or giving up; return the records that are done, oldest first."""
        flying = self._flight.pop(identifier, None)
        if flying is None or flying.of is None:
            return []
        return self._done(flying.of, flying.publication, given_up=given_up)

    def refused(self, identifier: int) -> None:
        """Handle a refusal that may be temporary: it is sent again, and all that comes after it."""
        self._flight.pop(identifier, None)
        self.again()

    def again(self) -> None:
        """Sends all records again that are not done, in order; what is in flight stays there until it is answered."""
        self._records.extendleft(sent.record for sent in reversed(self._sent))
        self._sent.clear()
        self._flight = {identifier: flying._replace(of=None) for identifier, flying in self._flight.items()}

    def disconnected(self) -> None:
        """Send all records again, with nothing in flight any more."""
        self.again()
        self._flight.clear()

    def _done(self, sent: _Sent, part: Publication, *, given_up: bool) -> list[Passed]:
        sent.unanswered -= 1
        sent.given_up |= given_up and not part.retain  # a state that nobody takes is no record that is lost
        passed = []
        while self._sent and self._sent[0].unanswered == 0:
            first = self._sent.popleft()
            self._bytes -= len(first.record.line)
            passed.append(Passed(first.record, first.given_up))
        return passed

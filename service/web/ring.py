"""Ring of the latest records, and the place of every client in it: pure.

As in `service.outputs.socket`, memory is bounded by the ring and not by how slowly clients read.
"""

import re
from collections import deque
from collections.abc import Sequence
from itertools import islice

from faultline.service.protocol.records import Record, RecordError, read

SIZE = 4096  # as many as the daemon has at hand

_SCHEMA = re.compile(r"faultline\.[a-z]+/[0-9]+")
_ID = re.compile(r"[!-~]{1,200}")


def told(line: bytes) -> Record:
    """Return the record in a line, if it can be an event of a stream; raises `RecordError`.

    Its schema names the event, its id stands in a line of the stream, and so does all of it.
    """
    record = read(line)
    if not _SCHEMA.fullmatch(record.schema) or not _ID.fullmatch(record.id):
        raise RecordError(f"no event of a stream can have the schema {record.schema!r} and the id {record.id!r}")
    if b"\n" in record.line or b"\r" in record.line:
        raise RecordError("more than one line")
    return record


class Ring:
    """Latest `size` records. Places count all that ever were; `end` is the place of the next."""

    def __init__(self, size: int = SIZE) -> None:
        self._held: deque[Record] = deque()
        self._places: dict[str, int] = {}
        self._size = size
        self.end = 0

    @property
    def last(self) -> str | None:
        """Return the id of the latest, None before the first."""
        return self._held[-1].id if self._held else None

    @property
    def newest(self) -> int:
        """Return the number of the latest, 0 before the first."""
        return self._held[-1].seq if self._held else 0

    def add(self, record: Record) -> bool:
        """Append it; return False if it is here already: delivery is at least once."""
        if record.id in self._places:
            return False
        self._held.append(record)
        self._places[record.id] = self.end
        self.end += 1
        if len(self._held) > self._size:
            del self._places[self._held.popleft().id]
        return True

    def where(self, id_: str) -> int | None:
        """Return the place of the record with that id; None if it is not here."""
        return self._places.get(id_)

    def after(self, seq: int) -> int | None:
        """Return the place after the record of that number; None if some that followed it are not here."""
        if not self._held or not self._held[0].seq - 1 <= seq <= self._held[-1].seq:
            return None
        return self.beyond(seq)

    def beyond(self, seq: int) -> int:
        """Return the place of the first that has a larger number."""
        return self.end - sum(each.seq > seq for each in self._held)

    @property
    def oldest(self) -> int:
        """Return the place of the oldest."""
        return self.end - len(self._held)

    def since(self, place: int, count: int) -> Sequence[Record] | None:
        """Return at most `count` records from that place on; None if some of them are gone."""
        skipped = place - self.oldest
        return None if skipped < 0 else [*islice(self._held, skipped, skipped + count)]

"""The latest records, and the place of every client among them: pure.

As in `service.outputs.socket`, memory is bounded by the ring and not by how slowly clients read.
"""

from collections import deque
from collections.abc import Sequence
from itertools import islice
from typing import Annotated, NamedTuple

import msgspec
from msgspec import Meta

SIZE = 4096  # as many as the daemon has at hand


class Told(NamedTuple):
    """A record: its id, its number, its kind (event, health, fault, cleared) and the line without its newline."""

    id: str
    seq: int
    kind: str
    line: bytes


class _Header(msgspec.Struct, frozen=True):
    """What every record begins with. An id stands in a line of a stream: nothing that means something there."""

    schema: Annotated[str, Meta(pattern=r"\Afaultline\.[a-z]+/[0-9]+\Z")]
    id: Annotated[str, Meta(pattern=r"\A[!-~]+\Z", max_length=200)]
    seq: int


def told(line: bytes) -> Told:
    """The record in a line; raises `msgspec.MsgspecError` or `ValueError` where there is none."""
    header = msgspec.json.decode(line, type=_Header)
    kind = header.schema.removeprefix("faultline.").partition("/")[0]
    whole = line.rstrip(b"\r\n")
    if b"\n" in whole or b"\r" in whole:
        raise ValueError("more than one line")
    return Told(header.id, header.seq, kind, whole)


class Ring:
    """The latest `size` records. Places count all that ever were; `end` is the place of the next."""

    def __init__(self, size: int = SIZE) -> None:
        self._held: deque[Told] = deque()
        self._places: dict[str, int] = {}
        self._size = size
        self.end = 0

    @property
    def last(self) -> str | None:
        """The id of the latest, None before the first."""
        return self._held[-1].id if self._held else None

    @property
    def newest(self) -> int:
        """The number of the latest, 0 before the first."""
        return self._held[-1].seq if self._held else 0

    def add(self, record: Told) -> bool:
        """Puts it at the end; whether it is new: delivery is at least once, and what is here already stays."""
        if record.id in self._places:
            return False
        self._held.append(record)
        self._places[record.id] = self.end
        self.end += 1
        if len(self._held) > self._size:
            del self._places[self._held.popleft().id]
        return True

    def where(self, id_: str) -> int | None:
        """The place of the record with that id; None where it is not here."""
        return self._places.get(id_)

    def after(self, seq: int) -> int | None:
        """The place after the record of that number; None where some that followed it are not here."""
        if not self._held or not self._held[0].seq - 1 <= seq <= self._held[-1].seq:
            return None
        return self.beyond(seq)

    def beyond(self, seq: int) -> int:
        """The place of the first that has a larger number."""
        return self.end - sum(each.seq > seq for each in self._held)

    @property
    def oldest(self) -> int:
        """The place of the oldest."""
        return self.end - len(self._held)

    def since(self, place: int, count: int) -> Sequence[Told] | None:
        """At most `count` records from that place on; None where some of them are gone."""
        skipped = place - self.oldest
        return None if skipped < 0 else [*islice(self._held, skipped, skipped + count)]

"""Numbers and times of records; all records of a run are one sequence."""

import secrets
from collections.abc import Callable
from datetime import UTC, datetime

import msgspec

from faultline.service.core.records.event import Event


class Sequencer:
    """Ids are `source`, the vehicle's name, eight digits drawn for this run, and a number, which goes on from `last`.

    No id is used twice, whatever becomes of the store.
    """

    def __init__(
        self, source: str, last: int, run: str | None = None, wall: Callable[[], str | None] | None = None
    ) -> None:
        """`wall` gives the wall clock (RFC 3339), None where nobody knows it."""
        self.source, self.last = source, last
        self._wall = now if wall is None else wall
        run = secrets.token_hex(4) if run is None else run
        self._prefix = f"{source}-{run}" if run else source

    def next(self) -> tuple[str, int, str | None]:
        """Return id, number and wall clock (RFC 3339) of the next record."""
        self.last += 1
        return f"{self._prefix}-{self.last}", self.last, self._wall()

    def event(self, event: Event) -> Event:
        """Return the event, numbered and dated."""
        named, seq, wall = self.next()
        return msgspec.structs.replace(event, id=named, seq=seq, wall=wall)


def now() -> str:
    """Return the wall clock (RFC 3339)."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")

"""Progress, saved periodically: after a kill a few records are sent twice, and the disk is not worn by each."""

from collections.abc import Collection, Iterable

from faultline.service.mqtt.cursor import Cursor, CursorFile
from faultline.service.mqtt.outbox import Passed
from faultline.service.mqtt.throttled import Say

KEPT_S = 0.5
"""Between two writes at least."""
RETRY_S = 5.0
"""After one that failed."""


class Progress:
    """Progress: the last record that is done, the number of lost ones, and what of that is saved."""

    def __init__(self, file: CursorFile, kept: Cursor, say: Say) -> None:
        self._file, self._kept, self._say = file, kept, say
        self._id, self._seq, self.lost = kept.id, kept.seq, kept.lost
        self._next = float("-inf")

    def passed(self, records: Iterable[Passed]) -> None:
        """Note records that are done, in order."""
        for each in records:
            self._id, self._seq = each.record.id, each.record.seq
            self.lost += each.record.lost + each.given_up

    def keep(self, vehicle: str | None, faults: Collection[int], now: float) -> float | None:
        """Save what is new, if it is time; return when it will be, None if nothing is new."""
        cursor = Cursor(id=self._id, seq=self._seq, lost=self.lost, vehicle=vehicle, faults=sorted(faults))
        if cursor == self._kept:
            return None
        if now >= self._next:
            self._write(cursor, now)
        return self._next

    def _write(self, cursor: Cursor, now: float) -> None:
        try:
            self._file.save(cursor)
        except OSError as error:
            self._say(f"how far it is cannot be kept: {error.strerror or error}; after a restart records come twice")
            self._next = now + RETRY_S
        else:
            self._kept = cursor
            self._next = now + KEPT_S

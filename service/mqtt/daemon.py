"""The records of the daemon, in order, with the number of those that are missing between them."""

from pathlib import Path

import msgspec

from faultline.service.core.records.line import encode
from faultline.service.mqtt.throttled import Say
from faultline.service.protocol.backoff import Backoff
from faultline.service.protocol.reconnecting import Reconnecting
from faultline.service.protocol.records import Record, RecordError, Subscription, read

RETRY_S = 0.5, 5.0
"""Between two tries to connect: at first, and at most."""
SHOWN = 120
"""Bytes that are shown of a line that is no record."""
LONGEST = 1 << 20
"""Bytes of a line; a longer one is left out, and its number is missing then."""


class Daemon(Reconnecting):
    """Reads records after the one with that `identifier` and number `seq` (None, 0: from the oldest there is)."""

    def __init__(self, path: Path, identifier: str | None, seq: int, say: Say) -> None:
        super().__init__(path, Backoff(*RETRY_S), self._subscription, LONGEST)
        self._id, self._seq, self._say = identifier, seq, say

    def turn(self, now: float) -> list[Record]:
        """Connect where that is due; return what has come, no more than one chunk."""
        connections, failures = self.connections, self.failures
        lines = self.take(now)
        if self.connections != connections:
            self._say(f"connected to the daemon, after {self._id or 'nothing'}")
        if self.failures != failures:
            self._say(f"the daemon is away: {self.why}; looking for it")
        records = [record for line in lines if (record := self._record(line)) is not None]
        if records:
            self.retry.well()
        return records

    def _subscription(self) -> bytes:
        return encode(Subscription(self._id if self._id is not None else 0))

    def _record(self, line: bytes) -> Record | None:
        """Return the record with the number of those missing before it; None if it is none, or was read before."""
        try:
            record = read(line, self.connections)
        except RecordError as error:
            self._say(f"{self._path}: sent what is no record: {line[:SHOWN]!r} ({error})", "no record")
            return None
        if record.id == self._id:
            return None
        missing = record.seq - self._seq - 1
        if self._id is not None and missing > 0:
            self._say(f"the daemon no longer holds {missing} records before {record.id}: they are lost", "gap")
        elif missing < 0:
            self._say(
                f"the daemon does not know {self._id} and begins with {record.id}: records may come twice", "anew"
            )
        lost = max(missing, 0) if self._id is not None else 0
        self._id, self._seq = record.id, record.seq
        return msgspec.structs.replace(record, lost=lost)

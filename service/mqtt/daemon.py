"""The daemon as we know it: its records in order, with what is missing between them; away, and back."""

import selectors
from pathlib import Path

import msgspec

from faultline.service.mqtt.patience import Backoff, Say
from faultline.service.mqtt.records import Record, RecordError, read
from faultline.service.mqtt.stream import Stream, StreamError

RETRY_S = 0.5, 5.0
"""Between two tries to connect: at first, and at most."""
SHOWN = 120
"""Bytes that are shown of a line that is no record."""


class Daemon:
    """Reads records after the one with that `identifier` and number `seq` (None, 0: from the oldest there is)."""

    def __init__(self, path: Path, identifier: str | None, seq: int, say: Say) -> None:
        self._path, self._say = path, say
        self._id, self._seq = identifier, seq
        self._stream: Stream | None = None
        self._retry = Backoff(*RETRY_S)
        self.epoch = 0
        """How often it was connected."""

    @property
    def is_there(self) -> bool:
        """Whether it is connected."""
        return self._stream is not None

    @property
    def retry_at(self) -> float:
        """When the next try to connect is due [s]."""
        return self._retry.at

    def register(self, selector: selectors.BaseSelector) -> None:
        """Puts the connection, if there is one, into the loop's selector for one turn."""
        if self._stream is not None:
            selector.register(self._stream, selectors.EVENT_READ)

    def turn(self, now: float) -> list[Record]:
        """Connects where that is due, and gives what has come."""
        if self._stream is None and now >= self._retry.at:
            self._connect(now)
        if self._stream is None:
            return []
        try:
            lines = self._stream.read()
        except StreamError as error:
            self.close()
            self._away(error, now)
            return []
        records = [record for line in lines if (record := self._record(line)) is not None]
        if records:
            self._retry.well()
        return records

    def close(self) -> None:
        """Ends the connection."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def _connect(self, now: float) -> None:
        try:
            self._stream = Stream(self._path, self._id if self._id is not None else 0)
        except StreamError as error:
            self._away(error, now)
        else:
            self.epoch += 1
            self._retry.failed(now)  # until a record comes: who is sent away at once must not come back at once
            self._say(f"connected to the daemon, after {self._id or 'nothing'}")

    def _away(self, error: StreamError, now: float) -> None:
        self._say(f"the daemon is away: {error}; looking for it")
        self._retry.failed(now)

    def _record(self, line: bytes) -> Record | None:
        """The record, which knows how many are missing before it; None where the line is none, or was read before."""
        try:
            record = read(line, self.epoch)
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

"""Connection with automatic reconnection, for a loop that waits for nothing but its selector."""

from collections.abc import Callable
from pathlib import Path

from faultline.service.protocol.backoff import Backoff
from faultline.service.protocol.connection import LONGEST, Connection
from faultline.service.protocol.errors import AwayError


class Reconnecting:
    """Lines of the socket at `path`; `first` gives what is sent on each new connection, and `retry` when to try again.

    `connections` counts them, `failures` those that were lost or could not be made. `why` says why there is none, ""
    while there is one, or before the first try. Who is content with what came calls `retry.well()`.
    """

    def __init__(self, path: Path, retry: Backoff, first: Callable[[], bytes] = bytes, longest: int = LONGEST) -> None:
        self._path, self._first, self._longest = path, first, longest
        self.retry = retry
        self._connection: Connection | None = None
        self.connections = self.failures = 0
        self.why = ""

    @property
    def is_connected(self) -> bool:
        """True while somebody serves there."""
        return self._connection is not None

    def fileno(self) -> int:
        """Return the descriptor; -1 while there is no connection."""
        return -1 if self._connection is None else self._connection.fileno()

    @property
    def due(self) -> float | None:
        """Return when the next try is due [s]; None while there is a connection."""
        return self.retry.at if self._connection is None else None

    def take(self, now: float) -> list[bytes]:
        """Connect where that is due; return the lines of one chunk of what has come."""
        try:
            if self._connection is None and now >= self.retry.at:
                self._connection = Connection(self._path, self._first(), self._longest)
                self.connections += 1
                self.why = ""
                self.retry.failed(now)  # until `retry.well()`: who is sent away at once must not come back at once
            return [] if self._connection is None else self._connection.read()
        except AwayError as error:
            self._lost(error, now)
            return []

    def send(self, line: bytes, now: float) -> bool:
        """True if the line was taken; who does not take one at once is lost."""
        if self._connection is None:
            return False
        try:
            self._connection.send(line)
        except AwayError as error:
            self._lost(error, now)
        return self._connection is not None

    def drop(self, now: float) -> None:
        """End the connection; another one is made soon."""
        self.close()
        self.retry.failed(now)

    def close(self) -> None:
        """End it for good."""
        if self._connection is not None:
            self._connection.close()
        self._connection = None

    def _lost(self, error: AwayError, now: float) -> None:
        self.drop(now)
        self.failures += 1
        self.why = str(error)

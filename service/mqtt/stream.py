"""The daemon's events socket, as a subscriber that reads no more than it can pass on; source: docs/events.md."""

import socket
from pathlib import Path

import msgspec

CHUNK = 1 << 16
"""Bytes read at once."""
LONGEST = 1 << 20
"""Bytes of a line; a longer one is left out, and its number is missing then."""


class StreamError(Exception):
    """The daemon is not there, or has gone: why, in one line."""


class Stream:
    """A connection that asks for all records after one: an id, or 0 for all there are.

    Raises:
        StreamError: nobody serves there.
    """

    def __init__(self, path: Path, after: str | int) -> None:
        self._path = path
        self._rest = b""
        self._skipping = False  # in the middle of a line that is too long
        self._sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._sock.setblocking(False)
            self._sock.connect(str(path))
            self._sock.sendall(msgspec.json.encode({"after": after}) + b"\n")  # fits into an empty buffer
        except OSError as error:
            self._sock.close()
            remedy = ", only its group may connect" if isinstance(error, PermissionError) else ""
            raise StreamError(f"{path}: {error.strerror or error}{remedy}") from error

    def fileno(self) -> int:
        """For a selector."""
        return self._sock.fileno()

    def read(self) -> list[bytes]:
        """The lines that have come whole since the last call, as many as are in one chunk.

        Raises:
            StreamError: the daemon has gone.
        """
        try:
            content = self._sock.recv(CHUNK)
        except BlockingIOError:
            return []
        except OSError as error:
            raise StreamError(f"{self._path}: {error.strerror or error}") from error
        if not content:
            raise StreamError(f"{self._path}: the daemon has ended the connection")
        *lines, self._rest = (self._rest + content).split(b"\n")
        if self._skipping and lines:
            del lines[0]
            self._skipping = False
        if len(self._rest) > LONGEST:
            self._rest, self._skipping = b"", True
        return lines

    def close(self) -> None:
        """Ends it; a line without its end is no record."""
        self._sock.close()

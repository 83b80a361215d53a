"""Non-blocking connection to a Unix stream socket that carries lines."""

import socket
from pathlib import Path

from faultline.service.protocol.errors import AwayError

CHUNK = 1 << 16
"""Bytes read at once."""
LONGEST = 16 << 20
"""Bytes of a line: 500 records, or the freeze frames of a fault, are one."""


class Connection:
    """Connection to `path`, on which `first` was sent.

    A line of more than `longest` bytes is left out and not kept. Where the service is slow to accept, connecting takes
    `connect_s` [s] at most.

    Raises:
        AwayError: nobody serves there.
    """

    def __init__(self, path: Path, first: bytes = b"", longest: int = LONGEST, connect_s: float = 0.0) -> None:
        self._path, self._longest = path, longest
        self._rest: list[bytes] = []  # of a line that has no end yet
        self._size = 0
        self._is_skipping = False  # in the middle of a line that is too long
        self._sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._sock.settimeout(connect_s)
            self._sock.connect(str(path))
            self._sock.setblocking(False)
            if first:
                self._sock.sendall(first)  # fits into an empty buffer
        except OSError as error:
            self._sock.close()
            remedy = ", only its group may connect" if isinstance(error, PermissionError) else ""
            raise AwayError(f"{error.strerror or error}{remedy}", path) from error

    def fileno(self) -> int:
        """Return the descriptor, readable when lines may have come."""
        return self._sock.fileno()

    def send(self, line: bytes) -> None:
        """Send a line; raises AwayError where it is not taken whole at once."""
        try:
            self._sock.sendall(line)
        except OSError as error:
            raise AwayError(error.strerror or str(error), self._path) from error

    def read(self) -> list[bytes]:
        """Return the lines, without their ends, that are complete since the last call: as many as are in one chunk.

        Raises:
            AwayError: the other end has gone; a line without its end is none.
        """
        try:
            content = self._sock.recv(CHUNK)
        except BlockingIOError:
            return []
        except OSError as error:
            raise AwayError(error.strerror or str(error), self._path) from error
        if not content:
            raise AwayError("it broke off" if self._rest else "the service has ended the connection", self._path)
        first, *others = content.split(b"\n")
        if not others:
            self._keep(first)
            return []
        lines = [] if self._is_skipping else [b"".join([*self._rest, first])]
        self._rest, self._size, self._is_skipping = [], 0, False
        self._keep(others.pop())
        return lines + others

    def close(self) -> None:
        """Close it."""
        self._sock.close()

    def _keep(self, part: bytes) -> None:
        if part and not self._is_skipping:
            self._rest.append(part)
            self._size += len(part)
        if self._size > self._longest:
            self._rest, self._size, self._is_skipping = [], 0, True

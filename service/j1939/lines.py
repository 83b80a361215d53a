"""A connection to a Unix stream socket on which lines come; made again after it is lost, and never waited for."""

import socket
from pathlib import Path

RETRY_S = 0.5
LARGEST = 8 * 1024 * 1024
"""Bytes of a line: more is no answer of the service's."""
_CHUNK = 65_536


class Lines:
    """Asked for what came; `hello` is sent on each new connection."""

    def __init__(self, path: Path, hello: bytes = b"") -> None:
        self._path, self._hello = path, hello
        self._socket: socket.socket | None = None
        self._rest = b""
        self._due = 0.0
        self.connections = 0  # so far
        self.is_gone = False
        """Nobody serves there, as the last try or the end of a connection has shown."""

    @property
    def is_connected(self) -> bool:
        """Whether somebody serves there."""
        return self._socket is not None

    def fileno(self) -> int:
        """Readable when lines may have come; -1 while there is nobody."""
        return -1 if self._socket is None else self._socket.fileno()

    @property
    def due(self) -> float | None:
        """When it is tried again [s]."""
        return None if self._socket is not None else self._due

    def take(self, now: float) -> list[bytes]:
        """The whole lines that have come; connects where that is due."""
        if self._socket is None and now >= self._due:
            self._connect(now)
        content, ended = self._rest, False
        while self._socket is not None and not ended:
            try:
                chunk = self._socket.recv(_CHUNK)
            except BlockingIOError:
                break
            except OSError:  # the other end is gone, as with no bytes
                chunk = b""
            content += chunk
            ended = not chunk or len(content) > LARGEST
        *lines, self._rest = content.split(b"\n")
        if ended:
            self.drop(now)
            self.is_gone = True
        return lines

    def send(self, line: bytes, now: float) -> bool:
        """Whether it was taken; who does not take a line at once is lost."""
        if self._socket is None:
            return False
        try:
            sent = self._socket.send(line)
        except OSError:
            sent = 0
        if sent < len(line):
            self.drop(now)
        return sent == len(line)

    def drop(self, now: float) -> None:
        """Ends the connection; another one is made soon."""
        self.close()
        self._rest = b""
        self._due = now + RETRY_S

    def close(self) -> None:
        """Ends it for good."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def _connect(self, now: float) -> None:
        self._due = now + RETRY_S
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        sock.setblocking(False)
        try:
            sock.connect(str(self._path))
        except OSError:  # nobody serves there: that is told by who wants to know
            sock.close()
            self.is_gone = True
            return
        self._socket, self.is_gone = sock, False
        self.connections += 1
        if self._hello:
            self.send(self._hello, now)

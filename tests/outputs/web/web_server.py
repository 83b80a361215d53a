"""`faultline serve` as a process of its own, and clients that talk to it byte by byte."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, TypeVar

import httpx

from faultline.service.web.limits import Limits

ROOT = Path(__file__).parents[3]
T = TypeVar("T")
TOKEN = "t" * 40
PATIENCE_S = 30.0  # for what comes at once on a machine that is not busy

COMMAND = "import sys; from faultline.service.web.command import main; sys.exit(main(sys.argv[1:]))"
SHORT = """
import sys
from pathlib import Path
from faultline.service.web import server
from faultline.service.web.command import main
from faultline.service.web.limits import Limits
original = server.serve
server.serve = lambda *given: original(*given, limits=Limits(**{limits!r}))
sys.exit(main(sys.argv[1:]))
"""


class Serving(NamedTuple):
    """A running server: its process, where it listens, the file of what it said, and what was connected to it."""

    process: subprocess.Popen[bytes]
    url: str
    log: Path
    opened: list[socket.socket]

    @property
    def address(self) -> tuple[str, int] | str:
        if self.url.startswith("unix:"):
            return self.url.removeprefix("unix:")
        host, _, port = self.url.removeprefix("http://").rpartition(":")
        return host, int(port)

    def connect(self, receive_buffer: int | None = None) -> socket.socket:
        """A plain connection."""
        address = self.address
        sock = socket.socket(socket.AF_UNIX if isinstance(address, str) else socket.AF_INET, socket.SOCK_STREAM)
        self.opened.append(sock)
        sock.settimeout(PATIENCE_S)
        if receive_buffer is not None:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        sock.connect(address)
        return sock

    def client(self) -> httpx.Client:
        """A whole client."""
        address = self.address
        transport = httpx.HTTPTransport(verify=False, uds=address if isinstance(address, str) else None)  # no TLS here
        url = "http://vehicle" if isinstance(address, str) else self.url
        return httpx.Client(transport=transport, base_url=url, timeout=PATIENCE_S, trust_env=False)


@contextmanager
def serving(
    *arguments: str,
    log: Path,
    limits: Mapping[str, float] | None = None,
    environment: Mapping[str, str] | None = None,
    orderly: bool = False,
) -> Iterator[Serving]:
    """The command with these arguments, once it listens; shorter `limits` than usual where given.

    `orderly`: it ends by itself when it is told to. Else it is killed, which is quicker.
    """
    if limits is not None:
        assert set(limits) <= set(Limits._fields)
    code = COMMAND if limits is None else SHORT.format(limits=dict(limits))
    with log.open("wb") as said:
        process = subprocess.Popen(
            [sys.executable, "-W", "error", "-c", code, *arguments],
            cwd=ROOT,
            stderr=said,
            env={**os.environ, **(environment or {})},
        )
    opened: list[socket.socket] = []
    try:
        yield Serving(process, _listening(process, log), log, opened)
    finally:
        for sock in opened:
            sock.close()
        process.send_signal(signal.SIGTERM if orderly else signal.SIGKILL)
        try:
            ended = process.wait(PATIENCE_S)
        finally:
            process.kill()
            process.wait()
    assert ended == (0 if orderly else -signal.SIGKILL), log.read_text()


def _listening(process: subprocess.Popen[bytes], log: Path) -> str:
    def said() -> str | None:
        assert process.poll() is None, log.read_text()
        match = re.search(r"listening on (\S+),", log.read_text())
        return match[1] if match else None

    url = until(said)
    assert url is not None
    return url


def until(look: Callable[[], T], within_s: float = PATIENCE_S) -> T:
    """What `look` returns, once that is something; fails after a while."""
    end = time.monotonic() + within_s
    while not (found := look()):
        assert time.monotonic() < end, f"nothing within {within_s:g} s"
        time.sleep(0.01)
    return found


class Sse:
    """A stream of events, read line by line from a plain socket."""

    def __init__(self, server: Serving, path: str, last: str | None = None, receive_buffer: int | None = None) -> None:
        self.sock = server.connect(receive_buffer)
        self.cut_after: int | None = None  # bytes, after which the client vanishes
        header = f"Last-Event-ID: {last}\r\n" if last else ""
        self.sock.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n{header}\r\n".encode())
        self.head = b""
        self._rest = self._body = b""
        self.ended = False  # as it should, with its last chunk
        self._left = 0  # bytes of the chunk that are still to come
        while b"\r\n\r\n" not in self.head:
            content = self.sock.recv(1)
            assert content, self.head
            self.head += content

    @property
    def status(self) -> int:
        return int(self.head.split()[1])

    def lines(self) -> Iterator[bytes]:
        """Lines of the stream, without their end, as they come; ends with the stream."""
        while True:
            while b"\n" in self._body:
                line, _, self._body = self._body.partition(b"\n")
                yield line
            part = self._chunk()
            if not part:
                return
            self._body += part

    def events(self) -> Iterator[dict[str, str]]:
        """Whole events, comments as the field of an empty name."""
        event: dict[str, str] = {}
        for line in self.lines():
            if line:
                name, _, value = line.decode().partition(":")
                event[name] = value.removeprefix(" ")
            elif event:
                yield event
                event = {}

    def close(self) -> None:
        self.sock.close()

    def _chunk(self) -> bytes:
        """Some more of the body, whether its chunk is whole or not; nothing at its end."""
        if self._left == 0:
            while b"\r\n" not in self._rest:
                if not self._more():
                    return b""
            size, _, self._rest = self._rest.partition(b"\r\n")
            self._left = int(size, 16)
            self.ended = self._left == 0
        if self._left == 0 or (not self._rest and not self._more()):
            return b""
        part, self._rest = self._rest[: self._left], self._rest[self._left :]
        self._left -= len(part)
        if self._left == 0:
            while len(self._rest) < 2 and self._more():
                pass
            self._rest = self._rest[2:]
        return part

    def _more(self) -> bool:
        try:
            content = self.sock.recv(65536)
        except ConnectionResetError:
            return False
        if self.cut_after is not None:
            content = content[: self.cut_after]
            self.cut_after -= len(content)
        self._rest += content
        return bool(content)

"""Slow, hostile and vanishing clients: others are served meanwhile, as quickly as ever, and nothing is left of them."""

import socket
import statistics
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from test_web_metrics import one, strictly
from web_daemon import FakeDaemon
from web_server import Serving, serving, until

LIMITS = {"header_s": 0.5, "body_s": 0.3, "stalled_s": 0.7}
REQUEST = b"GET /v1/ready HTTP/1.1\r\nHost: localhost\r\n"
LONGEST_S, USUAL_S = 5.0, 0.25  # on two cores that others use too, and that may stand still for a second


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FakeDaemon]:
    with FakeDaemon(tmp_path_factory.mktemp("hostile")) as made:
        made.tell(*range(1, 1001), padding=3000)
        yield made


@pytest.fixture(scope="module")
def the_server(daemon: FakeDaemon, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Serving]:
    arguments = ("--control", str(daemon.control), "--events", str(daemon.events), "--listen", "127.0.0.1:0")
    with serving(*arguments, limits=LIMITS, log=tmp_path_factory.mktemp("hostile") / "log", orderly=True) as running:
        yield running


@pytest.fixture
def server(the_server: Serving) -> Iterator[Serving]:
    """After each test nothing is left of its clients."""
    yield the_server
    for sock in the_server.opened:
        sock.close()
    the_server.opened.clear()
    until(lambda: len(descriptors(the_server)) <= QUIET, within_s=20)
    assert the_server.log.read_text().count("\n") == 1, "clients must not fill the log"


QUIET = 16
"""Descriptors of a server that nobody asks: its socket, the daemon's, the loop's."""


def descriptors(server: Serving) -> list[str]:
    return [each.name for each in Path(f"/proc/{server.process.pid}/fd").iterdir()]


class Good:
    """Somebody who asks all the while, half the time over a new connection; how long each answer took [s]."""

    def __init__(self, server: Serving) -> None:
        self._server = server
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.took: list[float] = []
        self.failed: list[str] = []

    def __enter__(self) -> "Good":
        self._thread.start()
        until(lambda: self.took or self.failed)
        return self

    def __exit__(self, *_: object) -> None:
        until(lambda: len(self.took) > 20 or self.failed)
        self._ended.set()
        self._thread.join()
        assert not self.failed, self.failed[:3]
        assert max(self.took) < LONGEST_S
        assert statistics.median(self.took) < USUAL_S

    def _run(self) -> None:
        address = self._server.address
        assert not isinstance(address, str)
        while not self._ended.is_set():
            begun = time.perf_counter()
            try:
                with socket.create_connection(address, timeout=10) as sock:
                    for _ in range(2):
                        sock.sendall(REQUEST + b"\r\n")
                        answer = sock.recv(4096)
                        while b'{"ready":true}' not in answer:
                            more = sock.recv(4096)
                            assert more, answer
                            answer += more
                        now = time.perf_counter()
                        self.took.append(now - begun)
                        begun = now
            except (OSError, AssertionError) as error:
                self.failed.append(repr(error))
            time.sleep(0.005)


def turned_away(server: Serving, reason: str) -> float:
    with server.client() as client:
        read = strictly(client.get("/metrics").content).get("faultline_http_turned_away_total")
    return read.samples.get(frozenset({("reason", reason)}), 0.0) if read else 0.0


def answered(sock: socket.socket) -> bytes:
    """All that comes until the other end closes."""
    content = b""
    try:
        while part := sock.recv(65536):
            content += part
    except ConnectionResetError:
        pass
    return content


def test_headers_that_drip(server: Serving) -> None:
    """Slowloris: 400 connections that never get to the end of a request."""
    before = turned_away(server, "made room"), turned_away(server, "late request")
    with Good(server):
        slow = [server.connect() for _ in range(400)]
        for _ in range(5):
            for sock in slow:
                try:
                    sock.send(b"G")
                except OSError:  # ended by the server
                    continue
            time.sleep(0.2)
        assert len(descriptors(server)) < 128 + QUIET + 4
        until(lambda: len(descriptors(server)) <= QUIET + 4)
    made_room, late = turned_away(server, "made room") - before[0], turned_away(server, "late request") - before[1]
    assert made_room > 0
    assert late > 0
    assert made_room + late >= 400, "which of the two is a matter of how fast they come"


def test_connections_that_say_nothing(server: Serving) -> None:
    before = turned_away(server, "made room")
    with Good(server):
        silent = [server.connect() for _ in range(100)]
        begun = time.monotonic()
        assert answered(silent[0]) == b""
        assert time.monotonic() - begun < 10
    assert turned_away(server, "made room") == before


def test_a_storm_of_connections_that_vanish(server: Serving) -> None:
    """A thousand: closed at once, reset, or in the middle of a request or an answer."""
    address = server.address
    assert not isinstance(address, str)
    with Good(server):
        for number in range(1000):
            with socket.create_connection(address, timeout=10) as sock:
                if number % 4 == 1:
                    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                if number % 4 == 2:
                    sock.sendall(REQUEST)
                if number % 4 == 3:
                    sock.sendall(b"GET /v1/events?after=0 HTTP/1.1\r\nHost: localhost\r\n\r\n")
        until(lambda: len(descriptors(server)) <= QUIET + 4)
    with server.client() as client:
        figures = strictly(client.get("/metrics").content)
        assert one(figures, "faultline_http_sse_clients", stream="events") == 0


def test_who_shuts_one_half_is_gone(server: Serving) -> None:
    with Good(server):
        halves = [server.connect() for _ in range(40)]
        for number, sock in enumerate(halves):
            sock.sendall(b"GET /v1/events HTTP/1.1\r\nHost: localhost\r\n\r\n" if number % 2 else REQUEST)
            sock.shutdown(socket.SHUT_WR)
        for sock in halves:
            answered(sock)


def test_answers_that_nobody_takes(server: Serving) -> None:
    """A megabyte each, asked for by a hundred that read nothing: few are held, and those not for long."""
    before = turned_away(server, "takes nothing")
    with Good(server):
        for _ in range(100):
            sock = server.connect(receive_buffer=4096)
            sock.sendall(b"GET /v1/records?count=300 HTTP/1.1\r\nHost: localhost\r\n\r\n")
        until(lambda: turned_away(server, "takes nothing") >= before + 20, within_s=20)
    with server.client() as client:
        figures = strictly(client.get("/metrics").content)
        assert one(figures, "faultline_http_requests_total", method="GET", code="503") > 20
        until(lambda: client.get("/v1/records?count=300").status_code == 200)
    status = Path(f"/proc/{server.process.pid}/status").read_text()
    peak_kib = int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM")))
    assert peak_kib < 128 * 1024


@pytest.mark.parametrize(
    ("sent", "status"),
    [
        (b"\r\n\r\n\x00\xff garbage\r\n\r\n", 400),
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + b"\x5a" * 200 + b"\r\n\r\n", 400),  # TLS
        (b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n", 421),
        (b"GET /v1/\xff\xfe HTTP/1.1\r\nHost: localhost\r\n\r\n", 400),
        (b"GET /v1/%ff%fe%00 HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n", 404),
        (b"GET /v1/ready HTTP/1.1\r\n\r\n", 400),  # no host
        (b"GET /v1/ready HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n", 400),
        (b"GET /v1/ready HTTP/1.0\r\n\r\n", 421),
        (b"GET http://evil.example/v1/ready HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n", 404),
        (b"OPTIONS * HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n", 404),
        (REQUEST + b"X: a\r\n b\r\n: c\r\n\r\n", 400),
        (REQUEST + b"X: " + b"y" * 1_000_000 + b"\r\n\r\n", 431),
        (REQUEST + b"X: y\r\n" * 2500 + b"\r\n", 431),
        (REQUEST + b"Content-Length: -1\r\n\r\n", 400),
        (REQUEST + b"Content-Length: 99999999999999999999999\r\n\r\n", 400),
        (REQUEST + b"Content-Length: 10000000000\r\nExpect: 100-continue\r\n\r\n", 413),
        (REQUEST + b"Content-Length: 10\r\nTransfer-Encoding: chunked\r\nConnection: close\r\n\r\n0\r\n\r\n", 200),
        (REQUEST + b"Transfer-Encoding: gzip\r\n\r\n", 501),
        (REQUEST + b"Transfer-Encoding: chunked\r\n\r\nzz\r\n", 0),
        (REQUEST + b"Content-Length: 1000\r\n\r\nonly this", 408),
        (REQUEST + b"Transfer-Encoding: chunked\r\n\r\n5\r\nhello\r\n", 408),
        (REQUEST + b"Content-Length: 900000\r\n\r\n" + b"x" * 900_000, 413),
        (REQUEST + b"Upgrade: websocket\r\nConnection: Upgrade, close\r\n\r\n", 200),
    ],
)  # fmt: skip
def test_what_is_no_request(server: Serving, sent: bytes, status: int) -> None:
    """It is refused with a problem where one can be said, the connection ends, and that is all."""
    sock = server.connect()
    try:
        sock.sendall(sent)
    except (ConnectionResetError, BrokenPipeError):
        assert len(sent) > 100_000, "what is short is read to its end"
    answer = answered(sock)
    if status and not (answer == b"" and len(sent) > 100_000):
        head, _, body = answer.rpartition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 %d " % status), answer[:300]
        assert b"x-content-type-options: nosniff" in head
        assert status == 200 or (b"application/problem+json" in head and b'"status":%d' % status in body)
    with server.client() as client:
        assert client.get("/v1/ready").status_code == 200


def test_a_huge_body_ends_soon(server: Serving) -> None:
    """A gigabyte is announced; it is not read."""
    with Good(server):
        sock = server.connect()
        sock.sendall(b"PUT /v1/ready HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000000\r\n\r\n")
        sent = 0
        try:
            while sent < 100_000_000:
                sent += sock.send(b"x" * 65536)
        except (ConnectionResetError, BrokenPipeError):
            pass
        assert sent < 10_000_000


def test_many_requests_in_one_piece(server: Serving) -> None:
    """Pipelined: answered one after the other."""
    with Good(server):
        sock = server.connect()
        sock.sendall((REQUEST + b"\r\n") * 199 + REQUEST + b"Connection: close\r\n\r\n")
        assert answered(sock).count(b'{"ready":true}') == 200

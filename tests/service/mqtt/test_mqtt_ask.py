"""Answers of the daemon that are none, late, endless or refusals; and why a broker cannot be reached, in words."""

import errno
import json
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path

import pytest

from faultline.service.core.errors import InputError
from faultline.service.core.records.line import encode
from faultline.service.mqtt import ask
from faultline.service.mqtt.ask import ask_faults, ask_state
from faultline.service.mqtt.broker_words import failed, lost
from faultline.service.mqtt.daemon import LONGEST
from faultline.service.protocol.connection import Connection
from faultline.service.protocol.errors import AwayError, ProtocolError
from faultline.service.protocol.records import Subscription

Serve = Callable[[socket.socket], None]


@pytest.fixture
def serving(tmp_path: Path) -> Iterator[Callable[[Serve], Path]]:
    """A Unix socket on which a function serves one connection."""
    path = tmp_path / "socket"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        listener.bind(str(path))
        threads = []

        def begin(serve: Serve) -> Path:
            listener.listen(1)

            def run() -> None:
                with listener.accept()[0] as sock:
                    serve(sock)

            threads.append(threading.Thread(target=run))
            threads[-1].start()
            return path

        yield begin
        for thread in threads:
            thread.join()


def answering(content: bytes) -> Serve:
    def serve(sock: socket.socket) -> None:
        sock.recv(4096)
        with suppress(BrokenPipeError):
            sock.sendall(content)

    return serve


def test_state_and_faults_are_what_the_daemon_answers(serving: Callable[[Serve], Path]) -> None:
    path = serving(answering(b'{"source":"truck-17","seq":9,"conditions":[{"kind":"jump"}],"later":"more"}\n'))
    state = ask_state(path)
    assert (state.source, state.seq, bytes(state.conditions)) == ("truck-17", 9, b'[{"kind":"jump"}]')


def test_faults_are_as_they_were_written(serving: Callable[[Serve], Path]) -> None:
    path = serving(answering(b'{"faults":[{"number":3, "p":0.10},{"number":1}],"overflow":false,"seq":9}\n'))
    remembered = ask_faults(path)
    assert (remembered.faults, remembered.seq) == ({3: b'{"number":3, "p":0.10}', 1: b'{"number":1}'}, 9)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (b'{"error":{"code":"busy","message":"too many connections"}}\n', "socket: too many connections"),
        (b"{}\n", "sent no faults: has no field `faults`"),
        (b"nothing\n", "sent no answer"),
        (b"\xff\n", "sent no answer"),
        (b"[" * 100_000 + b"\n", "answers as another version"),
        (b'{"x":' + b"[" * 100_000 + b"\n", "sent no answer"),
        (b'{"faults":[{}],"seq":1}\n', "a fault without a number"),
        (b'{"faults":[{"number":-1}],"seq":1}\n', "a fault without a number"),
        (b'{"faults":[],"seq":1}', "it broke off"),
        (b"", "the service has ended the connection"),
    ],
)
def test_an_answer_that_is_none_is_said(serving: Callable[[Serve], Path], answer: bytes, said: str) -> None:
    path = serving(answering(answer))
    with pytest.raises(ProtocolError, match=said) as caught:
        ask_faults(path)
    assert "\n" not in str(caught.value)


def test_an_answer_without_an_end_is_not_kept(
    serving: Callable[[Serve], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ask, "LARGEST", 1000)
    with pytest.raises(ProtocolError, match="the service has ended the connection"):
        ask_state(serving(answering(b"x" * 300_000)))


def test_a_daemon_that_drips_does_not_hold_us_up(
    serving: Callable[[Serve], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The time is for the whole answer, not for each byte of it."""
    monkeypatch.setattr(ask, "TIMEOUT_S", 0.2)
    ended = threading.Event()

    def drip(sock: socket.socket) -> None:
        with suppress(BrokenPipeError):
            while not ended.wait(0.02):
                sock.sendall(b" ")

    path = serving(drip)
    begun = time.monotonic()
    with pytest.raises(ProtocolError, match=r"no answer within 0.2 s"):
        ask_state(path)
    assert time.monotonic() - begun < 10  # it drips for ever
    ended.set()


def test_a_daemon_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(ProtocolError, match=r"none: No such file or directory"):
        ask_state(tmp_path / "none")
    with pytest.raises(AwayError, match=r"none: No such file or directory"):
        Connection(tmp_path / "none")


def test_lines_come_whole_however_they_were_cut(serving: Callable[[Serve], Path]) -> None:
    asked = []

    def serve(sock: socket.socket) -> None:
        asked.append(json.loads(sock.recv(4096)))
        for part in (b"on", b"e\ntw", b"o\nthree\nfo", b"ur"):
            sock.sendall(part)
            time.sleep(0.01)

    stream = Connection(serving(serve), encode(Subscription("truck-17-1")), LONGEST)
    lines = everything(stream)
    assert lines == [b"one", b"two", b"three"]  # what has no end is none
    assert asked == [{"after": "truck-17-1"}]


def test_a_line_that_is_too_long_is_left_out_and_not_kept(serving: Callable[[Serve], Path]) -> None:
    def serve(sock: socket.socket) -> None:
        sock.recv(4096)
        sock.sendall(b"one\n" + b"x" * (3 * LONGEST) + b"\ntwo\n")

    stream = Connection(serving(serve), encode(Subscription(0)), LONGEST)
    assert everything(stream) == [b"one", b"two"]


def everything(stream: Connection) -> list[bytes]:
    """All lines until the end; of a line without one no more is kept than is read."""
    lines = list[bytes]()
    with closing(stream):
        while True:
            try:
                lines += stream.read()
            except AwayError:
                return lines
            assert stream._size <= LONGEST


def certificate_error() -> Exception:
    error = ssl.SSLCertVerificationError(1, "failed")
    error.verify_message = "Hostname mismatch."
    return error


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (certificate_error(), "its certificate is not believed: Hostname mismatch; check `ca` and `host`"),
        (ssl.SSLEOFError(8, "EOF occurred (_ssl.c:10)"), "TLS failed: "),
        (
            socket.gaierror(-2, "Name or service not known"),
            "its name cannot be found: Name or service not known; check",
        ),
        (TimeoutError("timed out"), "no answer within 10 s"),
        (ConnectionRefusedError(errno.ECONNREFUSED, "x"), "nobody listens there; is the broker running?"),
        (ConnectionResetError(errno.ECONNRESET, "x"), "it closed the connection before it took us; check `port`"),
        (OSError(errno.ENETUNREACH, "Network is unreachable"), "Network is unreachable"),
        (InputError("/secret: is empty; put the password in it"), "/secret: is empty; put the password in it"),
        (ValueError(), "ValueError"),
    ],
)
def test_why_there_is_no_connection_is_one_line(error: Exception, said: str) -> None:
    assert failed(error).startswith(said)


@pytest.mark.parametrize(
    ("words", "is_up", "said"),
    [
        ("[Errno 104] Connection reset by peer", True, "the connection is lost: connection reset by peer"),
        (
            *("[SSL: TLSV13_ALERT_CERTIFICATE_REQUIRED] tlsv13 alert certificate required (_ssl.c:2580)", False),
            "TLS failed: tlsv13 alert certificate required; check [mqtt.tls]",
        ),
        ("Unspecified error", False, "it closed the connection before it took us; check `port` and [mqtt.tls]"),
    ],
)
def test_why_a_connection_broke_is_one_line(words: str, is_up: bool, said: str) -> None:
    assert lost(words, is_up=is_up) == said

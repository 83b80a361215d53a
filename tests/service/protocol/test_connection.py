"""Lines over a socket: whole, bounded, and again after the service was away."""

import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from faultline.service.protocol.backoff import Backoff
from faultline.service.protocol.client import ControlClient, subscribe
from faultline.service.protocol.connection import CHUNK, Connection
from faultline.service.protocol.errors import AwayError, RefusedError
from faultline.service.protocol.live import LiveTick
from faultline.service.protocol.questions import Question
from faultline.service.protocol.reconnecting import Reconnecting

RETRY_S = 0.5
TICK = (
    b'{"system":"uds","bundle":"ab","tick":1,"t_s":0.2,"mode":"idle","z":[],"quality":[],"y_hat":[],"r":[],"sigma":[],'
    b'"sums":[],"usable":[],"alarm":[],"cannot_tell":[],"suspected":false,"anomaly":false,"diagnoses":[]}\n'
)


@pytest.fixture
def listener(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as made:
        made.bind(str(tmp_path / "s"))
        made.listen()
        yield made


def lines_of(path: Path, first: bytes = b"") -> Reconnecting:
    return Reconnecting(path, Backoff(RETRY_S, RETRY_S, lambda: 0.0), lambda: first)


def test_a_line_without_an_end_is_left_out_and_not_kept(tmp_path: Path, listener: socket.socket) -> None:
    connection = Connection(tmp_path / "s", longest=1000)
    client, _ = listener.accept()
    came, largest = list[bytes](), 0
    for part in (b"one\n", *[b"x" * 400] * 20, b"\ntwo\n"):
        client.sendall(part)
        came += connection.read()
        largest = max(largest, connection._size)
    assert came == [b"one", b"two"]
    assert largest <= 1000
    client.close()
    connection.close()


def test_whole_lines_before_the_end_are_taken_and_what_was_begun_is_not(
    tmp_path: Path, listener: socket.socket
) -> None:
    lines = lines_of(tmp_path / "s", b"{}\n")
    assert lines.take(0.0) == []
    client, _ = listener.accept()
    assert client.recv(10) == b"{}\n"
    client.sendall(b"one\ntw")
    assert lines.take(0.0) == [b"one"]
    client.sendall(b"o\nthree\nfo")
    client.close()
    assert lines.take(0.0) == [b"two", b"three"]
    lines.retry.well()
    assert lines.take(0.0) == []
    assert (lines.is_connected, lines.due, lines.why) == (False, RETRY_S, f"{tmp_path / 's'}: it broke off")
    assert lines.take(RETRY_S) == []
    assert (lines.is_connected, lines.connections, lines.failures) == (True, 2, 1)
    lines.close()


def test_where_nobody_serves_it_is_tried_again_when_that_is_due(tmp_path: Path) -> None:
    lines = lines_of(tmp_path / "s")
    assert [lines.take(t) for t in (0.0, 0.1, RETRY_S)] == [[], [], []]
    assert (lines.failures, lines.fileno(), lines.is_connected) == (2, -1, False)
    assert lines.why == f"{tmp_path / 's'}: No such file or directory"
    assert not lines.send(b"x\n", RETRY_S)


def test_a_line_that_is_not_taken_at_once_ends_the_connection(tmp_path: Path, listener: socket.socket) -> None:
    lines = lines_of(tmp_path / "s")
    lines.take(0.0)
    assert not lines.send(bytes(1 << 24), 0.0)
    assert (lines.is_connected, lines.due) == (False, RETRY_S)


def test_the_blocking_client_gives_up_an_answer_that_drips(tmp_path: Path, listener: socket.socket) -> None:
    """The time is for the whole answer, not for each byte of it."""
    with ControlClient(tmp_path / "s", answer_s=0.2) as control:
        client, _ = listener.accept()
        ended = threading.Event()

        def drip() -> None:
            while not ended.wait(0.02):
                client.sendall(b" ")

        thread = threading.Thread(target=drip)
        thread.start()
        begun = time.monotonic()
        with pytest.raises(AwayError, match=r"no answer within 0\.2 s; is the service running"):
            control.ask(Question(ask="state"), dict)
        assert time.monotonic() - begun < 10
        ended.set()
        thread.join()
        client.close()


def test_live_ticks_and_the_silence_between_them(tmp_path: Path, listener: socket.socket) -> None:
    with ControlClient(tmp_path / "s", answer_s=0.3) as control:
        client, _ = listener.accept()
        came = control.live_or_silent("uds", 0.1)
        assert next(came) == 0.1
        assert client.recv(100) == b'{"ask":"live","name":"uds"}\n'
        client.sendall(TICK + TICK)
        assert isinstance(next(came), LiveTick)
        behind = [control.is_behind]
        time.sleep(0.4)  # what is there is read, however late
        assert isinstance(next(came), LiveTick)
        assert [*behind, control.is_behind] == [True, False]
        silent: list[LiveTick | float] = []
        with pytest.raises(AwayError, match=r"no answer within 0\.3 s") as away:
            silent.extend(each for each in came)
        assert silent == [0.1, 0.1]
        assert isinstance(away.value.__cause__, TimeoutError)
        client.close()


def test_a_refusal_has_the_code_and_the_message_of_the_service(tmp_path: Path, listener: socket.socket) -> None:
    with ControlClient(tmp_path / "s") as control:
        client, _ = listener.accept()
        client.sendall(b'{"error":{"code":"busy","message":"it starts"}}\n')
        with pytest.raises(RefusedError, match="s: it starts") as refused:
            control.ask(Question(ask="state"), dict)
        assert (refused.value.code, refused.value.message) == ("busy", "it starts")
        assert client.recv(100) == b'{"ask":"state"}\n'
        client.close()


def test_a_subscriber_waits_for_the_socket_and_gets_whole_lines_until_the_end(tmp_path: Path) -> None:
    def serve() -> None:
        time.sleep(0.1)
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as late:
            late.bind(str(tmp_path / "s"))
            late.listen()
            with late.accept()[0] as client:
                asked.append(client.recv(100))
                client.sendall(b"a" * CHUNK + b"\nb\nc")

    asked: list[bytes] = []
    thread = threading.Thread(target=serve)
    thread.start()
    assert [*subscribe(tmp_path / "s", 7, wait_s=10.0)] == [b"a" * CHUNK + b"\n", b"b\n"]
    thread.join()
    assert asked == [b'{"after":7}\n']
    with pytest.raises(AwayError, match=r"is `faultline run --socket .*s` running\?"):
        next(subscribe(tmp_path / "s", None))

"""The control socket: clients that ask nothing more make room for those that ask."""

import selectors
import socket
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from faultline.service.outputs import control, lines
from faultline.service.outputs.control import Asker, ControlSocket, Live, Then
from faultline.service.protocol.answers import Erased
from faultline.service.protocol.questions import Question


class Answers:
    """Answers at once, but to `records` never."""

    def answer(self, question: Question, asker: Asker, then: Then) -> None:
        if question.ask != "records":
            then(Erased(cleared=[], id=asker.user))

    def live(self, name: str | None) -> Live:
        del name
        return lambda sent: (0, b"{}\n") if sent < 0 else None


class Served:
    """A control socket in a loop that is turned by hand."""

    def __init__(self, path: Path) -> None:
        self.path, self.selector, self.socket = path, selectors.DefaultSelector(), ControlSocket(path)
        self.socket.answers = Answers()
        self.socket.register(self.selector)
        self.clients: list[socket.socket] = []

    def ask(self, what: str | None) -> socket.socket:
        """A client that asks this, or nothing."""
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        sock.settimeout(5)
        sock.connect(str(self.path))
        sock.sendall(b"" if what is None else msgspec.json.encode({"ask": what}) + b"\n")
        self.clients.append(sock)
        while ready := self.selector.select(0):
            self.socket.serve(ready)
        return sock


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    made = Served(tmp_path / "control.sock")
    yield made
    made.socket.close()
    made.selector.close()
    for each in made.clients:
        each.close()


def is_busy(sock: socket.socket) -> bool:
    return b'"busy"' in sock.recv(200)


def test_clients_that_ask_nothing_make_room_and_so_do_those_whose_last_answer_is_long_ago(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(lines.CLIENTS + 5):
        served.ask(None)
    assert not is_busy(served.ask("state"))
    while len(served.clients) < 3 * lines.CLIENTS:
        served.ask("state")
    assert is_busy(served.ask("state")), "all have just asked"
    monkeypatch.setattr(control, "IDLE_S", -1.0)
    assert not is_busy(served.ask("state"))


@pytest.mark.parametrize("what", ["live", "records"])
def test_a_client_that_waits_for_an_answer_or_for_live_values_is_not_idle(
    served: Served, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control, "IDLE_S", -1.0)
    for _ in range(lines.CLIENTS):
        served.ask(what)
    assert is_busy(served.ask("state"))
    assert {each.kind for each in served.socket.conditions} == {"clients-refused"}

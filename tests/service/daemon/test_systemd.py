"""The service manager's side, against a socket of its kind."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from faultline.service.systemd import Heartbeat, Notifier, Supervisor


class Manager:
    """Listens as systemd does."""

    def __init__(self, address: str) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.sock.bind("\0" + address[1:] if address.startswith("@") else address)
        self.sock.settimeout(5)
        self.address = address

    def told(self) -> str:
        return self.sock.recv(4096).decode()

    def silent(self) -> bool:
        self.sock.setblocking(False)
        try:
            self.sock.recv(4096)
        except BlockingIOError:
            return True
        return False


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Manager]:
    kind = Manager(str(tmp_path / "n") if request.param == "path" else f"@faultline-{os.getpid()}-{tmp_path.name}")
    with kind.sock:
        yield kind


def test_states_are_told_in_lines_of_their_own(manager: Manager) -> None:
    Notifier({"NOTIFY_SOCKET": manager.address}).tell(READY=1, STATUS="two\nlines are one")
    assert manager.told() == "READY=1\nSTATUS=two lines are one"


def test_without_a_manager_nothing_is_told_and_nothing_fails(tmp_path: Path) -> None:
    Notifier({}).tell(READY=1)
    Notifier({"NOTIFY_SOCKET": str(tmp_path / "gone")}).tell(READY=1)


@pytest.mark.parametrize(
    ("environment", "seconds"),
    [
        ({"WATCHDOG_USEC": "10000000"}, 10.0),
        ({"WATCHDOG_USEC": "10000000", "WATCHDOG_PID": str(os.getpid())}, 10.0),
        ({"WATCHDOG_USEC": "10000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({}, None),
    ],
)
def test_the_watchdog_is_the_managers(environment: dict[str, str], seconds: float | None) -> None:
    assert Notifier({"NOTIFY_SOCKET": "/x", **environment}).watchdog_s == seconds
    assert Notifier(environment).watchdog_s is None


def test_the_watchdog_is_fed_only_while_every_part_is_alive(tmp_path: Path) -> None:
    manager, now, said = Manager(str(tmp_path / "n")), [0.0], list[str]()
    parts = {name: Heartbeat(5.0, lambda: now[0]) for name in ("loop", "store")}
    supervisor = Supervisor(Notifier({"NOTIFY_SOCKET": manager.address}), parts, said.append)
    supervisor.look()
    assert manager.told() == "WATCHDOG=1"
    now[0] = 6.0
    parts["loop"].beat()
    for _ in range(3):
        supervisor.look()
    assert said == ["store without a sign of life: the watchdog is not fed"]
    assert manager.silent()
    parts["store"].beat()
    supervisor.look()
    assert manager.sock.recv(99) == b"WATCHDOG=1"
    manager.sock.close()


def test_a_thread_of_its_own_feeds_it_and_ends(tmp_path: Path) -> None:
    manager = Manager(str(tmp_path / "n"))
    environment = {"NOTIFY_SOCKET": manager.address, "WATCHDOG_USEC": "30000"}
    with manager.sock, Supervisor(Notifier(environment), {"loop": Heartbeat(60.0)}, print):
        assert [manager.told() for _ in range(3)] == ["WATCHDOG=1"] * 3
    with Supervisor(Notifier({}), {}, print) as idle:
        assert not idle._thread.is_alive()

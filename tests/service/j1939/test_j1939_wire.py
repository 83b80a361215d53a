"""Sending on a CAN interface without waiting, and knowing what was transmitted; the loop on one that listens only."""

import errno
import socket
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import cast

import pytest
from j1939_bench import codes, name
from ports import multicast

from faultline.service.bus import BusError
from faultline.service.bus.base import QUEUE
from faultline.service.bus.interface import Interface
from faultline.service.core.j1939.identifiers import ADDRESS_CLAIMED, DM1
from faultline.service.core.signals.decode import Wanted
from faultline.service.j1939 import wire as module
from faultline.service.j1939.frames import Message
from faultline.service.j1939.loop import Loop
from faultline.service.j1939.memory import Memory
from faultline.service.j1939.node import Node
from faultline.service.j1939.wire import Wire, has_echo, wanted
from faultline.service.logs import Frame
from faultline.service.systemd import Notifier

VIRTUAL, REAL = Interface(3, True, True, True), Interface(3, True, True, False)
CLAIM = Message(ADDRESS_CLAIMED, bytes(range(8))).frame(144, 0.0)


class Kernel:
    """A CAN socket and the controller behind it, which hands back what it has transmitted, or nothing."""

    def __init__(self, *, transmits: bool = True) -> None:
        self.transmits = transmits
        self.options: list[tuple[int, int, object]] = []
        self.sent: list[bytes] = []
        self.waiting: list[tuple[bytes, int]] = []
        self.failure: int | None = None
        self.room: int | None = None  # frames until one does not fit
        self.closed = False

    def setsockopt(self, level: int, option: int, value: object) -> None:
        self.options.append((level, option, value))

    def getsockopt(self, _level: int, option: int) -> int:
        assert option == socket.SO_RCVBUF
        return QUEUE

    def setblocking(self, flag: bool) -> None:
        assert not flag

    def fileno(self) -> int:
        return -1 if self.closed else 7

    def send(self, content: bytes) -> int:
        if self.failure is not None:
            raise OSError(self.failure, "told so")
        if self.room == 0:
            self.room = None
            raise OSError(errno.ENOBUFS, "told so")
        if self.room is not None:
            self.room -= 1
        self.sent.append(content)
        if self.transmits:
            self.waiting.append((content, socket.MSG_DONTROUTE | socket.MSG_CONFIRM))
        return len(content)

    def recvmsg(self, *_sizes: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, None]:
        if self.failure == errno.ENODEV:
            raise OSError(errno.ENODEV, "told so")
        if not self.waiting:
            raise BlockingIOError
        content, flags = self.waiting.pop(0)
        return content, [], flags, None

    def close(self) -> None:
        self.closed = True


def opened(kernel: Kernel, at: Interface | None = REAL, *, echoes: bool = True) -> Wire:
    def make(_name: str, _frames: object) -> socket.socket:
        if at is None:
            raise BusError("socketcan:can0: No such device")
        return cast(socket.socket, kernel)

    return Wire("socketcan:can0", [144], make=make, look=lambda _: at, echoes=lambda _: echoes)


def test_what_was_sent_is_asked_back_of_the_kernel_and_given() -> None:
    """CAN_RAW_RECV_OWN_MSGS is option 4 of level 101, in linux/can/raw.h; it is left alone for who only listens."""
    kernel = Kernel()
    wire = opened(kernel)
    assert kernel.options == [(101, 4, 1)]
    assert wire.send(CLAIM)
    assert kernel.sent == [struct.pack("=IB3x8s", 0x98EEFF90, 8, bytes(range(8)))]
    assert [frame[1:] for frame in wire.bus.receive()] == [CLAIM[1:]]
    assert (wire.bus.fileno(), wire.bus.trouble, wire.bus.why) == (7, None, "")
    wire.bus.close()
    assert kernel.closed


@pytest.mark.parametrize("number", [errno.ENOBUFS, errno.EAGAIN, errno.ENETDOWN, errno.EIO])
def test_what_the_kernel_does_not_take_is_not_waited_for(number: int) -> None:
    kernel = Kernel()
    wire = opened(kernel)
    kernel.failure = number
    assert not wire.send(CLAIM)
    kernel.failure = None
    assert wire.send(CLAIM)


def test_an_interface_that_is_gone_takes_nothing() -> None:
    kernel = Kernel()
    wire = opened(kernel)
    kernel.failure = errno.ENODEV
    assert wire.bus.receive() == []
    assert (wire.bus.trouble, kernel.closed) == ("removed", True)
    kernel.failure = None
    assert not wire.send(CLAIM)
    assert kernel.sent == []


def test_an_interface_that_is_not_there_yet_takes_nothing() -> None:
    wire = opened(Kernel(), None)
    assert (wire.bus.trouble, wire.bus.why) == ("removed", "socketcan:can0: No such device")
    assert not wire.send(CLAIM)


def test_a_driver_that_does_not_say_what_was_transmitted_is_not_used() -> None:
    """The kernel would hand frames back in its place, before anything is transmitted."""
    kernel = Kernel()
    wire = opened(kernel, echoes=False)
    assert wire.bus.why == (
        "socketcan:can0: its driver does not say what was transmitted, so nobody can tell whether it listens only; "
        "use another adapter"
    )
    assert not wire.send(CLAIM)
    assert kernel.sent == []
    assert opened(kernel, VIRTUAL, echoes=False).send(CLAIM)  # leads to no wire


@pytest.mark.parametrize(("flags", "echoes"), [("0x40041", True), ("0x1", False), ("0xc1", False)])
def test_whether_a_driver_says_so_is_in_its_flags(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, flags: str, echoes: bool
) -> None:
    """IFF_ECHO, bit 18 (linux/if.h), as /sys/class/net shows the flags."""
    monkeypatch.setattr(module, "SYS", tmp_path)
    assert not has_echo("can0")
    (tmp_path / "can0").mkdir()
    (tmp_path / "can0" / "flags").write_text(flags + "\n")
    assert has_echo("can0") == echoes


def test_the_kernel_is_asked_for_what_a_node_must_hear_and_nothing_else() -> None:
    def passes(can_id: int) -> bool:
        return any(can_id & mask == identifier & mask for identifier, mask, extended in rows if extended)

    rows = wanted([144, 145])
    assert all(isinstance(row, Wanted) for row in rows)
    heard = (0x18EEFF00, 0x18EEFFFE, 0x18EAFFF9, 0x18EA90F9, 0x1CEC90F9, 0x18FECA90, 0x1CEBFF91, 0x18E8FF90)
    assert all(map(passes, heard))
    assert not any(map(passes, (0x18FECA00, 0x0CF00400, 0x1CEBFF00, 0x18FEE03D, 0x18FF1090 ^ 0x80)))


@pytest.fixture
def memory(tmp_path: Path) -> Iterator[Memory]:
    made = Memory(tmp_path / "control", tmp_path / "events", lambda _: None)
    yield made
    made.close()


class Bench:
    """A loop whose time goes on by hundredths of a second."""

    def __init__(self, wire: Wire, memory: Memory, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(memory, "take", lambda _: None)
        memory.known = codes(1)
        self.said: list[str] = []
        self.now = 0.0
        self.loop = Loop(Node(name(1), [144]), wire, memory, Notifier({}), self.said.append, lambda: self.now)

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> None:
        for _ in range(round(100 * seconds)):
            self.loop.turn()
            if until():
                return
            self.now += 0.01


def sent(kernel: Kernel) -> list[int]:
    return [struct.unpack_from("=I", content)[0] & 0x1FFF_FFFF for content in kernel.sent]


def test_an_interface_that_listens_only_is_found_out_and_left_alone(
    memory: Memory, monkeypatch: pytest.MonkeyPatch
) -> None:
    kernel = Kernel(transmits=False)
    bench = Bench(opened(kernel), memory, monkeypatch)
    bench.run(300.0)
    assert set(sent(kernel)) == {0x18EEFF90}  # a claim, and never a code
    assert len(kernel.sent) <= 9
    assert bench.said == [
        "socketcan:can0: claims address 144",
        "socketcan:can0: nothing that was sent was transmitted: it listens only, is bus-off, or nobody else is there; "
        "tried again every 5 to 60 s",
    ]
    kernel.transmits = True
    bench.run(70.0)
    assert sent(kernel)[-1] == DM1 << 8 | 0x18000000 | 144
    assert bench.said[2:] == ["socketcan:can0: claims address 144", "socketcan:can0: has address 144"]


def test_an_interface_that_goes_and_comes_is_claimed_on_at_once(
    memory: Memory, monkeypatch: pytest.MonkeyPatch
) -> None:
    at: list[Interface] = [REAL]
    kernel = Kernel()
    wire = Wire(
        "socketcan:can0",
        [144],
        make=lambda *_: cast(socket.socket, kernel),
        look=lambda _: at[0],
        echoes=lambda _: True,
    )
    clock = [0.0]
    monkeypatch.setattr(wire.bus, "_clock", lambda: clock[0])
    wire.bus._due = 0.0  # type: ignore[attr-defined]
    bench = Bench(wire, memory, monkeypatch)

    def follow() -> bool:
        clock[0] = bench.now
        return False

    bench.run(3.0, follow)
    assert sent(kernel).count(0x18FECA90) == 3
    at[0] = REAL._replace(is_up=False)
    bench.run(10.0, follow)
    before = len(kernel.sent)
    bench.run(10.0, follow)
    assert len(kernel.sent) == before
    at[0] = REAL
    bench.run(1.5, follow)
    assert sent(kernel)[before:][:2] == [0x18EEFF90, 0x18FECA90]
    assert bench.said == [
        "socketcan:can0: claims address 144",
        "socketcan:can0: has address 144",
        "socketcan:can0: is down; nothing is sent",
        "socketcan:can0: is there",
        "socketcan:can0: claims address 144",
        "socketcan:can0: has address 144",
    ]


def test_a_queue_that_is_full_is_no_reason_to_push_on(memory: Memory, monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = Kernel()
    bench = Bench(opened(kernel), memory, monkeypatch)
    bench.run(2.0)
    kernel.failure = errno.ENOBUFS
    bench.run(2.5)
    assert bench.said[-1].startswith("socketcan:can0: nothing that was sent was transmitted")
    kernel.failure = None
    bench.run(10.0)
    assert bench.said[-1] == "socketcan:can0: has address 144"


def test_what_follows_a_frame_that_did_not_fit_is_not_sent(memory: Memory, monkeypatch: pytest.MonkeyPatch) -> None:
    """It would come before what it follows."""
    kernel = Kernel()
    bench = Bench(opened(kernel), memory, monkeypatch)
    bench.run(1.0)
    asked = [struct.pack("=IB3x8s", 0x98EA90F9, 3, bytes([group, 0xFE, 0])) for group in (1, 2, 3)]
    kernel.waiting += [(each, 0) for each in asked]
    before, kernel.room = len(kernel.sent), 1
    bench.run(0.01)
    assert [content[13] for content in kernel.sent[before:]] == [1]  # the first group alone is refused


def test_an_address_that_is_lost_is_told(memory: Memory, monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = Kernel()
    bench = Bench(opened(kernel), memory, monkeypatch)
    bench.run(1.0)
    lower = struct.pack("=IB3x8s", 0x98EEFF90, 8, bytes([1, 0, 0, 0, 0, 0, 0, 0]))
    kernel.waiting.append((lower, 0))
    bench.run(1.0)
    assert bench.said[-1] == (
        "socketcan:can0: others have all addresses that it may have, the last one to NAME 0000000000000001; "
        "nothing is told"
    )
    twin = struct.pack("=IB3x8s", 0x98EEFF95, 8, name(1).to_bytes(8, "little"))
    kernel.waiting += [(twin, 0), (twin, 0)]
    bench.run(1.0)
    assert bench.said[-1] == (
        "socketcan:can0: another device has the same NAME; give one of them another identity_number"
    )


def test_over_multicast_what_is_sent_comes_back_too() -> None:
    wire = Wire(multicast(), [144])
    assert wire.send(CLAIM)
    heard: list[Frame] = []
    while not heard:
        heard += wire.bus.receive()
    assert [frame[1:] for frame in heard] == [CLAIM[1:]]
    wire.bus.close()
    assert not wire.send(CLAIM)

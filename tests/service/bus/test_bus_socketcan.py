"""The SocketCAN code against a pair of local sockets that carry the kernel's structures; this needs no CAN."""

import errno
import selectors
import socket
import struct
from collections.abc import Iterator
from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.bus import BusError, open_bus, socketcan, socketcan_available
from service.bus.base import BATCH
from service.bus.socketcan import SocketCan, can_filters, unpack
from service.logs import Frame

EXTENDED = 0x8000_0000


@pytest.fixture
def ends() -> Iterator[tuple[SocketCan, socket.socket]]:
    """A bus, and the other end of its socket."""
    ours, kernel = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with kernel, SocketCan(ours, "can0") as bus:
        assert isinstance(bus, SocketCan)
        yield bus, kernel


def classic(can_id: int, size: int, data: bytes) -> bytes:
    return struct.pack("=IB3x8s", can_id, size, data)


def fd(can_id: int, size: int, data: bytes) -> bytes:
    return struct.pack("=IBB2x64s", can_id, size, 4, data)


def test_receives_classic_and_fd_frames_in_order(ends: tuple[SocketCan, socket.socket]) -> None:
    bus, kernel = ends
    assert bus.receive() == []
    kernel.send(classic(EXTENDED | 0x18FF103D, 8, bytes(range(8))))
    kernel.send(classic(0x123, 2, b"ab"))
    kernel.send(fd(EXTENDED | 1, 12, b"x" * 12))
    frames = bus.receive()
    assert [tuple(frame[1:]) for frame in frames] == [
        (0x18FF103D, True, bytes(range(8))),
        (0x123, False, b"ab"),
        (1, True, b"x" * 12),
    ]
    times = [frame.t for frame in frames]
    assert times == sorted(times)
    assert (bus.skipped, bus.dropped) == (0, 0)


@pytest.mark.parametrize(
    "content",
    [
        classic(0x4000_0123, 0, b""),  # remote
        classic(0x2000_0040, 8, bytes(8)),  # error: bus off
        classic(0x123, 9, bytes(8)),
        fd(0x123, 13, bytes(64)),
        fd(0x123, 65, bytes(64)),
        bytes(15),
        bytes(40),
    ],
)
def test_what_is_no_data_frame_is_skipped_and_counted(ends: tuple[SocketCan, socket.socket], content: bytes) -> None:
    bus, kernel = ends
    kernel.send(content)
    kernel.send(classic(0x123, 0, b""))
    assert [frame.can_id for frame in bus.receive()] == [0x123]
    assert bus.skipped == 1


def test_takes_a_bounded_batch(ends: tuple[SocketCan, socket.socket], monkeypatch: pytest.MonkeyPatch) -> None:
    bus, kernel = ends
    monkeypatch.setattr(socketcan, "BATCH", 5)
    for _ in range(7):
        kernel.send(classic(1, 0, b""))
    assert [len(bus.receive()) for _ in range(3)] == [5, 2, 0]
    assert BATCH <= 512


def test_can_wait_in_a_selector(ends: tuple[SocketCan, socket.socket]) -> None:
    bus, kernel = ends
    with selectors.DefaultSelector() as selector:
        selector.register(bus.fileno(), selectors.EVENT_READ)
        assert selector.select(0) == []
        kernel.send(classic(1, 0, b""))
        assert len(selector.select(1)) == 1


def test_sends_what_the_kernel_expects(ends: tuple[SocketCan, socket.socket]) -> None:
    bus, kernel = ends
    bus.send(Frame(0.0, 0x18FF103D, True, b"abcdefgh"))
    bus.send(Frame(0.0, 0x123, False, b""))
    bus.send(Frame(0.0, 0x123, False, b"x" * 12))
    assert kernel.recv(100) == classic(EXTENDED | 0x18FF103D, 8, b"abcdefgh")
    assert kernel.recv(100) == classic(0x123, 0, b"")
    assert kernel.recv(100) == fd(0x123, 12, b"x" * 12)


class Script:
    """A socket that does what it is told: bytes, with stamp and drops, or an errno."""

    def __init__(self, *steps: tuple[bytes, list[tuple[int, int, bytes]]] | int) -> None:
        self.steps = list(steps)
        self.sent: list[bytes] = []

    def setblocking(self, flag: bool) -> None:
        assert flag is False

    def recvmsg(self, *_sizes: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, None]:
        if not self.steps:
            raise BlockingIOError
        step = self.steps.pop(0)
        if isinstance(step, int):
            raise OSError(step, "told so")
        return (*step, 0, None)

    def send(self, content: bytes) -> None:
        if self.steps:
            step = self.steps.pop(0)
            assert isinstance(step, int)
            raise OSError(step, "told so")
        self.sent.append(content)


def scripted(*steps: tuple[bytes, list[tuple[int, int, bytes]]] | int) -> tuple[SocketCan, Script]:
    script = Script(*steps)
    return SocketCan(cast(socket.socket, script), "can0"), script


def stamp(t: float) -> tuple[int, int, bytes]:
    return socket.SOL_SOCKET, 35, struct.pack("@ll", int(t), int(t % 1 * 1e9))


def drops(count: int) -> tuple[int, int, bytes]:
    return socket.SOL_SOCKET, 40, struct.pack("@I", count)


def at(monkeypatch: pytest.MonkeyPatch, monotonic: float, wall: float) -> None:
    monkeypatch.setattr("time.monotonic", lambda: monotonic)
    monkeypatch.setattr("time.time", lambda: wall)


FRAME = classic(1, 0, b"")


def test_the_drop_counter_is_the_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    bus, _ = scripted((FRAME, [drops(3)]), (FRAME, [drops(7)]))
    assert len(bus.receive()) == 2
    assert bus.dropped == 7


def test_frames_that_waited_get_the_time_they_came(monkeypatch: pytest.MonkeyPatch) -> None:
    bus, _ = scripted((FRAME, [stamp(999.75)]), (FRAME, [stamp(999.875)]))
    at(monkeypatch, 50.0, 1000.0)
    assert [frame.t for frame in bus.receive()] == pytest.approx([49.75, 49.875], abs=1e-6)


@pytest.mark.parametrize("told", [4600.0, 900.0])
def test_a_wall_clock_that_was_set_does_not_move_a_frame(monkeypatch: pytest.MonkeyPatch, told: float) -> None:
    """SO_TIMESTAMPNS follows the wall clock: a step of an hour moved stamps by an hour, monotonic time by nothing."""
    bus, _ = scripted((FRAME, [stamp(told)]))
    at(monkeypatch, 50.0, 1000.0)
    assert [frame.t for frame in bus.receive()] == [50.0]


def test_time_never_goes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    bus, _ = scripted((FRAME, [stamp(999.9)]), (FRAME, [stamp(999.5)]))
    at(monkeypatch, 50.0, 1000.0)
    assert [frame.t for frame in bus.receive()] == pytest.approx([49.9, 49.9], abs=1e-6)


def test_an_interface_that_goes_down_may_come_back_and_is_counted() -> None:
    bus, script = scripted((FRAME, []), errno.ENETDOWN)
    assert len(bus.receive()) == 1
    script.steps += [(FRAME, []), errno.ENETDOWN]
    assert len(bus.receive()) == 1
    assert bus.link_downs == 2


def test_frames_queued_when_the_interface_went_down_are_taken() -> None:
    """The kernel reports ENETDOWN ahead of the frames that came before it (seen on Linux 6.1 with vcan)."""
    bus, _ = scripted(errno.ENETDOWN, (FRAME, []), (FRAME, []))
    assert len(bus.receive()) == 2
    assert bus.link_downs == 1


def test_an_interface_that_was_removed_is_an_error() -> None:
    """A socket whose device was deleted never receives again, even when the device is back."""
    bus, _ = scripted(errno.ENODEV)
    with pytest.raises(BusError, match="can0: lost: told so; start again once it is back"):
        bus.receive()


def test_waits_for_room_in_the_sending_queue() -> None:
    bus, script = scripted(errno.ENOBUFS, errno.EAGAIN)
    bus.send(Frame(0.0, 1, False, b""))
    assert script.sent == [FRAME]


def test_a_bus_that_takes_nothing_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socketcan, "PATIENCE_S", -1.0)
    bus, _ = scripted(errno.ENOBUFS)
    with pytest.raises(BusError, match="can0: does not take frames: told so"):
        bus.send(Frame(0.0, 1, False, b""))


@pytest.mark.parametrize(
    ("number", "remedy"),
    [(errno.ENETDOWN, "ip link set can0 up"), (errno.EINVAL, "CAN FD"), (errno.ENXIO, "start again")],
)
def test_a_frame_refused_at_once_names_the_remedy(number: int, remedy: str) -> None:
    bus, _ = scripted(number)
    with pytest.raises(BusError, match=f"can0: does not take frames: told so; .*{remedy}"):
        bus.send(Frame(0.0, 1, False, b""))


def _passes(filters: bytes, can_id: int) -> bool:
    """The kernel's rule (Documentation/networking/can.rst)."""
    return any(received_id & mask == can_id & mask for received_id, mask in struct.iter_unpack("=II", filters))


def test_kernel_filters_tell_11_from_29_bits_and_ignore_the_priority() -> None:
    filters = can_filters([0x00FF103D, -1 - 0x123])
    assert _passes(filters, EXTENDED | 0x18FF103D)
    assert _passes(filters, EXTENDED | 0x0CFF103D)
    assert _passes(filters, 0x123)
    assert not _passes(filters, EXTENDED | 0x18FF103E)
    assert not _passes(filters, EXTENDED | 0x123)
    assert not _passes(filters, 0x03D)
    assert not _passes(filters, 0x4000_0123)
    assert not _passes(filters, EXTENDED | 0x4000_0000 | 0x18FF103D)
    assert can_filters([]) == b""


@given(st.binary(max_size=100))
def test_no_content_breaks_the_bus(content: bytes) -> None:
    frame = unpack(content, 1.0)
    assert frame is None or len(frame.data) <= 64


@given(st.integers(0, 0x1FFF_FFFF), st.binary(max_size=8))
def test_unpacks_what_was_packed(can_id: int, data: bytes) -> None:
    content = classic(EXTENDED | can_id, len(data), data)
    assert unpack(content, 1.5) == Frame(1.5, can_id, True, data)


@pytest.mark.parametrize("spec", ["", "vcan0", "socketcan:", "socketcan:a/b", "socketcan:0123456789abcdef", "can:can0"])
def test_a_bus_has_to_be_named(spec: str) -> None:
    with pytest.raises(BusError, match="give socketcan:NAME"):
        open_bus(spec)


def test_an_interface_that_is_not_there_is_said_with_the_remedy() -> None:
    assert not socketcan_available("nocan7")
    with pytest.raises(BusError, match=r"socketcan:nocan7: .*(ip link add nocan7 type vcan|use udp_multicast)"):
        open_bus("socketcan:nocan7")

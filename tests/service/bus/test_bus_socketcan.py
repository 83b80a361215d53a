"""The SocketCAN code against a pair of local sockets that carry the kernel's structures; this needs no CAN."""

import errno
import selectors
import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from faultline.service.bus import BusError, open_bus, socketcan, socketcan_available
from faultline.service.bus.base import BATCH, QUEUE, Counts
from faultline.service.bus.interface import Interface, interface
from faultline.service.bus.reader import unpack
from faultline.service.bus.socketcan import LONGEST_RETRY_S, LOOK_S, RETRY_S, SocketCan, can_filters
from faultline.service.core.signals.decode import Wanted
from faultline.service.logs import Frame

EXTENDED, REMOTE, ERROR = 0x8000_0000, 0x4000_0000, 0x2000_0000
VIRTUAL, REAL = Interface(3, True, True, True), Interface(3, True, True, False)


def bus_of(sock: object, at: Interface = VIRTUAL) -> SocketCan:
    """A bus on this socket, on an interface that stays as it is."""
    return SocketCan("can0", make=lambda *_: cast(socket.socket, sock), look=lambda _: at)


@pytest.fixture
def ends() -> Iterator[tuple[SocketCan, socket.socket]]:
    """A bus, and the other end of its socket."""
    ours, kernel = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with kernel, bus_of(ours) as bus:
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
    assert (bus.counts, bus.dropped) == (Counts(frames=3), 0)


@pytest.mark.parametrize(
    ("content", "counted"),
    [
        (classic(REMOTE | 0x123, 0, b""), "remote"),
        (classic(ERROR | 0x40, 8, bytes(8)), "errors"),
        (classic(0x123, 9, bytes(8)), "malformed"),
        (fd(0x123, 13, bytes(64)), "malformed"),
        (fd(0x123, 65, bytes(64)), "malformed"),
        (struct.pack("=IBB2x64s", 0x123, 8, 0x80, b""), "malformed"),
        (bytes(15), "malformed"),
        (bytes(40), "malformed"),
    ],
)
def test_what_is_no_data_frame_is_left_alone_and_counted(
    ends: tuple[SocketCan, socket.socket], content: bytes, counted: str
) -> None:
    bus, kernel = ends
    kernel.send(content)
    kernel.send(classic(0x123, 0, b""))
    assert [frame.can_id for frame in bus.receive()] == [0x123]
    assert getattr(bus.counts, counted) == 1
    assert bus.counts.frames == 1


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
    """A socket that does what it is told: bytes, with stamp and drops, or an errno; `flags` are of all messages."""

    def __init__(self, *steps: tuple[bytes, list[tuple[int, int, bytes]]] | int, flags: int = 0) -> None:
        self.steps = list(steps)
        self.flags = flags
        self.sent: list[bytes] = []
        self.closed = False

    def fileno(self) -> int:
        return 7

    def close(self) -> None:
        self.closed = True

    def setblocking(self, flag: bool) -> None:
        assert flag is False

    def getsockopt(self, _level: int, option: int) -> int:
        assert option == socket.SO_RCVBUF
        return 2 * QUEUE

    def recvmsg(self, *_sizes: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, None]:
        if not self.steps:
            raise BlockingIOError
        step = self.steps.pop(0)
        if isinstance(step, int):
            raise OSError(step, "told so")
        return (*step, self.flags, None)

    def send(self, content: bytes) -> None:
        if self.steps:
            step = self.steps.pop(0)
            assert isinstance(step, int)
            raise OSError(step, "told so")
        self.sent.append(content)


def scripted(*steps: tuple[bytes, list[tuple[int, int, bytes]]] | int) -> tuple[SocketCan, Script]:
    script = Script(*steps)
    return bus_of(script), script


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
    at(monkeypatch, 40.0, 990.0)
    bus, _ = scripted((FRAME, [stamp(999.75)]), (FRAME, [stamp(999.875)]))
    at(monkeypatch, 50.0, 1000.0)
    assert [frame.t for frame in bus.receive()] == pytest.approx([49.75, 49.875], abs=1e-6)


@pytest.mark.parametrize("told", [4600.0, 900.0])
def test_a_wall_clock_that_was_set_does_not_move_a_frame(monkeypatch: pytest.MonkeyPatch, told: float) -> None:
    """SO_TIMESTAMPNS follows the wall clock: a step of an hour moved stamps by an hour, monotonic time by nothing."""
    at(monkeypatch, 40.0, 990.0)
    bus, _ = scripted((FRAME, [stamp(told)]))
    at(monkeypatch, 50.0, 1000.0)
    assert [frame.t for frame in bus.receive()] == [50.0]


def test_time_never_goes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    at(monkeypatch, 40.0, 990.0)
    bus, _ = scripted((FRAME, [stamp(999.9)]), (FRAME, [stamp(999.5)]))
    at(monkeypatch, 50.0, 1000.0)
    assert [frame.t for frame in bus.receive()] == pytest.approx([49.9, 49.9], abs=1e-6)


def test_an_interface_that_goes_down_may_come_back_and_is_counted() -> None:
    bus, script = scripted((FRAME, []), errno.ENETDOWN)
    assert [len(bus.receive()) for _ in range(2)] == [1, 0]
    assert (bus.counts.link_downs, bus.trouble) == (1, "down")
    script.steps += [(FRAME, []), errno.ENETDOWN]
    assert [len(bus.receive()) for _ in range(2)] == [1, 0]
    assert (bus.counts.link_downs, bus.trouble) == (2, "down")


def test_frames_queued_when_the_interface_went_down_are_taken() -> None:
    """The kernel reports ENETDOWN ahead of the frames that came before it (seen on Linux 6.1 with vcan)."""
    bus, _ = scripted(errno.ENETDOWN, (FRAME, []), (FRAME, []))
    assert len(bus.receive()) == 2
    assert (bus.counts.link_downs, bus.trouble) == (1, None)


def test_a_device_that_is_removed_while_it_is_up_is_first_down() -> None:
    """Both are told at once: ENETDOWN, then ENODEV (seen on Linux 6.1 with vcan)."""
    bus, script = scripted(errno.ENETDOWN, errno.ENODEV)
    assert bus.receive() == []
    assert (bus.trouble, bus.counts.link_downs, bus.counts.removals, script.closed) == ("removed", 1, 1, True)


@dataclass
class Plug:
    """An interface that comes and goes, and a socket for each time that it is there."""

    there: Interface | None = VIRTUAL
    now: float = 0.0
    sockets: list[Script] = field(default_factory=list)

    def bus(self, *, believe_local: bool = False, required: bool = True) -> SocketCan:
        return SocketCan(
            "can0",
            believe_local=believe_local,
            required=required,
            make=self.make,
            look=lambda _: self.there,
            clock=lambda: self.now,
        )

    def make(self, name: str, _wanted: object) -> socket.socket:
        if self.there is None or not self.there.is_up:
            raise BusError(f"{name} is not there")
        self.sockets.append(Script())
        return cast(socket.socket, self.sockets[-1])

    def later(self, bus: SocketCan, seconds: float) -> list[Frame]:
        """What the bus receives while time goes on in tenths of a second."""
        frames = []
        for _ in range(round(10 * seconds)):
            self.now += 0.1
            frames += bus.receive()
        return frames


@pytest.mark.parametrize("number", [errno.ENODEV, errno.ENXIO, errno.EBADF, errno.EINVAL, errno.EIO])
def test_a_socket_that_is_of_no_more_use_is_replaced(number: int) -> None:
    """A socket whose device was deleted never receives again, even when the device is back."""
    plug = Plug()
    bus = plug.bus()
    plug.sockets[0].steps += [(FRAME, [drops(3)]), number, (FRAME, [])]
    plug.there = None
    assert [len(bus.receive()) for _ in range(2)] == [1, 0]
    assert (bus.trouble, bus.fileno(), plug.sockets[0].closed) == ("removed", -1, True)
    assert plug.later(bus, 60.0) == []
    plug.there = VIRTUAL._replace(number=4)
    assert plug.later(bus, LONGEST_RETRY_S) == []
    assert (bus.trouble, bus.fileno(), len(plug.sockets)) == (None, 7, 2)
    plug.sockets[1].steps.append((FRAME, [drops(2)]))
    assert len(bus.receive()) == 1
    assert (bus.dropped, bus.counts.removals, bus.counts.frames) == (5, 1, 2)


def test_an_interface_that_was_replaced_while_nobody_heard_is_noticed() -> None:
    plug = Plug()
    bus = plug.bus()
    plug.later(bus, 2.0)
    assert len(plug.sockets) == 1
    plug.there = VIRTUAL._replace(number=9)
    plug.later(bus, LOOK_S + RETRY_S + 0.2)
    assert (len(plug.sockets), bus.counts.removals, bus.trouble) == (2, 1, None)


def test_an_interface_goes_down_and_up_a_hundred_times() -> None:
    plug = Plug()
    bus = plug.bus()
    told: list[str | None] = []
    for _ in range(100):
        plug.there = VIRTUAL._replace(is_up=False)
        plug.sockets[0].steps.append(errno.ENETDOWN)
        plug.later(bus, 1.5)
        told.append(bus.trouble)
        plug.there = VIRTUAL
        plug.sockets[0].steps.append((FRAME, []))
        assert len(plug.later(bus, 1.5)) == 1
        told.append(bus.trouble)
    assert told == 100 * ["down", None]
    assert (len(plug.sockets), bus.counts.link_downs, bus.counts.frames) == (1, 100, 100)


def test_an_interface_that_is_silently_down_is_noticed() -> None:
    plug = Plug()
    bus = plug.bus()
    plug.there = VIRTUAL._replace(is_up=False)
    plug.later(bus, 1.2)
    assert bus.trouble == "down"
    plug.there = VIRTUAL
    plug.later(bus, 1.2)
    assert bus.trouble is None


def test_a_bus_that_is_not_required_may_come_later() -> None:
    plug = Plug(there=None)
    with pytest.raises(BusError, match="not there"):
        plug.bus()
    bus = plug.bus(required=False)
    assert (bus.trouble, bus.fileno()) == ("removed", -1)
    with pytest.raises(BusError, match="can0: is not there"):
        bus.send(Frame(0.0, 1, False, b""))
    plug.there = VIRTUAL._replace(is_up=False)
    plug.later(bus, LONGEST_RETRY_S)
    assert bus.trouble == "down"
    plug.there = VIRTUAL
    plug.later(bus, LONGEST_RETRY_S)
    assert [bus.trouble, bus.fileno(), bus.counts.removals] == [None, 7, 0]


@pytest.mark.parametrize("number", [errno.ENOBUFS, errno.ENOMEM])
def test_a_kernel_short_of_memory_loses_a_frame_and_not_the_socket(number: int) -> None:
    plug = Plug()
    bus = plug.bus()
    plug.sockets[0].steps += [number, (FRAME, [])]
    assert bus.receive() == []
    assert len(bus.receive()) == 1
    assert (bus.dropped, bus.trouble, len(plug.sockets)) == (1, None, 1)


@pytest.mark.parametrize(("at", "believe", "taken"), [(VIRTUAL, False, 1), (REAL, False, 0), (REAL, True, 1)])
def test_frames_of_this_machine_are_believed_where_there_is_no_vehicle(
    at: Interface, believe: bool, taken: int
) -> None:
    plug = Plug(there=at)
    bus = plug.bus(believe_local=believe)
    plug.sockets[0].flags = socket.MSG_DONTROUTE
    plug.sockets[0].steps += [(FRAME, []), (classic(ERROR | 0x40, 8, bytes(8)), [])]
    assert len(bus.receive()) == taken
    assert bus.counts.local == 2 * (1 - taken)
    assert bus.trouble == ("bus-off" if taken else None)


def test_frames_may_have_waited_as_long_as_the_queue_was_not_empty(monkeypatch: pytest.MonkeyPatch) -> None:
    """More than 5 s had been taken for a clock that was set, and a backlog for one moment."""
    at(monkeypatch, 40.0, 990.0)
    bus, script = scripted()
    assert bus.receive() == []  # empty at 40
    script.steps += [(FRAME, [stamp(991.0 + k)]) for k in range(30)]
    at(monkeypatch, 80.0, 1030.0)
    assert [frame.t for frame in bus.receive()] == pytest.approx([41.0 + k for k in range(30)], abs=1e-6)


def test_what_the_driver_lost_is_counted_once() -> None:
    """It says so in an error frame as well."""
    lost = [7]
    plug = Plug()
    bus = SocketCan("can0", make=plug.make, look=lambda _: VIRTUAL, lost=lambda _: lost[0], clock=lambda: plug.now)
    assert bus.dropped == 0  # since it was opened
    plug.sockets[0].steps.append((error(0x04, 0x01), []))
    bus.receive()
    lost[0] += 3
    plug.later(bus, 2.0)
    assert bus.dropped == 3


def test_a_controller_is_well_again_after_a_minute_of_frames() -> None:
    plug = Plug()
    bus = plug.bus()
    plug.sockets[0].steps += [(error(0x04, 0x20), []), (FRAME, [])]
    bus.receive()
    bus.receive()
    assert bus.trouble == "error-passive"
    plug.now += 61.0
    plug.sockets[0].steps.append((FRAME, []))
    bus.receive()
    assert bus.trouble is None


def error(kind: int, status: int = 0) -> bytes:
    return classic(ERROR | kind, 8, bytes([0, status, 0, 0, 0, 0, 0, 0]))


@pytest.mark.parametrize(
    ("frames", "trouble"),
    [
        ([error(0x40)], "bus-off"),
        ([error(0x40), error(0x100)], None),
        ([error(0x40), FRAME], None),
        ([error(0x04, 0x10)], "error-passive"),
        ([error(0x04, 0x20), FRAME], "error-passive"),
        ([error(0x04, 0x20), error(0x04, 0x40)], None),
        ([error(0x04, 0x20), error(0x04, 0x08)], None),
        ([error(0x04, 0x20), error(0x02)], "error-passive"),
        ([error(0x08, 0xFF)], None),
    ],
)
def test_error_frames_say_how_the_bus_is(frames: list[bytes], trouble: str | None) -> None:
    bus, script = scripted()
    for frame in frames:
        script.steps.append((frame, []))
        bus.receive()
    assert bus.trouble == trouble
    assert bus.counts.bus_offs == (frames[0] == error(0x40))


def test_a_controller_that_could_not_store_a_frame_has_lost_one() -> None:
    bus, _ = scripted((error(0x04, 0x01), []), (error(0x04, 0x11), []))
    bus.receive()
    assert bus.dropped == 2


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
    filters = can_filters([Wanted(0x00FF103D, 0x03FF_FFFF, True), Wanted(0x123, 0x7FF, False)])
    assert _passes(filters, EXTENDED | 0x18FF103D)
    assert _passes(filters, EXTENDED | 0x0CFF103D)
    assert _passes(filters, 0x123)
    assert not _passes(filters, EXTENDED | 0x18FF103E)
    assert not _passes(filters, EXTENDED | 0x123)
    assert not _passes(filters, 0x03D)
    assert not _passes(filters, 0x4000_0123)
    assert not _passes(filters, EXTENDED | 0x4000_0000 | 0x18FF103D)
    assert can_filters([]) == b""


@pytest.mark.parametrize(
    ("mtu", "device", "virtual"), [("72", False, True), ("16", False, False), ("16", True, False), ("72", True, False)]
)
def test_an_interface_without_a_device_or_can_fd_is_a_serial_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mtu: str, device: bool, virtual: bool
) -> None:
    """What processes of this machine send is taken for the vehicle's on a virtual interface only."""
    monkeypatch.setattr("faultline.service.bus.interface.SYS", tmp_path)
    folder = tmp_path / "can0"
    folder.mkdir()
    for name, text in (("ifindex", "3"), ("type", "280"), ("flags", "0x41"), ("mtu", mtu)):
        (folder / name).write_text(f"{text}\n")
    if device:
        (folder / "device").mkdir()
    assert interface("can0") == Interface(3, True, True, virtual)


@given(st.binary(max_size=100))
def test_no_content_breaks_the_bus(content: bytes) -> None:
    _, data = unpack(content)
    assert data is None or len(data) <= 64


@given(st.integers(0, 0x1FFF_FFFF), st.binary(max_size=8))
def test_unpacks_what_was_packed(can_id: int, data: bytes) -> None:
    content = classic(EXTENDED | can_id, len(data), data)
    assert unpack(content) == (EXTENDED | can_id, data)


@pytest.mark.parametrize("spec", ["", "vcan0", "socketcan:", "socketcan:a/b", "socketcan:0123456789abcdef", "can:can0"])
def test_a_bus_has_to_be_named(spec: str) -> None:
    with pytest.raises(BusError, match="give socketcan:NAME"):
        open_bus(spec)


def test_an_interface_that_is_not_there_is_said_with_the_remedy() -> None:
    assert not socketcan_available("nocan7")
    with pytest.raises(BusError, match=r"socketcan:nocan7: .*(ip link add nocan7 type vcan|use udp_multicast)"):
        open_bus("socketcan:nocan7")

"""Messages taken together are those taken one by one: the same sockets, the same frames, stamps and errors."""

import ctypes
import errno
import socket
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from faultline.service.bus.reader import _RECVMMSG, CLASSIC, FD, ROOM, OneByOne, Reader, Together, reader_of

Pair = tuple[socket.socket, socket.socket]
SO_TIMESTAMPNS = 35


@pytest.fixture
def ends() -> Iterator[Pair]:
    """A socket to read, which stamps what comes, and the kernel's end."""
    ours, kernel = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with ours, kernel:
        ours.setblocking(False)
        ours.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        yield ours, kernel


def together(sock: socket.socket) -> Together:
    assert _RECVMMSG is not None, "the tests run on 64-bit Linux"
    return Together(sock, _RECVMMSG)


BOTH = pytest.mark.parametrize("make", [OneByOne, together])


def test_the_best_is_taken(ends: Pair) -> None:
    assert isinstance(reader_of(ends[0]), Together)


@BOTH
@pytest.mark.parametrize("count", [0, 1, 5, ROOM, ROOM + 1])
def test_all_that_waits_is_taken_in_order_up_to_a_limit(
    make: Callable[[socket.socket], Reader], count: int, ends: Pair
) -> None:
    ours, kernel = ends
    kernel.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
    read = make(ours)
    sent = 0
    for number in range(count):
        try:
            kernel.send(CLASSIC.pack(number, number % 9, bytes([number % 256] * 8)), socket.MSG_DONTWAIT)
        except BlockingIOError:  # a Unix socket's queue is short
            break
        sent += 1
    found = [*read(3), *read(1000)]
    assert [(m.identifier, m.data) for m in found] == [(n, bytes([n % 256] * (n % 9))) for n in range(sent)]
    assert read(10) == []


@BOTH
def test_stamps_are_the_wall_clock(make: Callable[[socket.socket], Reader]) -> None:
    """A datagram socket of the network stamps; one of this machine's files does not."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out,
    ):
        ours.setblocking(False)
        ours.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        ours.bind(("127.0.0.1", 0))
        before = time.time()
        for n in range(3):
            out.sendto(CLASSIC.pack(n, 8, bytes(8)), ours.getsockname())
        found = make(ours)(10)
        assert len(found) == 3
        assert all(before - 0.01 <= message.stamp <= time.time() + 0.01 for message in found)
        assert [message.drops for message in found] == [None] * 3


@BOTH
def test_nothing_waits_on_and_on(make: Callable[[socket.socket], Reader], ends: Pair) -> None:
    read = make(ends[0])
    before = len([*Path("/proc/self/fd").iterdir()])
    for _ in range(1000):
        assert read(512) == []
    assert len([*Path("/proc/self/fd").iterdir()]) == before


@given(st.lists(st.binary(max_size=100), max_size=20))
def test_no_content_makes_a_difference(contents: list[bytes]) -> None:
    found = []
    for make in (OneByOne, together):
        ours, kernel = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        with ours, kernel:
            ours.setblocking(False)
            for content in contents[:10]:
                kernel.send(content)
            found.append(make(ours)(100))
    assert found[0] == found[1]
    assert all(message[1] is None or len(message[1]) <= 64 for message in found[0])


class Kernel:
    """A `recvmmsg` that fills in what it is told: a count with control data, or an errno."""

    def __init__(self, *steps: int | list[tuple[bytes, bytes, int]]) -> None:
        self.steps = list(steps)

    def __call__(self, _fd: int, at: int, _room: int, _flags: int, _none: None) -> int:
        step = self.steps.pop(0) if self.steps else errno.EAGAIN
        if isinstance(step, int):
            ctypes.set_errno(step)
            return -1
        for k, (raw, control, flags) in enumerate(step):
            header = at + 64 * k
            (part,) = struct.unpack("=Q", ctypes.string_at(header + 16, 8))
            (frames,) = struct.unpack("=Q", ctypes.string_at(part, 8))
            (controls,) = struct.unpack("=Q", ctypes.string_at(header + 32, 8))
            ctypes.memmove(frames, raw, len(raw))
            ctypes.memmove(controls, control, len(control))
            ctypes.memmove(header + 40, struct.pack("=QixxxxI", len(control), flags, len(raw)), 20)
        return len(step)


STAMP = struct.pack("=Qiiqq", 32, 1, 35, 1000, 500_000_000)
DROPS = struct.pack("=QiiI", 20, 1, 40, 7)
FRAME = CLASSIC.pack(5, 2, b"ab")


def test_extras_are_read_where_they_are(ends: Pair) -> None:
    kernel = Kernel(
        [(FRAME, STAMP, 0), (FRAME, STAMP + DROPS, 4), (FRAME, b"", 0), (FD.pack(6, 12, 4, b"x"), STAMP, 0)]
    )
    assert [tuple(message) for message in Together(ends[0], kernel)(10)] == [
        (5, b"ab", False, 1000.5, None),
        (5, b"ab", True, 1000.5, 7),
        (5, b"ab", False, 0.0, None),
        (6, b"x" + bytes(11), False, 1000.5, None),
    ]


def test_an_error_behind_frames_comes_with_the_next_call(ends: Pair) -> None:
    """The kernel keeps it: the frames before it are told first, and it is not lost."""
    whole = [(FRAME, b"", 0)] * ROOM
    read = Together(ends[0], Kernel(errno.EINTR, whole, errno.ENETDOWN, errno.ENODEV))
    assert len(read(512)) == ROOM
    for said in ("Network is down", "No such device"):
        with pytest.raises(OSError, match=said):
            read(512)
    assert read(512) == []

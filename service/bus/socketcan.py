"""SocketCAN through the standard library's socket.

Not python-can, because that can neither report the kernel's drops nor enlarge its queue. Constants and structures are
those of linux/can.h, linux/can/raw.h and asm-generic/socket.h; Python 3.11 lacks CAN_RAW_ERR_FILTER.
"""

import errno
import socket
import struct
import time
from collections.abc import Iterable
from pathlib import Path

from service.bus.base import BATCH, QUEUE, SO_TIMESTAMPNS, Bus, BusError, wall_stamp
from service.logs import Frame

CAN_RAW_FILTER, CAN_RAW_ERR_FILTER, CAN_RAW_RECV_OWN_MSGS, CAN_RAW_FD_FRAMES = 1, 2, 4, 5
SO_RXQ_OVFL = 40
EFF_FLAG, RTR_FLAG, ERR_FLAG = 0x8000_0000, 0x4000_0000, 0x2000_0000
ERROR_CLASSES = 0x1FFF_FFFF & ~0x80  # all but bus errors, which may come as fast as the bus runs
PRIORITY_MASK = 0x03FF_FFFF  # J1939: parameter group and source address
IFF_UP = 1

PATIENCE_S = 1.0  # how long a full sending queue may stay full

_REMEDIES = {
    errno.ENETDOWN: "ip link set {name} up",
    errno.EINVAL: "more than 8 bytes need an interface with CAN FD, and 64 is the most",
    errno.ENODEV: "start again once it is back",
    errno.ENXIO: "start again once it is back",
}
"""What helps where sending failed at once."""

_CLASSIC = struct.Struct("=IB3x8s")
_FD = struct.Struct("=IBB2x64s")
_FD_FLAG = 0x04
_FD_SIZES = frozenset([*range(9), 12, 16, 20, 24, 32, 48, 64])
_DROPS = struct.Struct("@I")


class SocketCan(Bus):
    """A raw CAN socket. It works again once an interface that went down is up."""

    def __init__(self, sock: socket.socket, name: str) -> None:
        super().__init__()
        sock.setblocking(False)
        self._socket = sock
        self._name = name
        self._dropped = 0

    @property
    def dropped(self) -> int:
        """As of the last frame received: the kernel tells with the next frame it accepts."""
        return self._dropped

    def fileno(self) -> int:
        """Of the socket."""
        return self._socket.fileno()

    def receive(self) -> list[Frame]:
        """At most `BATCH` frames; raises `BusError` where none will ever come again."""
        frames: list[Frame] = []
        for _ in range(BATCH):
            try:
                content, extras, _flags, _address = self._socket.recvmsg(_FD.size, 256)
            except BlockingIOError:
                break
            except OSError as error:
                self._lost(error)
                continue  # it is told ahead of the frames that came before it
            self._count_drops(extras)
            frame = unpack(content, self._arrival(wall_stamp(extras)))
            if frame is None:
                self.skipped += 1
            else:
                frames.append(frame)
        return frames

    def _lost(self, error: OSError) -> None:
        """ENETDOWN comes once and heals by itself; a socket whose device was removed never receives again."""
        if error.errno != errno.ENETDOWN:
            raise BusError(f"{self._name}: lost: {error.strerror}; start again once it is back") from error
        self.link_downs += 1

    def _count_drops(self, extras: list[tuple[int, int, bytes]]) -> None:
        """The kernel's counter is cumulative."""
        for level, kind, data in extras:
            if level == socket.SOL_SOCKET and kind == SO_RXQ_OVFL and len(data) == _DROPS.size:
                (self._dropped,) = _DROPS.unpack(data)

    def send(self, frame: Frame) -> None:
        """Sends; waits up to a second for room in a full queue."""
        identifier = frame.can_id | (EFF_FLAG if frame.is_extended else 0)
        size = len(frame.data)
        content = (
            _CLASSIC.pack(identifier, size, frame.data)
            if size <= 8
            else _FD.pack(identifier, size, _FD_FLAG, frame.data)
        )
        end = time.monotonic() + PATIENCE_S
        while True:
            try:
                self._socket.send(content)
            except OSError as error:
                # A full queue shows as ENOBUFS and no poll reports when it has room again.
                if error.errno not in (errno.EAGAIN, errno.ENOBUFS) or time.monotonic() > end:
                    remedy = _REMEDIES.get(error.errno or 0, "is anybody on the bus?").format(name=self._name)
                    raise BusError(f"{self._name}: does not take frames: {error.strerror}; {remedy}") from error
                time.sleep(0.001)
            else:
                return

    def close(self) -> None:
        """Closes the socket."""
        self._socket.close()


def can_socket(name: str, identifiers: Iterable[int]) -> socket.socket:
    """A raw socket on the interface, which is up; `identifiers` as for `service.bus.open_bus`.

    Raises:
        BusError: no such interface, it is down, or this kernel has no CAN.
    """
    try:
        sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except OSError as error:
        raise BusError(f"socketcan:{name}: this kernel has no CAN ({error.strerror}); use udp_multicast") from error
    try:
        _configure(sock, identifiers)
        sock.bind((name,))
        flags = Path(f"/sys/class/net/{name}/flags").read_text()
    except OSError as error:
        sock.close()
        raise BusError(
            f"socketcan:{name}: {error.strerror or error}; ip link add {name} type vcan && ip link set {name} up, "
            "or name an interface that is there"
        ) from error
    if not int(flags, 16) & IFF_UP:
        sock.close()
        raise BusError(f"socketcan:{name}: is down; ip link set {name} up")
    return sock


def _configure(sock: socket.socket, identifiers: Iterable[int]) -> None:
    """Before binding, so that no frame comes unfiltered or unstamped."""
    filters = can_filters(identifiers)
    if filters:
        sock.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_FILTER, filters)
    sock.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_ERR_FILTER, struct.pack("=I", ERROR_CLASSES))
    sock.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_RECV_OWN_MSGS, 0)
    sock.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_FD_FRAMES, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, QUEUE)
    sock.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
    sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)


def can_filters(identifiers: Iterable[int]) -> bytes:
    """The kernel's filter list, of `struct can_filter`: identifier and mask.

    Both flags are masked, so that an 11-bit frame never passes for a 29-bit one, nor a remote frame for a data frame.
    """
    rows = [
        (EFF_FLAG | n, EFF_FLAG | RTR_FLAG | PRIORITY_MASK) if n >= 0 else (-1 - n, EFF_FLAG | RTR_FLAG | 0x7FF)
        for n in identifiers
    ]
    return b"".join(struct.pack("=II", *row) for row in rows)


def unpack(content: bytes, t: float) -> Frame | None:
    """The data frame in 16 or 72 bytes as the kernel gives them (`struct can_frame`, `canfd_frame`); None if none."""
    if len(content) == _CLASSIC.size:
        identifier, size, data = _CLASSIC.unpack(content)
        valid = size <= 8
    elif len(content) == _FD.size:
        identifier, size, _flags, data = _FD.unpack(content)
        valid = size in _FD_SIZES
    else:
        return None
    if not valid or identifier & (RTR_FLAG | ERR_FLAG):
        return None
    return Frame(t, identifier & 0x1FFF_FFFF, bool(identifier & EFF_FLAG), data[:size])

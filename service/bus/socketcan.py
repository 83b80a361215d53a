"""SocketCAN through the standard library's socket.

Not python-can, because that can neither report the kernel's drops nor enlarge its queue. Constants and structures are
those of linux/can.h, linux/can/raw.h and asm-generic/socket.h; Python 3.11 lacks CAN_RAW_ERR_FILTER.
"""

import errno
import socket
import struct
import time
from collections.abc import Callable, Iterable, Sequence

from faultline.service.bus.base import BATCH, QUEUE, SLACK_S, SO_TIMESTAMPNS, Bus, BusError, rest_of
from faultline.service.bus.error_frame import BUS_OFF, CONTROLLER, RESTARTED, read_error
from faultline.service.bus.interface import Interface, interface, losses
from faultline.service.bus.reader import CLASSIC, FD, SO_RXQ_OVFL, Message, Reader, reader_of
from faultline.service.core.signals.decode import Wanted
from faultline.service.logs import Frame

CAN_RAW_FILTER, CAN_RAW_ERR_FILTER, CAN_RAW_RECV_OWN_MSGS, CAN_RAW_FD_FRAMES = 1, 2, 4, 5
EFF_FLAG, RTR_FLAG, ERR_FLAG = 0x8000_0000, 0x4000_0000, 0x2000_0000
ERROR_CLASSES = BUS_OFF | RESTARTED | CONTROLLER
"""Error frames that have any of these are given: bus errors alone may come as fast as the bus runs."""

PATIENCE_S = 1.0  # how long a full sending queue may stay full
LOOK_S = 1.0  # how often the interface is looked at: what was removed while it was down says nothing
PASSIVE_S = 60.0  # frames and no error frame for so long, and the controller is no longer passive
RETRY_S, LONGEST_RETRY_S = 0.2, 5.0  # a lost interface is tried again after that, twice as long each time

_SHORTAGE = (errno.ENOBUFS, errno.ENOMEM)
"""The kernel had no room for a frame or for us; the socket is as good as before."""

_REMEDIES = {
    errno.ENETDOWN: "ip link set {name} up",
    errno.EINVAL: "more than 8 bytes need an interface with CAN FD, and 64 is the most",
    errno.ENODEV: "start again once it is back",
    errno.ENXIO: "start again once it is back",
}
"""What helps where sending failed at once."""

_NO_DATA = RTR_FLAG | ERR_FLAG
_frame = tuple.__new__  # a frame without the named tuple's own check of its arguments, which takes as long as the rest

_FD_FLAG = 0x04


class SocketCan(Bus):
    """A raw CAN socket that outlives its interface.

    An interface that goes down and up again goes on by itself. A socket whose device was removed never receives again,
    though it can be bound to the next one of that name (seen on Linux 6.1): so it is closed, and a new one made once
    there is a device.

    What a process of this machine sends is believed on a virtual interface, which has nothing else, and elsewhere only
    with `believe_local`. Without `required` an interface need not be there yet.

    Raises:
        BusError: this kernel has no CAN, or the interface is `required` and not there or not up.
    """

    def __init__(
        self,
        name: str,
        wanted: Iterable[Wanted] | None = None,
        *,
        believe_local: bool = False,
        required: bool = True,
        make: "Callable[[str, Iterable[Wanted] | None], socket.socket] | None" = None,
        look: Callable[[str], Interface | None] = interface,
        lost: Callable[[str], int | None] = losses,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self._name = name
        self._wanted = None if wanted is None else tuple(wanted)
        self._believe_local = believe_local
        self._make, self._look, self._lost, self._clock = make or can_socket, look, lost, clock
        self._counted: int | None = None  # what controller and driver had lost at the last look
        self._socket: socket.socket | None = None
        self._read: Reader | None = None
        self._at: Interface | None = None  # what the socket is bound to
        self._local = believe_local  # whether what processes of this machine send is taken
        self._error_at = 0.0
        self._dropped = self._dropped_before = 0  # by this socket and by those before it
        self._wait, self._due = RETRY_S, clock() + RETRY_S
        try:
            self._open()
        except BusError as error:
            if required:
                raise
            self.why = str(error)
            self._absent()

    @property
    def dropped(self) -> int:
        """Return the frames lost; the kernel reports with the next one it accepts, the driver within a second."""
        return self._dropped_before + self._dropped

    def fileno(self) -> int:
        """Return the socket's descriptor."""
        return -1 if self._socket is None else self._socket.fileno()

    def receive(self) -> list[Frame]:
        """At most `BATCH` frames."""
        self._check()
        begun = time.monotonic()
        messages = self._messages()
        frames: list[Frame] = []
        now = time.monotonic()
        apart, last = now - time.time(), self._last
        earliest, latest = self._empty - SLACK_S, now + SLACK_S
        self.is_read_out = len(messages) < BATCH
        if self.is_read_out:
            self._empty = begun
        for identifier, data, is_local, stamp, drops in messages:
            if drops is not None:
                self._dropped = drops  # cumulative
            if data is None or identifier & _NO_DATA or (is_local and not self._local):
                self._no_frame(identifier, data, is_local)
                continue
            t = stamp + apart
            if not earliest < t < latest:
                t = now
            if t > last:
                last = t
            frames.append(_frame(Frame, (last, identifier & 0x1FFF_FFFF, identifier >= EFF_FLAG, data)))
            if self.trouble is not None:
                self._heard()
        self._last = last
        self.counts.frames += len(frames)
        return frames

    def _messages(self) -> list[Message]:
        """Return the messages that wait at the socket."""
        while self._read is not None:
            try:
                return self._read(BATCH)
            except OSError as error:
                if not self._goes_on(error):  # that it is down is told ahead of the frames that came before that
                    break
        return []

    def _heard(self) -> None:
        """Note a frame: the bus is back. A controller may be well again without an error frame."""
        passive = self.trouble == "error-passive"
        if not passive or self._clock() - self._error_at > PASSIVE_S:
            self.trouble = None

    def _no_frame(self, identifier: int, data: bytes | None, is_local: bool) -> None:
        if data is None:
            self.counts.malformed += 1
        elif is_local and not self._local:
            self.counts.local += 1
        elif identifier & ERR_FLAG:
            self._error(identifier & 0x1FFF_FFFF, data)
        else:
            self.counts.remote += 1

    def _error(self, identifier: int, data: bytes) -> None:
        self.counts.errors += 1
        self._error_at = self._clock()
        news = read_error(identifier, data)
        self._dropped_before += news.overflow and self._counted is None  # one at least, where nobody counts them
        if news.changed:
            self.counts.bus_offs += news.trouble == "bus-off" != self.trouble
            self.trouble = news.trouble

    def _goes_on(self, error: OSError) -> bool:
        """Handle an error; return True if there may be frames behind it."""
        if error.errno == errno.ENETDOWN:  # comes once, and heals by itself
            self.counts.link_downs += 1
            self.trouble = "down"
            return True
        if error.errno in _SHORTAGE:
            self._dropped_before += 1
        else:
            self._lose()
        return False

    def _check(self) -> None:
        """Check the interface if that is due."""
        now = self._clock()
        if now < self._due:
            return
        self._due = now + LOOK_S
        if self._socket is None:
            self._try_again(now)
            return
        self._count()
        there = self._look(self._name)
        if there is None or self._at is None or there.number != self._at.number:
            self._lose()
        elif not there.is_up:
            self.trouble = "down"
        elif self.trouble == "down":
            self.trouble = None

    def _count(self) -> None:
        """Count what controller and driver have lost since the last call."""
        now, before = self._lost(self._name), self._counted
        if now is not None and before is not None:
            self._dropped_before += max(0, now - before)
        self._counted = now

    def _try_again(self, now: float) -> None:
        try:
            self._open()
        except BusError as error:
            self.why = str(error)
            self._absent()
            self._wait = min(2.0 * self._wait, LONGEST_RETRY_S)
            self._due = now + self._wait

    def _absent(self) -> None:
        self.trouble = "removed" if self._look(self._name) is None else "down"

    def _open(self) -> None:
        self._socket = self._make(self._name, self._wanted)
        self._socket.setblocking(False)
        self._read = reader_of(self._socket)
        self.rest_s = rest_of(self._socket)
        self._at = self._look(self._name)
        self._local = self._believe_local or (self._at is not None and self._at.virtual)
        self._wait, self.trouble, self.why = RETRY_S, None, ""
        self._counted = self._lost(self._name)
        self._due = self._clock() + LOOK_S

    def _lose(self) -> None:
        """Close the socket, which is of no more use."""
        if self._socket is not None:
            self._socket.close()
        self._socket = self._read = None
        self._dropped_before, self._dropped = self.dropped, 0
        self.counts.removals += 1
        self.trouble = "removed"
        self._due = self._clock() + self._wait

    def want(self, wanted: Sequence[Wanted]) -> None:
        """Set the kernel's filter to these frames."""
        self._wanted = tuple(wanted)
        if self._socket is not None:
            self._socket.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_FILTER, can_filters(self._wanted))

    def send(self, frame: Frame) -> None:
        """Send; wait up to a second for room in a full queue."""
        identifier = frame.can_id | (EFF_FLAG if frame.is_extended else 0)
        size = len(frame.data)
        content = (
            CLASSIC.pack(identifier, size, frame.data) if size <= 8 else FD.pack(identifier, size, _FD_FLAG, frame.data)
        )
        if self._socket is None:
            raise BusError(f"{self._name}: is not there; {_REMEDIES[errno.ENODEV]}")
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
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()


def can_socket(name: str, wanted: Iterable[Wanted] | None) -> socket.socket:
    """Open a raw socket on the interface, which is up; `wanted` as for `service.bus.open_bus`.

    Raises:
        BusError: no such interface, it is down, or this kernel has no CAN.
    """
    try:
        sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except OSError as error:
        raise BusError(f"socketcan:{name}: this kernel has no CAN ({error.strerror}); use udp_multicast") from error
    try:
        _configure(sock, wanted)
        sock.bind((name,))
    except OSError as error:
        sock.close()
        raise BusError(
            f"socketcan:{name}: {error.strerror or error}; ip link add {name} type vcan && ip link set {name} up, "
            "or name an interface that is there"
        ) from error
    there = interface(name)
    if there is None or not there.is_up:
        sock.close()
        raise BusError(f"socketcan:{name}: is down; ip link set {name} up")
    return sock


def _configure(sock: socket.socket, wanted: Iterable[Wanted] | None) -> None:
    """Configure it before binding, so that no frame comes unfiltered or unstamped."""
    if wanted is not None:
        sock.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_FILTER, can_filters(wanted))
    sock.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_ERR_FILTER, struct.pack("=I", ERROR_CLASSES))
    sock.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_RECV_OWN_MSGS, 0)
    sock.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_FD_FRAMES, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, QUEUE)
    sock.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)
    sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)


def can_filters(wanted: Iterable[Wanted]) -> bytes:
    """Return the kernel's filter list, of `struct can_filter`: identifier and mask.

    Both flags are masked, so that an 11-bit frame never passes for a 29-bit one, nor a remote frame for a data frame.
    """
    rows = [(n | EFF_FLAG * extended, mask | EFF_FLAG | RTR_FLAG) for n, mask, extended in wanted]
    return b"".join(struct.pack("=II", *row) for row in rows)

"""Reading of a CAN socket, with the kernel's stamps and counts: many messages in one system call if possible.

`recvmmsg` is not in Python's library; it is called with memory that is laid out once. Its structures are those of
64-bit Linux (`struct mmsghdr`, `iovec`, `cmsghdr`); elsewhere messages are taken one by one.
"""

import ctypes
import errno
import os
import socket
import struct
import sys
from collections.abc import Callable
from typing import NamedTuple, Protocol

from faultline.service.bus.base import SO_TIMESTAMPNS, wall_stamp

SO_RXQ_OVFL = 40  # asm-generic/socket.h
CLASSIC = struct.Struct("=IB3x8s")
FD = struct.Struct("=IBB2x64s")
FD_FLAGS = 0x07  # FD itself, the higher bit rate, and the sender's state of error
FD_SIZES = frozenset([*range(9), 12, 16, 20, 24, 32, 48, 64])

_DROPS = struct.Struct("@I")


class Message(NamedTuple):
    """Received frame: identifier with the kernel's flags, data (None: it is no frame), whether it is our own.

    `is_local`: a process of this machine has sent it. `stamp` is the wall clock [s] when it reached the kernel, 0.0 if
    unknown; `drops` how many it has lost so far, None if it does not say.
    """

    identifier: int
    data: bytes | None
    is_local: bool
    stamp: float
    drops: int | None


class Reader(Protocol):
    """Reads a socket: at most so many messages; none if none waits. Raises OSError as the socket does."""

    def __call__(self, most: int) -> list[Message]:
        """Return the messages, the oldest first."""


def reader_of(sock: socket.socket) -> Reader:
    """Return the best reader for this socket, which does not block."""
    if isinstance(sock, socket.socket) and _RECVMMSG is not None:
        return Together(sock, _RECVMMSG)
    return OneByOne(sock)


def unpack(raw: bytes) -> tuple[int, bytes | None]:
    """Return identifier and data of 16 or 72 bytes (`struct can_frame`, `canfd_frame`); no data if it is no frame."""
    if len(raw) == CLASSIC.size:
        identifier, size, data = CLASSIC.unpack(raw)
        valid = size <= 8
    elif len(raw) == FD.size:
        identifier, size, flags, data = FD.unpack(raw)
        valid = size in FD_SIZES and not flags & ~FD_FLAGS
    else:
        return 0, None
    return identifier, data[:size] if valid else None


class OneByOne:
    """Reader by `recvmsg`."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._later: OSError | None = None

    def __call__(self, most: int) -> list[Message]:
        """Read as `Reader`; what has been taken before an error is not lost: the error comes with the next call."""
        if self._later is not None:
            error, self._later = self._later, None
            raise error
        found: list[Message] = []
        for _ in range(most):
            try:
                raw, extras, flags, _address = self._socket.recvmsg(FD.size, 256)
            except BlockingIOError:
                break
            except OSError as error:
                if not found:
                    raise
                self._later = error
                break
            counts = [data for level, kind, data in extras if (level, kind) == (socket.SOL_SOCKET, SO_RXQ_OVFL)]
            drops = _DROPS.unpack(counts[-1])[0] if counts and len(counts[-1]) == _DROPS.size else None
            found.append(Message(*unpack(raw), bool(flags & socket.MSG_DONTROUTE), wall_stamp(extras), drops))
        return found


ROOM = 128  # messages of a call: their memory stays in the processor's cache
_HEADER = struct.Struct("=40xQi4xI4x")  # of mmsghdr: length of the control data, flags, length of the message
_CONTROL = struct.Struct("=QiiqqQiiI12x")  # the stamp, then, where some were lost, the count of drops
_STAMPED, _COUNTED = 32, 52  # length of the control data with a stamp, and with a stamp and a count
_SLOT = struct.Struct("=IB3x8s56x")

Call = Callable[[int, int, int, int, None], int]


class Together:
    """Reader by `recvmmsg`."""

    def __init__(self, sock: socket.socket, call: Call) -> None:
        self._socket, self._call = sock, call
        self._later: OSError | None = None
        self._frames, self._controls = bytearray(ROOM * FD.size), bytearray(ROOM * _CONTROL.size)
        parts, frames, controls = bytearray(ROOM * 16), _address(self._frames), _address(self._controls)
        self._parts = parts  # iovec: kept alive, as the kernel reads it
        for k in range(ROOM):
            struct.pack_into("=QQ", parts, 16 * k, frames + FD.size * k, FD.size)
        self._fresh = b"".join(
            struct.pack("=QIxxxxQQQQi4xI4x", 0, 0, _address(parts) + 16 * k, 1, controls + 64 * k, 64, 0, 0)
            for k in range(ROOM)
        )
        self._headers = bytearray(self._fresh)
        self._at = _address(self._headers)

    def __call__(self, most: int) -> list[Message]:
        """Read as `Reader`; an error behind messages comes with the next call."""
        if self._later is not None:
            error, self._later = self._later, None
            raise error
        found: list[Message] = []
        while most > 0:
            room = min(most, ROOM)
            self._headers[: 64 * room] = self._fresh[: 64 * room]
            count = self._call(self._socket.fileno(), self._at, room, socket.MSG_DONTWAIT, None)
            if count < 0:
                number = ctypes.get_errno()
                if number == errno.EINTR:
                    continue
                if number != errno.EAGAIN:
                    self._later = OSError(number, os.strerror(number))
                return found if found or self._later is None else self(most)
            self._take(count, found)
            most -= count
            if count < room:
                break
        return found

    def _take(self, count: int, found: list[Message]) -> None:
        headers = _HEADER.iter_unpack(self._headers[: 64 * count])
        slots = _SLOT.iter_unpack(self._frames[: FD.size * count])
        controls = _CONTROL.iter_unpack(self._controls[: 64 * count])
        for k, ((extra, flags, length), (identifier, size, data), control) in enumerate(
            zip(headers, slots, controls, strict=True)
        ):
            if length != 16 or size > 8:
                identifier, data = unpack(bytes(self._frames[FD.size * k : FD.size * k + length]))
            elif size < 8:
                data = data[:size]
            stamp, drops = 0.0, None
            if extra >= _STAMPED and control[2] == SO_TIMESTAMPNS:
                stamp = control[3] + control[4] * 1e-9
                if extra >= _COUNTED and control[7] == SO_RXQ_OVFL:
                    drops = control[8]
            found.append(_message(Message, (identifier, data, flags & 4 != 0, stamp, drops)))


_message = tuple.__new__  # without the named tuple's own check of its arguments, which takes as long as the rest


def _address(memory: bytearray) -> int:
    return ctypes.addressof(ctypes.c_char.from_buffer(memory))


def _recvmmsg() -> Call | None:
    """Return the system's function if its structures are those above."""
    if sys.platform != "linux" or ctypes.sizeof(ctypes.c_void_p) != 8 or sys.byteorder != "little":
        return None
    call = getattr(ctypes.CDLL(None, use_errno=True), "recvmmsg", None)
    if call is None:
        return None
    call.argtypes = [ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p]
    call.restype = ctypes.c_int
    return call  # type: ignore[no-any-return]


_RECVMMSG = _recvmmsg()

"""Common interface of all kinds of buses.

A frame's time is the monotonic time at which it reached the kernel. The kernel's own stamp follows the wall clock, so
it only says how long a frame has waited, and is ignored where that cannot be true.
"""

import socket
import struct
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from faultline.service.core.errors import InputError
from faultline.service.core.signals.decode import Wanted
from faultline.service.logs import Frame

BATCH = 512
"""Frames taken in one call, so that a flood cannot hold up the loop."""

QUEUE = 4 * 1024 * 1024
"""Bytes of receive queue asked of the kernel, which grants at most net.core.rmem_max."""

FRAME_BYTES = 800
"""Of the receive queue, that a frame takes with what the kernel keeps beside it (docs/decisions/015-one-loop.md)."""

FULL_BUS = 8000
"""Frames a second of a bus of 1 Mbit/s without a pause."""

SLACK_S = 0.1
"""No frame has come before the queue was seen empty, nor after it was read: a stamp that says so, by more than this, is
of a clock that was set."""

SO_TIMESTAMPNS = 35  # asm-generic/socket.h
TIMESPEC = struct.Struct("@ll")


Trouble = Literal["down", "removed", "bus-off", "error-passive"]
"""Why a bus is silent, or about to be: the interface is down, or not there; its controller left the bus, or only
listens on it (ISO 11898-1: 256 errors, 128 errors)."""


class BusError(InputError):
    """Bus that is not there, or that does not take frames."""


@dataclass
class Counts:
    """Counters of a bus since it was opened: data frames, other frames, and events of the bus."""

    frames: int = 0
    remote: int = 0  # remote frames: they ask for data and have none
    malformed: int = 0  # of a length that no frame has, or no frame at all
    local: int = 0  # sent by a process of this machine, where only the vehicle is believed
    errors: int = 0  # error frames of the controller
    bus_offs: int = 0
    link_downs: int = 0
    removals: int = 0


class Bus(ABC):
    """CAN bus that receives without blocking, and sends. `trouble` is None while it is well; `why` says more, once."""

    def __init__(self) -> None:
        self.counts = Counts()
        self.trouble: Trouble | None = None
        self.why = ""  # it could not be opened, the last time
        self.rest_s = 0.0
        """For how long frames may wait unread [s]: a full bus fills half of the queue meanwhile."""
        self.is_read_out = False
        """What the last call of `receive` left: nothing that waits."""
        self._last = 0.0  # time of the newest frame; frames never go back
        self._empty = time.monotonic()  # when no frame waited, the last time that was seen

    @abstractmethod
    def fileno(self) -> int:
        """Return the descriptor, readable when frames wait; -1 while there is none, and another one after that."""

    @property
    def is_asked(self) -> bool:
        """Return True if it has to be polled: nothing wakes who waits for it."""
        return False

    @property
    @abstractmethod
    def dropped(self) -> int:
        """Return the frames that the kernel lost because nobody took them in time."""

    @abstractmethod
    def receive(self) -> list[Frame]:
        """Return at most `BATCH` of the waiting frames, `t` in `time.monotonic()`; none if none waits.

        Is called every second or so even if nothing waits: a bus that is lost is looked for here.
        """

    def want(self, wanted: Sequence[Wanted]) -> None:  # noqa: B027 most buses give every frame anyhow
        """Set the wanted frames, where the bus can filter them."""

    @abstractmethod
    def send(self, frame: Frame) -> None:
        """Send now, whatever the frame's time; raises `BusError` if the bus does not take it."""

    @abstractmethod
    def close(self) -> None:
        """Release the socket; further use is an error."""

    def __enter__(self) -> "Bus":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _arrival(self, stamp: float) -> float:
        """Return the monotonic time [s] of a recent wall-clock stamp, never before the last frame's."""
        now = time.monotonic()
        t = now - (time.time() - stamp)
        self._last = max(self._last, t if self._empty - SLACK_S <= t <= now else now)
        return self._last


def rest_of(sock: socket.socket) -> float:
    """Return for how long frames may wait in the queue of a socket, as `Bus.rest_s` has it."""
    return sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) / FRAME_BYTES / FULL_BUS / 2.0


def wall_stamp(extras: list[tuple[int, int, bytes]]) -> float:
    """Return the kernel's time stamp [s, wall clock] in a datagram's control messages; 0 if there is none."""
    for level, kind, data in extras:
        if level == socket.SOL_SOCKET and kind == SO_TIMESTAMPNS and len(data) == TIMESPEC.size:
            seconds, nanoseconds = TIMESPEC.unpack(data)
            return float(seconds + nanoseconds * 1e-9)
    return 0.0

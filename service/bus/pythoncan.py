"""Every other CAN interface, through python-can: `can:INTERFACE:CHANNEL[:BITRATE]`, as `can:pcan:PCAN_USBBUS1:250000`.

python-can cannot say what the kernel or the device has lost, and many of its interfaces cannot wait together with
others: they are asked every few milliseconds, and give every frame, as their filters make no difference between a frame
that is left out and none. Where there is SocketCAN, that is better.
"""

import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import can

from faultline.service.bus.base import BATCH, Bus, BusError
from faultline.service.logs import Frame

RETRY_S, LONGEST_RETRY_S = 0.2, 5.0
ERRORS = (can.CanError, OSError, ValueError, NotImplementedError, ImportError, TypeError)
"""What python-can's interfaces raise where they cannot be opened or do not go on."""


class PythonCan(Bus):
    """Bus of python-can, opened again after an error."""

    def __init__(
        self,
        interface: str,
        channel: str,
        bitrate: int | None,
        *,
        required: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__()
        self._name = f"can:{interface}:{channel}"
        self._options: dict[str, Any] = {"bitrate": bitrate} if bitrate is not None else {}
        self._interface, self._channel = interface, channel
        self._clock = clock
        self._bus: can.BusABC | None = None
        self._wait, self._due = RETRY_S, clock() + RETRY_S
        try:
            self._open()
        except BusError as error:
            if required:
                raise
            self.why = str(error)
            self.trouble = "removed"

    @property
    def is_asked(self) -> bool:
        """Return True: nothing wakes who waits for it."""
        return True

    @property
    def dropped(self) -> int:
        """Return 0: python-can does not say."""
        return 0

    def fileno(self) -> int:
        """Return -1: it is polled."""
        return -1

    def receive(self) -> list[Frame]:
        """Return at most `BATCH` frames."""
        if self._bus is None and not self._try_again():
            return []
        frames: list[Frame] = []
        begun = time.monotonic()
        for _ in range(BATCH):
            try:
                message = self._bus.recv(0.0) if self._bus is not None else None
            except ERRORS:
                self._lose()
                break
            if message is None:
                self._empty = begun
                break
            if message.is_error_frame:
                self.counts.errors += 1
            elif message.is_remote_frame:
                self.counts.remote += 1
            elif len(message.data) > (64 if message.is_fd else 8):
                self.counts.malformed += 1
            else:
                t = self._arrival(message.timestamp)
                frames.append(Frame(t, message.arbitration_id, message.is_extended_id, bytes(message.data)))
        self.counts.frames += len(frames)
        return frames

    def send(self, frame: Frame) -> None:
        """Send; raises `BusError` if the interface does not take it."""
        if self._bus is None:
            raise BusError(f"{self._name}: is not there; plug it in")
        fd = len(frame.data) > 8
        message = can.Message(
            arbitration_id=frame.can_id, is_extended_id=frame.is_extended, data=frame.data, is_fd=fd, check=True
        )
        try:
            self._bus.send(message, timeout=1.0)
        except ERRORS as error:
            raise BusError(f"{self._name}: does not take frames: {error}; is anybody on the bus?") from error

    def close(self) -> None:
        """Release the interface."""
        if self._bus is not None:
            self._bus.shutdown()
        self._bus = None

    def _open(self) -> None:
        try:
            self._bus = can.Bus(interface=self._interface, channel=self._channel, ignore_config=True, **self._options)
        except ERRORS as error:
            told = " ".join(str(error).split())
            raise BusError(f"{self._name}: {told}; name an interface that python-can has, and that is there") from error
        self._wait, self.trouble, self.why = RETRY_S, None, ""

    def _try_again(self) -> bool:
        now = self._clock()
        if now < self._due:
            return False
        try:
            self._open()
        except BusError as error:
            self.why = str(error)
            self._wait = min(2.0 * self._wait, LONGEST_RETRY_S)
            self._due = now + self._wait
            return False
        return True

    def _lose(self) -> None:
        if self._bus is not None:
            with suppress(*ERRORS):  # what is gone cannot be let go of either
                self._bus.shutdown()
        self._bus = None
        self.counts.removals += 1
        self.trouble = "removed"
        self._due = self._clock() + self._wait

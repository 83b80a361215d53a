"""CAN frames in UDP datagrams that never leave this machine, for where there is no SocketCAN; python-can's format."""

import os
import socket
from contextlib import closing
from pathlib import Path

import can
from can.interfaces.udp_multicast import UdpMulticastBus

from service.bus.base import BATCH, QUEUE, Bus, BusError
from service.logs import Frame

HOPS = 0
"""Datagrams with this limit stay on the machine."""


class UdpMulticast(Bus):
    """CAN frames over a multicast group of this machine's; sender and receivers may be different processes."""

    def __init__(self, group: str, port: int) -> None:
        super().__init__()
        try:
            self._bus = UdpMulticastBus(group, port, hop_limit=HOPS)
        except (can.CanError, OSError) as error:
            reason = error.__cause__ or error
            raise BusError(
                f"udp_multicast:{group}:{port}: {reason}; it needs a multicast route: ip route add 239.0.0.0/8 dev lo"
            ) from error
        with closing(socket.socket(fileno=os.dup(self._bus.fileno()))) as shared:
            shared.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, QUEUE)
        self._name = f"udp_multicast:{group}:{port}"
        self._inode = str(os.fstat(self._bus.fileno()).st_ino)

    def fileno(self) -> int:
        """Of the socket."""
        return int(self._bus.fileno())

    @property
    def dropped(self) -> int:
        """As the kernel counts for this socket; 0 where it does not say."""
        for line in Path("/proc/net/udp").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] == self._inode:
                return int(fields[-1])
        return 0

    def receive(self) -> list[Frame]:
        """At most `BATCH` frames; raises `BusError` where none will ever come again."""
        frames: list[Frame] = []
        for _ in range(BATCH):
            try:
                message = self._bus.recv(timeout=0)
            except can.CanError as error:
                if isinstance(error.__cause__, OSError):
                    raise BusError(f"{self._name}: lost: {error.__cause__}") from error
                self.skipped += 1  # no frame: anybody on this machine may send anything to a UDP port
                continue
            except OSError as error:
                raise BusError(f"{self._name}: lost: {error.strerror}") from error
            if message is None:
                break
            if message.is_remote_frame or message.is_error_frame:
                self.skipped += 1
                continue
            t = self._arrival(message.timestamp)
            frames.append(Frame(t, message.arbitration_id, message.is_extended_id, bytes(message.data)))
        return frames

    def send(self, frame: Frame) -> None:
        """Sends one datagram."""
        message = can.Message(
            arbitration_id=frame.can_id,
            is_extended_id=frame.is_extended,
            data=frame.data,
            is_fd=len(frame.data) > 8,
        )
        try:
            self._bus.send(message)
        except can.CanError as error:
            raise BusError(f"{self._name}: does not take frames: {error.__cause__ or error}") from error

    def close(self) -> None:
        """Closes the socket."""
        self._bus.shutdown()

"""CAN frames in UDP datagrams that never leave this machine, for where there is no SocketCAN.

The group is joined, and sent to, on the loopback interface and there alone, so that no route is needed and none leads
out; nor does anything come in from another interface. The datagrams are python-can's; its own bus takes the interface
that the routes say: python-can's tools listen and send here after `ip route add 239.0.0.0/8 dev lo`.
"""

import os
import socket
import time
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import can
import msgspec
from can.interfaces.udp_multicast.utils import pack_message

from faultline.service.bus.base import BATCH, QUEUE, SO_TIMESTAMPNS, Bus, BusError, rest_of, wall_stamp
from faultline.service.logs import Frame

LOOPBACK = socket.inet_aton("127.0.0.1")
IP_MULTICAST_ALL = 49  # linux/in.h
LARGEST = 4096  # bytes of a datagram that are read; a frame takes some 200


class _Message(msgspec.Struct):
    """Frame as python-can packs it.

    Read strictly: python-can's own reader trusts what comes, and makes of a number for data that many bytes of memory.
    """

    arbitration_id: Annotated[int, msgspec.Meta(ge=0, le=0x1FFF_FFFF)]
    is_extended_id: bool
    dlc: int
    data: bytes
    is_fd: bool
    is_remote_frame: bool
    is_error_frame: bool


_decoder = msgspec.msgpack.Decoder(_Message)


class UdpMulticast(Bus):
    """CAN frames over a multicast group of this machine's; sender and receivers may be different processes."""

    def __init__(self, group: str, port: int) -> None:
        super().__init__()
        self._name = f"udp_multicast:{group}:{port}"
        self._address = (group, port)
        try:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        except OSError as error:  # a service that may use no network
            raise BusError(f"{self._name}: {error.strerror}; it is for trials by hand, not for the service") from error
        try:
            _configure(self._socket, self._address)
        except OSError as error:
            self._socket.close()
            remedy = "it needs the loopback interface: ip link set lo up, or another port"
            raise BusError(f"{self._name}: {error.strerror}; {remedy}") from error
        self.rest_s = rest_of(self._socket)
        self._dropped = 0
        self._inode = str(os.fstat(self._socket.fileno()).st_ino)

    def fileno(self) -> int:
        """Return the socket's descriptor."""
        return self._socket.fileno()

    @property
    def dropped(self) -> int:
        """Return the kernel's count for this socket; if it does not say, the last one."""
        with suppress(OSError):  # no descriptor is left
            for line in Path("/proc/net/udp").read_text().splitlines()[1:]:
                fields = line.split()
                if fields[9] == self._inode:
                    self._dropped = int(fields[-1])
        return self._dropped

    def receive(self) -> list[Frame]:
        """Return at most `BATCH` frames; raises `BusError` if none will ever come again."""
        frames: list[Frame] = []
        begun, self.is_read_out = time.monotonic(), False
        for _ in range(BATCH):
            try:
                content, extras, _flags, _address = self._socket.recvmsg(LARGEST, 256, socket.MSG_DONTWAIT)
            except BlockingIOError:
                self._empty, self.is_read_out = begun, True
                break
            except OSError as error:
                raise BusError(f"{self._name}: lost: {error.strerror}") from error
            frame = unpack(content, self._arrival(wall_stamp(extras)))
            if frame is None:
                self.counts.malformed += 1
            else:
                frames.append(frame)
        self.counts.frames += len(frames)
        return frames

    def send(self, frame: Frame) -> None:
        """Send one datagram; wait for room in a full queue."""
        try:
            self._socket.sendto(pack(frame), self._address)
        except OSError as error:
            raise BusError(f"{self._name}: does not take frames: {error.strerror}") from error

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def _configure(sock: socket.socket, address: tuple[str, int]) -> None:
    """Bind to the group, not to any address: so no other host can send to the port directly."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, QUEUE)
    sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, LOOPBACK)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
    sock.setsockopt(socket.IPPROTO_IP, IP_MULTICAST_ALL, 0)  # nothing by what others joined elsewhere
    sock.bind(address)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(address[0]) + LOOPBACK)


def pack(frame: Frame) -> bytes:
    """Return the frame as a datagram."""
    message = can.Message(
        arbitration_id=frame.can_id, is_extended_id=frame.is_extended, data=frame.data, is_fd=len(frame.data) > 8
    )
    return pack_message(message)


def unpack(content: bytes, t: float) -> Frame | None:
    """Return the data frame in a datagram; None if none: any process here may send anything to a UDP port."""
    try:
        message = _decoder.decode(content)
    except (msgspec.MsgspecError, RecursionError):
        return None
    size = len(message.data)
    if message.is_remote_frame or message.is_error_frame or size != message.dlc or size > (64 if message.is_fd else 8):
        return None
    if not message.is_extended_id and message.arbitration_id > 0x7FF:
        return None
    return Frame(t, message.arbitration_id, message.is_extended_id, message.data)

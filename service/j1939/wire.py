"""The bus as a node needs it: what it sends comes back once it was transmitted, and sending never waits.

A controller that listens only must not be sent on. What mode it is in only netlink says, which a confined service may
not use; so it is seen by what it does. Linux 6.1 and later drop what is sent on such an interface, and no driver hands
back a frame that its controller has not transmitted (`service.j1939.echo`). Where the driver hands back nothing by
itself (no IFF_ECHO), the kernel does so in its place, transmitted or not: on Linux 6.1 a serial adapter that listened
only had its frame dropped, and handed back all the same. Such an interface proves nothing and is not used, unless it is
virtual and leads to no wire.
"""

import errno
import socket
from collections.abc import Callable, Iterable, Sequence

from faultline.service.bus import Bus, BusError, open_bus
from faultline.service.bus.base import Trouble
from faultline.service.bus.interface import SYS, Interface, interface
from faultline.service.bus.reader import CLASSIC
from faultline.service.bus.socketcan import CAN_RAW_RECV_OWN_MSGS, EFF_FLAG, SocketCan, can_socket
from faultline.service.core.j1939.identifiers import ADDRESS_CLAIMED, REQUEST, TP_CM
from faultline.service.core.signals.decode import Wanted
from faultline.service.logs import Frame

IFF_ECHO = 1 << 18  # linux/if.h
_FORMAT, _SOURCE = 0x00FF_0000, 0xFF
_FULL = (errno.EAGAIN, errno.ENOBUFS)

Make = Callable[[str, Iterable[Wanted] | None], socket.socket]


def wanted(addresses: Sequence[int]) -> list[Wanted]:
    """What a node must hear: claims, requests, what receivers say; and what it has sent itself."""
    said = [Wanted(pgn << 8, _FORMAT, True) for pgn in (REQUEST, TP_CM, ADDRESS_CLAIMED)]
    return said + [Wanted(address, _SOURCE, True) for address in addresses]


class Wire:
    """A bus to listen and send on; its interface need not be there yet.

    Raises:
        BusError: the specification names no bus that can be used.
    """

    def __init__(
        self,
        spec: str,
        addresses: Sequence[int],
        *,
        make: Make = can_socket,
        look: Callable[[str], Interface | None] = interface,
        echoes: "Callable[[str], bool] | None" = None,
    ) -> None:
        self.name = spec
        self._make, self._look, self._echoes = make, look, echoes or has_echo
        self._socket: socket.socket | None = None
        kind, _, name = spec.partition(":")
        self._bus: Bus
        if kind == "socketcan":
            # What other processes of this machine send is as much on the bus as what other devices do.
            frames = wanted(addresses)
            self._bus = SocketCan(name, frames, believe_local=True, required=False, make=self._open, look=look)
        else:
            self._bus = open_bus(spec)

    def fileno(self) -> int:
        """Readable when frames wait; -1 while there is nothing to wait for."""
        return self._bus.fileno()

    @property
    def trouble(self) -> Trouble | None:
        """Why nothing can be sent, or may not be heard."""
        return self._bus.trouble

    @property
    def why(self) -> str:
        """More about it, where the interface could not be opened."""
        return self._bus.why

    def receive(self) -> list[Frame]:
        """What waits; must be called every second or so, as a lost interface is looked for here."""
        return self._bus.receive()

    def send(self, frame: Frame) -> bool:
        """Whether the kernel took the frame; who sends knows by its echo whether it was transmitted."""
        if not isinstance(self._bus, SocketCan):
            try:
                self._bus.send(frame)
            except BusError:  # as with a full queue: no echo will come
                return False
            return True
        if self._socket is None or self._socket.fileno() < 0:
            return False
        try:
            self._socket.send(CLASSIC.pack(frame.can_id | EFF_FLAG, len(frame.data), frame.data))
        except OSError:  # the queue is full, or the interface went away, which receiving will tell
            return False
        return True

    def close(self) -> None:
        """Closes the bus."""
        self._bus.close()

    def _open(self, name: str, frames: Iterable[Wanted] | None) -> socket.socket:
        """A socket that hears what it sends; raises BusError where that would prove nothing."""
        at = self._look(name)
        if at is not None and not at.virtual and not self._echoes(name):
            raise BusError(
                f"socketcan:{name}: its driver does not say what was transmitted, so nobody can tell whether it "
                "listens only; use another adapter"
            )
        self._socket = self._make(name, frames)
        self._socket.setsockopt(socket.SOL_CAN_RAW, CAN_RAW_RECV_OWN_MSGS, 1)
        return self._socket


def has_echo(name: str) -> bool:
    """Whether the driver itself hands frames back, once they were transmitted."""
    try:
        return bool(int((SYS / name / "flags").read_text(), 16) & IFF_ECHO)
    except OSError:  # removed a moment ago
        return False

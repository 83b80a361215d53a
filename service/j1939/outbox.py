"""What goes out in parts: one broadcast at a time, and a few connections beside it, one for a receiver."""

from faultline.service.core.j1939.identifiers import TP_CM
from faultline.service.core.j1939.transport import RTS
from faultline.service.j1939.frames import Heard, Message
from faultline.service.j1939.transport import Broadcast, Connection, Reason, aborted

CONNECTIONS = 4
"""At one moment; who asks for more is asked to come later."""
_SIZE = 8


class Outbox:
    """Asked with the time for what to send; told what receivers say."""

    def __init__(self) -> None:
        self._broadcast: Broadcast | None = None
        self._connections: dict[int, Connection] = {}  # by receiver
        self._out: list[Message] = []

    def clear(self) -> None:
        """Drops everything: the address that it was sent from is not ours any more."""
        self._broadcast = None
        self._connections.clear()
        self._out.clear()

    def is_free(self, now: float) -> bool:
        """Whether a broadcast may begin."""
        return self._broadcast is None or (self._broadcast.done and now >= self._broadcast.due)

    def is_sending(self, pgn: int) -> bool:
        """Whether a broadcast of this group has begun and is not over."""
        return self._broadcast is not None and self._broadcast.pgn == pgn and not self._broadcast.done

    def broadcast(self, pgn: int, payload: bytes, now: float) -> None:
        """Begins one; only where it is free."""
        self._broadcast = Broadcast(pgn, payload, now)

    def connect(self, pgn: int, payload: bytes, destination: int, now: float) -> bool:
        """Whether it is sent to that one, or already was on its way."""
        if (there := self._connections.get(destination)) is not None:
            return there.pgn == pgn
        if len(self._connections) >= CONNECTIONS:
            return False
        self._connections[destination] = Connection(pgn, payload, destination, now)
        return True

    def hear(self, heard: Heard, now: float) -> None:
        """Takes a control message that is addressed to us. What others want to send us in parts is refused."""
        if heard.pgn != TP_CM or len(heard.data) != _SIZE:
            return
        pgn = int.from_bytes(heard.data[5:8], "little")
        if heard.data[0] == RTS:
            self._out.append(aborted(pgn, heard.source, Reason.RESOURCES))
            return
        there = self._connections.get(heard.source)
        if there is not None and there.pgn == pgn:
            there.hear(heard.data, now)

    @property
    def due(self) -> float | None:
        """When there is something to send, or a broadcast may begin [s]."""
        if self._out:
            return 0.0
        dues = [each.due for each in self._connections.values()]
        if self._broadcast is not None:
            dues.append(self._broadcast.due)
        return min(dues, default=None)

    def poll(self, now: float) -> list[Message]:
        """What is to be sent now."""
        out, self._out = self._out, []
        for receiver, each in list(self._connections.items()):
            out += each.poll(now)
            if each.done:
                del self._connections[receiver]
        if self._broadcast is not None:
            out += self._broadcast.poll(now)
            if self.is_free(now):
                self._broadcast = None
        return out

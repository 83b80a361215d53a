"""One loop over the bus, the service's two sockets and the clock."""

import select
import signal
import time
from collections.abc import Callable
from types import FrameType

from faultline.service.core.j1939.identifiers import NULL
from faultline.service.j1939.memory import Memory
from faultline.service.j1939.node import LONGEST_RETRY_S, RETRY_S, Node, Status
from faultline.service.j1939.wire import Wire
from faultline.service.systemd import Heartbeat, Notifier

IDLE_S = 0.5
ALIVE_S = 3.0
_GONE = ("down", "removed", "bus-off")


class Loop:
    """Drives a node; `say` is told what a person should know."""

    def __init__(
        self,
        node: Node,
        wire: Wire,
        memory: Memory,
        notifier: Notifier,
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._node, self._wire, self._memory = node, wire, memory
        self._notifier, self._say, self._clock = notifier, say, clock
        self.heartbeat = Heartbeat(ALIVE_S, clock)
        self._stopped = False
        self._told: tuple[Status, int] = ("waiting", NULL)
        self._trouble = self._twin = ""

    def serve(self) -> None:
        """Serves until a signal to stop."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._stop)
        self.turn()
        self._notifier.tell(READY=1)
        while not self._stopped:
            waiting = [number for number in (self._wire.fileno(), *self._memory.filenos()) if number >= 0]
            select.select(waiting, [], [], self._patience())
            self.turn()
            self.heartbeat.beat()

    def turn(self) -> None:
        """Takes what has come, and sends what is due."""
        now = self._clock()
        frames = self._wire.receive()
        self._watch_bus(now)
        for frame in frames:
            self._node.hear(frame, now)
        self._memory.take(now)
        self._node.know(self._memory.known, now)
        for frame in self._node.frames(now):
            if not self._wire.send(frame):
                break  # the queue is full, or the bus is gone: what follows could only come later than it should
        self._report()

    def _patience(self) -> float:
        """How long nothing need be done if nothing comes [s]."""
        dues = (due for due in (self._node.due, self._memory.due) if due is not None)
        return min(IDLE_S, max(0.0, min(dues) - self._clock()))

    def _watch_bus(self, now: float) -> None:
        """Begins when the bus is there, and ends when it is not."""
        trouble = self._wire.trouble
        gone = trouble in _GONE
        if gone and self._node.status != "waiting":
            self._node.end()
        elif not gone and self._node.status == "waiting":
            self._node.begin(now)
        text = (self._wire.why or f"{self._wire.name}: is {trouble}") if gone else ""
        if text != self._trouble:
            self._trouble = text
            self._say(f"{text}; nothing is sent" if text else f"{self._wire.name}: is there")

    def _report(self) -> None:
        """What has become of our address, once."""
        node = self._node
        now = (node.status, NULL if node.status == "mute" else node.address)
        if now != self._told:
            self._told = now
            text = self._described()
            self._notifier.tell(STATUS=text)
            if node.status != "waiting":
                self._say(text)
        if node.has_twin and not self._twin:
            self._twin = "another device has the same NAME; give one of them another identity_number"
            self._say(f"{self._wire.name}: {self._twin}")

    def _described(self) -> str:
        node, bus = self._node, self._wire.name
        if node.status == "mute":
            return (
                f"{bus}: nothing that was sent was transmitted: it listens only, is bus-off, or nobody else is there; "
                f"tried again every {RETRY_S:g} to {LONGEST_RETRY_S:g} s"
            )
        if node.status == "waiting":
            return f"{bus}: waits for the bus"
        lost = "" if node.winner is None else f", the last one to NAME {node.winner:016X}"
        if node.status == "cannot":
            return f"{bus}: others have all addresses that it may have{lost}; nothing is told"
        return f"{bus}: {'claims' if node.status == 'claiming' else 'has'} address {node.address}{lost}"

    def _stop(self, _number: int, _frame: FrameType | None) -> None:
        self._stopped = True

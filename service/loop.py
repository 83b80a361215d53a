"""The one loop: frames to the monitors, their events to the subscribers and to standard output.

It receives, decides and serves in turn, each as much as a batch: nothing is handed from thread to thread, and what a
turn takes (`docs/decisions/015-one-loop.md`) is a small part of what the kernel's queue holds.
"""

import selectors
import signal
import sys
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from types import FrameType

import msgspec

from service.clocks import Clocks
from service.core.events import Event, encode
from service.core.health import MEANINGS, SCHEMA, Condition, Conditions, Health, Standing, encode_health
from service.outputs.socket import EventSocket
from service.systemd import Heartbeat, Notifier
from service.watched import Line

IDLE_S = 0.5  # longest sleep, and the shortest time in which a stop is noticed
ASKED_S = 0.005  # how often a bus that wakes nobody is asked
LOOK_S = 1.0  # how often buses, signals and clocks are looked at
QUEUED = 64  # batches: more than the longest queue holds
LOSSES_S = 60.0  # how often losses are told where there are new ones
ALIVE_S = 5.0  # the loop turns every `IDLE_S` at least, and a turn takes a tenth of a second at most


class Loop:
    """Serves until a signal to stop. `source` is the vehicle's name."""

    def __init__(
        self,
        source: str,
        lines: Sequence[Line],
        subscribers: EventSocket,
        notifier: Notifier,
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
        clocks: Clocks | None = None,
        reload: Callable[[Callable[[], None]], None] | None = None,
        refused: Sequence[str] = (),
    ) -> None:
        """`reload`, where given, is called when SIGHUP asks for it, with what to call so that we count as alive.

        `refused` are the bundles that were left out.
        """
        self._source, self._lines, self._subscribers = source, lines, subscribers
        self._notifier, self._say, self._clock = notifier, say, clock
        self._clocks = clocks or Clocks()
        self.heartbeat = Heartbeat(ALIVE_S, clock)
        self._conditions = Conditions()
        self._refused = {Condition("bundle-refused", each) for each in refused}
        self._since: dict[Condition, str] = {}  # wall clock
        self._look_due, self._losses_due = clock() + LOOK_S, clock() + LOSSES_S
        self._registered: dict[Line, tuple[int, int]] = {}  # descriptor, and which of the bus's it is
        self._seq = 0
        self._stopped = self._asked = self._ready = False
        self._reload = reload
        self._printing = True

    def serve(self) -> None:
        """Serves until a signal to stop."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._stop)
        if self._reload is not None:
            signal.signal(signal.SIGHUP, self._ask)
        with selectors.DefaultSelector() as selector:
            self._subscribers.register(selector)
            try:
                while not self._stopped:
                    for line in self._lines:
                        self._register(line, selector)
                    ready = selector.select(self._patience())
                    self._look_at_clocks()
                    for line in self._lines:
                        self._tell(line.listen(self._clock()))
                        self._register(line, selector)  # now: a subscriber may get the number of one that was closed
                    self._subscribers.serve(ready)
                    self._look()
                    if self._asked:
                        self._take_up()
                    self.heartbeat.beat()
                    if not self._ready:
                        self._notifier.tell(READY=1)
                        self._ready = True
            finally:
                self._tell_losses()

    def _stop(self, _number: int, _frame: FrameType | None) -> None:
        self._stopped = True

    def _ask(self, _number: int, _frame: FrameType | None) -> None:
        self._asked = True

    def _take_up(self) -> None:
        """New bundles, between two turns; the service manager knows (systemd.service(5), `RELOADING=1`)."""
        assert self._reload is not None
        self._asked = False
        self._notifier.tell(RELOADING=1, MONOTONIC_USEC=time.monotonic_ns() // 1000, STATUS="loading bundles")
        self._reload(self.heartbeat.beat)
        self._notifier.tell(READY=1)

    def _register(self, line: Line, selector: selectors.BaseSelector) -> None:
        """The bus's descriptor: another one once its interface was gone, though it may have the same number."""
        now, before = (line.bus.fileno(), line.bus.counts.removals), self._registered.get(line)
        if now == before:
            return
        if before is not None:
            selector.unregister(before[0])
            del self._registered[line]
        if now[0] >= 0:
            selector.register(now[0], selectors.EVENT_READ)
            self._registered[line] = now

    def _patience(self) -> float:
        """How long nothing need be done if no frame comes [s]."""
        longest = ASKED_S if any(line.bus.is_asked for line in self._lines) else IDLE_S
        dues = [due for line in self._lines for bundle in line.bundles if (due := bundle.due()) is not None]
        return min(longest, max(0.0, min(dues, default=self._clock() + longest) - self._clock()))

    def _look(self) -> None:
        now = self._clock()
        if now >= self._losses_due:
            self._tell_losses()
        if now < self._look_due:
            return
        self._look_due = now + LOOK_S
        present = self._refused.union(*(line.look(now) for line in self._lines))
        if self._conditions.update(now, present):
            self._tell_health()
        standing = "; ".join(_said(condition) for condition in self._conditions.standing)
        self._notifier.tell(STATUS=standing or "listening")

    def _look_at_clocks(self) -> None:
        moved = self._clocks.look()
        if moved.stepped_s:
            self._say(f"the wall clock was set by {moved.stepped_s:+.0f} s; decisions do not use it")
        if moved.slept_s:
            self._say(f"the machine slept for {moved.slept_s:.0f} s; what was seen before is forgotten")
            for line in self._lines:
                for _ in range(QUEUED):
                    if not line.bus.receive():  # queued before the sleep: of a time that is gone
                        break
                for bundle in line.bundles:
                    bundle.restart()

    def _tell_losses(self) -> None:
        self._losses_due = self._clock() + LOSSES_S
        for line in self._lines:
            if news := line.losses.news():
                self._say(f"{line.name}: {news}" if len(self._lines) > 1 else news)

    def _tell_health(self) -> None:
        wall, standing = _now(), self._conditions.standing
        self._since = {condition: self._since.get(condition, wall) for condition in standing}
        self._say("; ".join(map(_said, standing)) or "all is well with buses and signals")
        self._seq += 1
        health = Health(
            schema=SCHEMA,
            id=f"{self._source}-{self._seq}",
            seq=self._seq,
            wall=wall,
            conditions=[Standing(kind=each.kind, of=each.of, since=self._since[each]) for each in standing],
        )
        self._publish(encode_health(health))

    def _tell(self, events: list[Event]) -> None:
        for event in events:
            self._seq += 1
            named = f"{self._source}-{self._seq}"
            self._publish(encode(msgspec.structs.replace(event, id=named, seq=self._seq, wall=_now())))

    def _publish(self, line: bytes) -> None:
        """Standard output is one subscriber more: where nobody reads it any longer, the others still are told."""
        self._subscribers.publish(self._seq, line)
        if self._printing:
            try:
                sys.stdout.buffer.write(line)
                sys.stdout.buffer.flush()
            except OSError as error:
                self._printing = False
                self._say(f"standard output: {error.strerror}; events go on over the socket")


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def _said(condition: Condition) -> str:
    return f"{condition.of} {MEANINGS[condition.kind]}"

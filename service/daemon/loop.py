"""The one loop: frames to the monitors, their events to the store, then to the subscribers and to standard output.

It receives, decides and serves in turn, each as much as a batch: only what is told is handed to another thread, the
store's. What a turn takes (`docs/decisions/015-one-loop.md`) is a small part of what the kernel's queue holds.
"""

import errno
import os
import select
import selectors
import signal
import sys
import time
from collections.abc import Callable, Sequence
from types import FrameType

import msgspec

from faultline.service.core.records.context import encode_context
from faultline.service.core.records.health import (
    KINDS,
    OF_FRAMES,
    SCHEMA,
    Condition,
    Conditions,
    Health,
    Standing,
    decode_health,
    encode_health,
    meaning,
)
from faultline.service.daemon.clocks import Clocks
from faultline.service.daemon.config import MemoryConfig
from faultline.service.daemon.control_server import ControlServer
from faultline.service.daemon.fault_recorder import FaultRecorder
from faultline.service.daemon.pipeline import BusChannel
from faultline.service.daemon.refused import RefusedBundles
from faultline.service.daemon.sequencer import Sequencer, now
from faultline.service.outputs.control import ControlSocket
from faultline.service.outputs.journald import Journald
from faultline.service.outputs.socket import EventSocket
from faultline.service.store.file import Record
from faultline.service.store.journal import Journal
from faultline.service.systemd import Heartbeat, Notifier

IDLE_S = 0.5  # longest sleep, and the shortest time in which a stop is noticed
ASKED_S = 0.005  # how often a bus that wakes nobody is asked
LOOK_S = 1.0  # how often buses, signals and clocks are looked at
QUEUED = 64  # batches: more than the longest queue holds
KEEPING_S = 3.0  # at the end, how long the store may take
LOSSES_S = 60.0  # how often losses are told where there are new ones
_AS_USUAL = MemoryConfig()
ALIVE_S = 5.0  # the loop turns every `IDLE_S` at least, and a turn takes a tenth of a second at most


class Loop:
    """Serves until a signal to stop."""

    def __init__(
        self,
        scribe: Sequencer,
        lines: Sequence[BusChannel],
        journal: Journal,
        subscribers: EventSocket,
        notifier: Notifier,
        say: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
        clocks: Clocks | None = None,
        reload: Callable[[Callable[[], None]], None] | None = None,
        refused: RefusedBundles | None = None,
        control: ControlSocket | None = None,
        memory: MemoryConfig = _AS_USUAL,
        boot: str = "",
    ) -> None:
        """`reload`, where given, is called when SIGHUP asks for it, with what to call so that we count as alive.

        `refused` are the bundles that could not be loaded; `boot` is the kernel's identifier of this boot.
        """
        self._scribe, self._lines, self._journal, self._subscribers = scribe, lines, journal, subscribers
        self._notifier, self._say, self._clock = notifier, say, clock
        self._clocks = clocks or Clocks()
        self.heartbeat = Heartbeat(ALIVE_S, clock)
        self._refused = refused
        self._since = _stood(journal.health)  # wall clock
        self._conditions = Conditions(self._since, clock())
        self._look_due, self._losses_due = clock() + LOOK_S, clock() + LOSSES_S
        self._registered: dict[BusChannel, tuple[int, int]] = {}  # descriptor, and which of the bus's it is
        self._remembering = FaultRecorder(
            *(scribe, journal, lines, memory, memory.frame_s, boot, clock(), say),
            standing=lambda: [f"{each.kind}: {each.of}" for each in self._conditions.standing],
            absent=refused.places if refused is not None else (),
        )
        self._answerer = ControlServer(self._remembering, journal, self._state)
        self._begun_at, self._told = now(), journal.last
        self._journald = Journald(clock) if Journald.is_wanted() else None
        self._control = control
        if control is not None:
            control.answers = self._answerer
        self._stopped = self._asked = self._ready = False
        self._reload = reload
        self._printing = sys.stdout is not None

    def serve(self) -> None:
        """Serves until a signal to stop."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._stop)
        if self._reload is not None:
            signal.signal(signal.SIGHUP, self._ask)
        with selectors.DefaultSelector() as selector:
            self._subscribers.register(selector)
            if self._control is not None:
                self._control.register(selector)
            selector.register(self._journal.fileno(), selectors.EVENT_READ)
            try:
                while not self._stopped:
                    self._turn(selector)
            finally:
                self._tell(self._journal.finish(KEEPING_S))
                self._tell_losses()

    def _turn(self, selector: selectors.BaseSelector) -> None:
        """What is heard is decided, kept, told and answered; then it is looked whether all is well."""
        for line in self._lines:
            self._register(line, selector)
        ready = selector.select(self._patience())
        if self._begins_anew():
            for line in self._lines:
                self._register(line, selector)
        for line in self._lines:
            for watched, events in line.listen(self._clock()):
                self._remembering.take(watched, events)
            self._keep_context(line)
            self._register(line, selector)  # now: a subscriber may get the number of one that was closed
        self._tell(self._journal.take())
        if self._journal.take_up():
            self._scribe.last = self._told = max(self._scribe.last, self._journal.last)
            self._subscribers.renew(self._journal.earlier)
            self._journal.earlier = []
            self._remembering.take_up()
        self._subscribers.serve(ready)
        if self._control is not None:
            self._control.serve(ready)
            self._control.tick()
        self._look()
        if self._asked:
            self._take_up()
        self.heartbeat.beat()
        if not self._ready:
            self._notifier.tell(READY=1)
            self._ready = True

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
        if self._refused is not None:
            self._refused.hurry()
        self._notifier.tell(READY=1)
        self._clocks.look()  # the time that this took is none in which the process was stopped

    def _register(self, line: BusChannel, selector: selectors.BaseSelector) -> None:
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
        self._remembering.look(now)
        kept, clients = self._journal.conditions | self._remembering.conditions, self._subscribers.conditions
        if self._control is not None:
            clients = clients | self._control.conditions
        refused: set[Condition] = set()
        if self._refused is not None:
            self._refused.look(now, self._lines, self._say, self._remembering.add)
            refused = self._refused.conditions
        present = refused.union(kept, clients, *(line.look(now) for line in self._lines))
        if not all(line.knows(now) for line in self._lines):  # what stood before a restart still may
            present |= {condition for condition in self._conditions.standing if condition.kind in OF_FRAMES}
        if self._conditions.update(now, present):
            self._keep_health()
        standing = "; ".join(_said(condition) for condition in self._conditions.standing)
        self._notifier.tell(STATUS=standing or "listening")

    def _begins_anew(self) -> bool:
        """Whether a time is gone in which nobody listened: what was seen before has nothing to do with what comes."""
        moved = self._clocks.look()
        if moved.stepped_s:
            self._say(f"the wall clock was set by {moved.stepped_s:+.0f} s; decisions do not use it")
        if not moved.slept_s and not moved.stopped_s:
            return False
        what = (
            f"the machine slept for {moved.slept_s:.0f} s"
            if moved.slept_s
            else f"this process was stopped for {moved.stopped_s:.0f} s"
        )
        self._say(f"{what}; what was seen before is forgotten")
        if moved.slept_s:
            self._remembering.slept()
        for line in self._lines:
            for _ in range(QUEUED):
                if not line.bus.receive():  # queued before that
                    break
            for bundle in line.bundles:
                bundle.restart()
        return True

    def _tell_losses(self) -> None:
        self._losses_due = self._clock() + LOSSES_S
        for line in self._lines:
            if news := line.losses.news():
                self._say(f"{line.name}: {news}" if len(self._lines) > 1 else news)

    def _keep_context(self, line: BusChannel) -> None:
        for change in line.changes():
            identity = self._scribe.next()
            context = change.record(identity, None, line.name)
            self._journal.put(Record(context.seq, "context", encode_context(context)))

    def _keep_health(self) -> None:
        standing = self._conditions.standing
        named, seq, wall = self._scribe.next()
        self._since = {condition: self._since.get(condition, wall) for condition in standing}
        self._say("; ".join(map(_said, standing)) or "all is well with buses and signals")
        health = Health(schema=SCHEMA, id=named, seq=seq, wall=wall, conditions=self._standing())
        self._journal.put(Record(seq, "health", encode_health(health)))

    def _standing(self) -> list[Standing]:
        return [Standing(kind=each.kind, of=each.of, since=self._since.get(each)) for each in self._conditions.standing]

    def _state(self) -> tuple[str, str, int, list[Standing]]:
        """Whose service this is, since when, the number of what was told last, and what stands."""
        return self._scribe.source, self._begun_at, self._told, self._standing()

    def _tell(self, records: list[Record]) -> None:
        """Standard output is one subscriber more: where nobody reads it any longer, the others still are told."""
        for record in records:
            self._told = record.seq
            self._subscribers.publish(record)
            self._answerer.told(record)
            if self._journald is not None:
                self._journald.told(record)
            if self._printing:
                self._print(record.line)

    def _print(self, line: bytes) -> None:
        """Never waits: a pipe that nobody empties is one that nobody reads."""
        try:
            output = sys.stdout.fileno()
            for k in range(0, len(line), select.PIPE_BUF):
                if not select.select([], [output], [], 0.0)[1]:
                    raise BlockingIOError(errno.EAGAIN, "nobody reads it")
                os.write(output, line[k : k + select.PIPE_BUF])
        except OSError as error:
            self._printing = False
            self._say(f"standard output: {error.strerror}; events go on over the socket")


def _stood(told: Record | None) -> dict[Condition, str | None]:
    """The conditions in what an earlier run told last, and since when; none in what another version told otherwise."""
    try:
        standing = decode_health(told.line).conditions if told is not None else []
    except (msgspec.MsgspecError, ValueError):
        return {}
    return {Condition(KINDS[one.kind], one.of): one.since for one in standing if one.kind in KINDS}


def _said(condition: Condition) -> str:
    return f"{condition.of} {meaning(condition.kind)}"

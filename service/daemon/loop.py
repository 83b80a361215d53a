"""Event loop: frames to the pipelines, events to the store, then to the subscribers and to standard output.

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

from faultline.service.core.records.health import (
    KINDS,
    OF_FRAMES,
    SCHEMA,
    Condition,
    Conditions,
    Health,
    Standing,
    meaning,
)
from faultline.service.core.records.line import encode
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
SHORTEST_REST_S = 0.005  # what is shorter spares too few wakes to be worth it
LOOK_S = 1.0  # how often buses, signals and clocks are looked at
QUEUED = 64  # batches: more than the longest queue holds
KEEPING_S = 3.0  # at the end, how long the store may take
LOSSES_S = 60.0  # how often losses are told where there are new ones
_AS_USUAL = MemoryConfig()
ALIVE_S = 5.0  # the loop turns every `IDLE_S` at least, and a turn takes a tenth of a second at most


class Loop:
    """Serve until a signal to stop."""

    def __init__(
        self,
        sequencer: Sequencer,
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
        self._sequencer, self._lines, self._journal, self._subscribers = sequencer, lines, journal, subscribers
        self._notifier, self._say, self._clock = notifier, say, clock
        self._clocks = clocks or Clocks()
        self.heartbeat = Heartbeat(ALIVE_S, clock)
        self._refused = refused
        self._since = _stood(journal.health)  # wall clock
        self._conditions = Conditions(self._since, clock())
        self._look_due, self._losses_due = clock() + LOOK_S, clock() + LOSSES_S
        self._registered: dict[BusChannel, tuple[int, int]] = {}  # descriptor, and which of the bus's it is
        self._fault_recorder = FaultRecorder(
            *(sequencer, journal, lines, memory, memory.frame_s, boot, clock(), say),
            standing=lambda: [f"{each.kind}: {each.of}" for each in self._conditions.standing],
            absent=refused.places if refused is not None else (),
        )
        self._control_server = ControlServer(self._fault_recorder, journal, self._state)
        self._begun_at, self._told = now(), journal.last
        self._journald = Journald(clock) if Journald.is_wanted() else None
        self._control = control
        if control is not None:
            control.answers = self._control_server
        self._stopped = self._asked = self._ready = False
        self._reload = reload
        self._printing = sys.stdout is not None

    def serve(self) -> None:
        """Serve until a signal to stop."""
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._stop)
        if self._reload is not None:
            signal.signal(signal.SIGHUP, self._ask)
        with selectors.DefaultSelector() as selector, selectors.EpollSelector() as self._buses:
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
        """One iteration: receive, diagnose, persist, publish, answer queries, check health."""
        for line in self._lines:
            self._register(line)
        ready = self._waited(selector)
        if self._begins_anew():
            for line in self._lines:
                self._register(line)
        for line in self._lines:
            for watched, events in line.listen(self._clock()):
                self._fault_recorder.take(watched, events)
            self._keep_context(line)
            self._register(line)  # now: a subscriber may get the number of one that was closed
        self._tell(self._journal.take())
        if self._journal.take_up():
            self._sequencer.last = self._told = max(self._sequencer.last, self._journal.last)
            self._subscribers.renew(self._journal.earlier)
            self._journal.earlier = []
            self._fault_recorder.take_up()
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
        """Load new bundles between two iterations; the service manager knows (systemd.service(5), `RELOADING=1`)."""
        assert self._reload is not None
        self._asked = False
        self._notifier.tell(RELOADING=1, MONOTONIC_USEC=time.monotonic_ns() // 1000, STATUS="loading bundles")
        self._reload(self.heartbeat.beat)
        if self._refused is not None:
            self._refused.hurry()
        self._notifier.tell(READY=1)
        self._clocks.look()  # the time that this took is none in which the process was stopped

    def _waited(self, selector: selectors.BaseSelector) -> list[tuple[selectors.SelectorKey, int]]:
        """Wait for what there is to do; return which descriptors are ready.

        A bus that brings frames is not waited for until ticks are due: a wake for every frame would cost more than all
        decisions. The kernel stamps frames and holds them meanwhile.
        """
        patience, rest_s = self._patience(), min((line.rest_s for line in self._lines), default=0.0)
        if rest_s >= SHORTEST_REST_S:
            return selector.select(min(patience, rest_s))
        selector.register(self._buses.fileno(), selectors.EVENT_READ)
        try:
            return selector.select(patience)
        finally:
            selector.unregister(self._buses.fileno())

    def _register(self, line: BusChannel) -> None:
        """Register the bus's descriptor: a new one after its interface was gone, though its number may be the same."""
        now, before = (line.bus.fileno(), line.bus.counts.removals), self._registered.get(line)
        if now == before:
            return
        if before is not None:
            self._buses.unregister(before[0])
            del self._registered[line]
        if now[0] >= 0:
            self._buses.register(now[0], selectors.EVENT_READ)
            self._registered[line] = now

    def _patience(self) -> float:
        """Return the time until the next action, if no frame comes [s]."""
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
        self._fault_recorder.look(now)
        kept, clients = self._journal.conditions | self._fault_recorder.conditions, self._subscribers.conditions
        if self._control is not None:
            clients = clients | self._control.conditions
        if self._refused is not None:
            self._refused.look(now, self._lines, self._say, self._fault_recorder.add)
            kept |= self._refused.conditions
        present = kept.union(clients, *(line.look(now) for line in self._lines))
        if not all(line.knows(now) for line in self._lines):  # what stood before a restart still may
            present |= {condition for condition in self._conditions.standing if condition.kind in OF_FRAMES}
        if self._conditions.update(now, present):
            self._keep_health()
        standing = "; ".join(_said(condition) for condition in self._conditions.standing)
        self._notifier.tell(STATUS=standing or "listening")

    def _begins_anew(self) -> bool:
        """Return True if the process was suspended; the diagnosis state is then reset."""
        moved = self._clocks.look()
        if moved.stepped_s:
            self._say(f"the wall clock was set by {moved.stepped_s:+.0f} s; decisions do not use it")
        if not moved.slept_s and not moved.stopped_s:
            return False
        stopped = f"this process was stopped for {moved.stopped_s:.0f} s"
        what = f"the machine slept for {moved.slept_s:.0f} s" if moved.slept_s else stopped
        self._say(f"{what}; what was seen before is forgotten")
        if moved.slept_s:
            self._fault_recorder.slept()
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
            identity = self._sequencer.next()
            context = change.record(identity, None, line.name)
            self._journal.put(Record(context.seq, "context", encode(context)))

    def _keep_health(self) -> None:
        standing = self._conditions.standing
        named, seq, wall = self._sequencer.next()
        self._since = {condition: self._since.get(condition, wall) for condition in standing}
        self._say("; ".join(map(_said, standing)) or "all is well with buses and signals")
        health = Health(schema=SCHEMA, id=named, seq=seq, wall=wall, conditions=self._standing())
        self._journal.put(Record(seq, "health", encode(health)))

    def _standing(self) -> list[Standing]:
        return [Standing(kind=each.kind, of=each.of, since=self._since.get(each)) for each in self._conditions.standing]

    def _state(self) -> tuple[str, str, int, list[Standing]]:
        """Return the vehicle's name, the start time, the number of the last record, and the standing conditions."""
        return self._sequencer.source, self._begun_at, self._told, self._standing()

    def _tell(self, records: list[Record]) -> None:
        """Publish records to the subscribers and, as long as it has a reader, to standard output."""
        for record in records:
            self._told = record.seq
            self._subscribers.publish(record)
            self._control_server.told(record)
            if self._journald is not None:
                self._journald.told(record)
            if self._printing:
                self._print(record.line)

    def _print(self, line: bytes) -> None:
        """Print without waiting: a pipe that nobody empties has no reader."""
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
    """Return the conditions of an earlier run's last record, and since when; none if another version wrote it."""
    try:
        standing = msgspec.json.decode(told.line, type=Health).conditions if told is not None else []
    except (msgspec.MsgspecError, ValueError):
        return {}
    return {Condition(KINDS[one.kind], one.of): one.since for one in standing if one.kind in KINDS}


def _said(condition: Condition) -> str:
    return f"{condition.of} {meaning(condition.kind)}"

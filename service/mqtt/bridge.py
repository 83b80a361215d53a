"""Event loop from the daemon to the broker, which waits for nothing but its selector."""

import os
import selectors
import time
from collections.abc import Callable
from pathlib import Path

from faultline.service.mqtt.ask import State, ask_faults, ask_state
from faultline.service.mqtt.broker import Broker
from faultline.service.mqtt.config import MqttConfig
from faultline.service.mqtt.cursor import Cursor, CursorFile
from faultline.service.mqtt.daemon import Daemon
from faultline.service.mqtt.naming import Naming
from faultline.service.mqtt.progress import Progress
from faultline.service.mqtt.retained import Retained
from faultline.service.mqtt.sender import Sender
from faultline.service.mqtt.throttled import Say
from faultline.service.mqtt.topics import TopicError
from faultline.service.protocol.backoff import Backoff
from faultline.service.protocol.errors import ProtocolError
from faultline.service.systemd import Heartbeat, Notifier

TURN_S = 1.0
"""A turn begins so often, though nothing happens."""
ALIVE_S = 30.0
"""A turn takes less: three answers of the daemon and a slow disk."""
ASKED_S = 2.0, 30.0
"""Until the daemon is asked again after it gave no answer: at first, and at most."""
LEAVING_S = 3.0
"""For so long a stop waits for what is in flight."""


class Bridge:
    """The process `faultline mqtt` as configured by `config`, going on from what `file` holds."""

    def __init__(
        self,
        config: MqttConfig,
        file: CursorFile,
        version: str,
        notifier: Notifier,
        say: Say,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        kept = _kept(file, say)
        self._config, self._notifier, self._say, self._clock = config, notifier, say, clock
        self._wake = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._naming = Naming(config.vehicle, kept.vehicle)
        self._daemon = Daemon(Path(config.events), kept.id, kept.seq, say)
        self._retained = Retained(kept, version, say)
        self._progress = Progress(file, kept, say)
        self._sender = Sender(self._retained, self._progress.passed, say)
        self._broker = Broker(config, self._retained, self._sender, say, self.wake)
        self._asking = Backoff(*ASKED_S)
        self._named = 0  # by which connection to the daemon
        self._reconciled = (0, 0)  # which connection to the broker, with which one to the daemon
        self._seen: str | None = None  # the name in a record's id
        self._keep_at: float | None = None
        self._stopping, self._status = False, ""
        self.heartbeat = Heartbeat(ALIVE_S, clock)

    def stop(self) -> None:
        """End `serve`; for a signal's handler."""
        self._stopping = True
        self.wake()

    def wake(self) -> None:
        """Begin the next turn now; from any thread."""
        os.eventfd_write(self._wake, 1)

    def serve(self) -> None:
        """Runs until `stop`, then says that we are offline."""
        self._turn()
        self._notifier.tell(READY=1)
        while not self._stopping:
            self._wait(TURN_S)
            self._turn()
            self.heartbeat.beat()
        self._notifier.tell(STOPPING=1)
        self._leave()

    def _turn(self) -> None:
        """One iteration: read records, connect, receive, reconcile, send, save progress."""
        now = self._clock()
        self._read(now)
        self._ask_name(now)
        self._broker.connect(self._naming.name, now)
        self._broker.hear(now)
        self._reconcile(now)
        self._retained.health.daemon_is_there = self._daemon.is_connected
        self._retained.health.lost = self._progress.lost
        self._broker.send(now)
        self._keep_at = self._progress.keep(self._naming.name, self._retained.faults.there, now)
        self._tell()

    def _read(self, now: float) -> None:
        """Takes records while there is room; what is not read waits in the daemon's store."""
        if not self._sender.outbox.has_room:
            return
        for record in self._daemon.turn(now):
            self._seen = self._seen or record.vehicle
            self._sender.outbox.add(record)

    def _ask_name(self, now: float) -> None:
        """Ask the daemon for its name, once a connection, if the configuration does not give it."""
        if self._naming.is_fixed or not self._daemon.is_connected or self._named == self._daemon.connections:
            return
        state = self._asked(now)
        try:
            if state is not None:
                self._named = self._daemon.connections
                self._naming.answered(state.source)
            elif self._seen is not None:
                self._naming.seen(self._seen)
        except TopicError as error:
            self._say(f"{error}; give `vehicle` in the configuration. Nothing is published until then")

    def _reconcile(self, now: float) -> None:
        """Makes right what the broker retains, once for each connection to it and to the daemon."""
        topics, wanted = self._broker.topics, (self._broker.connections, self._daemon.connections)
        if topics is None or not self._daemon.is_connected or wanted == self._reconciled:
            return
        state = self._asked(now)
        if state is None:
            return
        try:
            remembered = ask_faults(Path(self._config.control))
        except ProtocolError as error:
            self._no_answer(error, now)
            return
        self._reconciled = wanted
        self._sender.publish(self._retained.now(state, remembered, self._daemon.connections, topics))

    def _asked(self, now: float) -> State | None:
        """Return the daemon's state; None if it gives none, or it is too early to ask again."""
        if now < self._asking.at:
            return None
        try:
            state = ask_state(Path(self._config.control))
        except ProtocolError as error:
            self._no_answer(error, now)
            return None
        self._asking.well()
        return state

    def _no_answer(self, error: ProtocolError, now: float) -> None:
        self._say(f"the daemon does not answer: {error}; it is asked again")
        self._asking.failed(now)

    def _tell(self) -> None:
        broker = "connected to the broker" if self._broker.topics is not None else "broker away"
        status = f"{broker}, {'connected to the daemon' if self._daemon.is_connected else 'daemon away'}"
        if status != self._status:
            self._notifier.tell(STATUS=status)
            self._status = status

    def _wait(self, longest_s: float) -> None:
        """Wait until there is something to do."""
        now = self._clock()
        dues = [*self._broker.due, self._daemon.retry.at, self._asking.at, self._keep_at or now]
        with selectors.PollSelector() as selector:
            selector.register(self._wake, selectors.EVENT_READ)
            if self._sender.outbox.has_room and self._daemon.is_connected:
                selector.register(self._daemon, selectors.EVENT_READ)
            self._broker.register(selector)
            ready = selector.select(min([longest_s, *(due - now for due in dues if due > now)]))
        if any(key.fd == self._wake for key, _ in ready):
            os.eventfd_read(self._wake)

    def _leave(self) -> None:
        """Publish that we are offline, after what is in flight; or leave that to the broker."""
        self._daemon.close()
        end, is_told = self._clock() + LEAVING_S, False
        while (topics := self._broker.topics) is not None and self._clock() < end:
            if not is_told:
                offline = self._retained.health.offline(topics)
                is_told = self._broker.send_besides(offline, self._clock()) is not None
            if is_told and self._sender.outbox.in_flight == 0:
                break
            self._wait(LEAVING_S / 10)
            self._broker.hear(self._clock())
        is_clean = is_told and self._sender.outbox.in_flight == 0
        self._progress.keep(self._naming.name, self._retained.faults.there, float("inf"))
        self._broker.end(self._clock(), with_will=not is_clean)


def _kept(file: CursorFile, say: Say) -> Cursor:
    kept, trouble = file.load()
    if trouble:
        say(trouble)
    return kept

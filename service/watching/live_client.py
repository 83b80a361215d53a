"""Live client of a running service, over its two sockets, by threads that reconnect."""

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec

from faultline.service.core.errors import InputError
from faultline.service.protocol.answers import ServiceState
from faultline.service.protocol.client import ControlClient
from faultline.service.protocol.errors import ProtocolError
from faultline.service.protocol.live import SystemDescription
from faultline.service.protocol.questions import Question
from faultline.service.protocol.records import RecordError, read
from faultline.service.watching.view_model import ViewModel

RETRY_S = 0.5
"""Between two tries."""
ASK_S = 1.0
"""Between two questions on what stands."""
STALE_S, STALE_TICKS = 3.0, 10
"""A tick that is older than both, is no longer shown."""
EARLIER = 20
"""Records asked for that were told before."""
HELD = 50
STATE = Question(ask="state")

Subscribe = Callable[[int | str | None], Iterator[bytes]]
Describe = Callable[[bytes], str]


class LiveClient:
    """Receives the state, ticks and records. `wake` becomes readable when there is something new.

    `subscribe` gives records after a number or an id, until the service ends; `describe` puts one into words. Both
    raise `InputError`.
    """

    def __init__(self, control: Path, name: str | None, subscribe: Subscribe, describe: Describe) -> None:
        self._control, self._name = control, name
        self._subscribe, self._describe = subscribe, describe
        self._lock = threading.Lock()
        self._seen = ViewModel(connection="away", why="connecting")
        self._heard_at = 0.0  # of the tick [s, monotonic]
        self._events: deque[str] = deque(maxlen=HELD)
        self._last: str | None = None  # id of the last record
        self.wake = os.eventfd(0, os.EFD_NONBLOCK)
        self.failure: BaseException | None = None

    def begin(self) -> None:
        """Start its threads, which end with the process."""
        for work in (self._live, self._standing, self._records):
            threading.Thread(target=self._guard, args=(work,), daemon=True).start()

    def seen(self) -> ViewModel:
        """Return the view model now. Raises what ended one of the threads: that is a defect."""
        if self.failure is not None:
            raise self.failure
        with self._lock:
            seen = msgspec.structs.replace(self._seen, events=tuple(self._events))
            age = time.monotonic() - self._heard_at
        if seen.tick is None or seen.system is None or age < max(STALE_S, STALE_TICKS * seen.system.period_s):
            return seen
        why = f"nothing has come for {age:.0f} s"
        return msgspec.structs.replace(seen, connection="waiting", why=why, tick=None)

    def next_system(self) -> None:
        """Turn to the next system, from its next tick on."""
        with self._lock:
            state, system = self._seen.state, self._seen.system
            names = [each.name for each in state.systems] if state else []
            if system is not None and system.name in names:
                self._name = names[(names.index(system.name) + 1) % len(names)]

    def _guard(self, work: Callable[[], None]) -> None:
        try:
            work()
        except BaseException as error:
            self.failure = error
            self._woken()
            raise

    def _set(self, **fields: object) -> None:
        with self._lock:
            self._seen = msgspec.structs.replace(self._seen, **fields)
        self._woken()

    def _woken(self) -> None:
        os.eventfd_write(self.wake, 1)

    def _live(self) -> None:
        while True:
            try:
                with ControlClient(self._control) as control:
                    self._hear(control)
            except ProtocolError as error:
                self._set(connection="away", why=f"{error}; trying again", tick=None)
                time.sleep(RETRY_S)

    def _hear(self, control: ControlClient) -> None:
        """Receive the ticks of a system, until another one is wanted."""
        state = control.ask(STATE, ServiceState)
        names = [each.name for each in state.systems]
        name = self._name or (names[0] if names else None)
        if name is None:
            self._set(connection="waiting", why="the service watches no system", state=state, system=None, tick=None)
            time.sleep(ASK_S)
            return
        system = control.ask(Question(ask="system", name=name), SystemDescription)
        self._set(connection="waiting", why="nothing has come yet", state=state, system=system, tick=None)
        for tick in control.live(name):
            if tick.bundle != system.bundle:  # its names are others
                return
            with self._lock:
                self._heard_at = time.monotonic()
                is_other = self._name not in (None, name)
            self._set(connection="live", why="", tick=tick)
            if is_other:
                return

    def _standing(self) -> None:
        while True:
            try:
                with ControlClient(self._control) as control:
                    while True:
                        self._set(state=control.ask(STATE, ServiceState))
                        time.sleep(ASK_S)
            except ProtocolError:  # the other thread says why
                time.sleep(RETRY_S)

    def _records(self) -> None:
        while True:
            try:
                if self._seen.state is None:  # it says which records are the latest
                    time.sleep(RETRY_S)
                    continue
                for line in self._subscribe(self._after()):
                    said = self._describe(line)
                    identifier = read(line).id
                    with self._lock:
                        self._events.append(said)
                        self._last = identifier
                    self._woken()
            except (InputError, RecordError) as error:
                said = f"events: {error}"
                with self._lock:
                    if not self._events or self._events[-1] != said:
                        self._events.append(said)
            time.sleep(RETRY_S)

    def _after(self) -> int | str | None:
        with self._lock:
            if self._last is not None:
                return self._last
            return max(0, self._seen.state.seq - EARLIER) if self._seen.state else None

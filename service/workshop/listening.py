"""Live ticks from the control socket, in a thread: who shows progress must not wait for the next tick."""

import queue
import threading
from collections.abc import Iterator
from pathlib import Path

from faultline.service.core.errors import InputError
from faultline.service.protocol.client import ControlClient
from faultline.service.protocol.errors import ProtocolError
from faultline.service.protocol.live import LiveTick

SILENT_S = 0.5
"""So long nothing has to come until that is said."""


class Ended:
    """The service ended the connection; `error` is what it answers that cannot be understood, None where it went."""

    def __init__(self, error: InputError | None = None) -> None:
        self.error = error


class Listening:
    """The ticks of a system, as they come.

    A connection on which nothing comes for long is made anew: the service may be waiting for the bus.
    """

    def __init__(self, path: Path, system: str) -> None:
        self._path, self._system = path, system
        self._came: queue.SimpleQueue[LiveTick | Ended] = queue.SimpleQueue()
        threading.Thread(target=self._listen, name="workshop", daemon=True).start()

    def ticks(self) -> Iterator[LiveTick | float]:
        """Ticks, and between them seconds [s] in which none came; ends where the service does.

        Raises:
            InputError: the service answers what cannot be understood.
        """
        while True:
            try:
                came = self._came.get(timeout=SILENT_S)
            except queue.Empty:
                yield SILENT_S
                continue
            if isinstance(came, Ended):
                if came.error is not None:
                    raise came.error
                return
            yield came

    @property
    def is_behind(self) -> bool:
        """Whether more has come than was taken."""
        return not self._came.empty()

    def _listen(self) -> None:
        try:
            while self._hear():
                pass
            self._came.put(Ended())
        except InputError as error:
            self._came.put(Ended(error))

    def _hear(self) -> bool:
        """Takes what comes over one connection; whether to try another."""
        try:
            control = ControlClient(self._path)
        except ProtocolError:
            return False
        with control:
            try:
                for tick in control.live(self._system):
                    self._came.put(tick)
            except ProtocolError as error:
                if error.code == "busy":
                    return False
                if error.code != "away":
                    raise
                return isinstance(error.__cause__, TimeoutError)
        return False

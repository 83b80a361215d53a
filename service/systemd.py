"""The service manager: states over $NOTIFY_SOCKET (sd_notify(3)), where there is one, and lines for its journal.

The watchdog is fed by a thread of its own, and only while every part that must be alive has said so lately: a loop that
hangs, or computes for ever, is a service that is restarted.
"""

import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Protocol

READY_S = 5.0
"""For so long a manager may be too busy to take that we are ready."""

FEEDS = 3
"""The watchdog is fed so many times in its time."""


def log_as(command: str) -> Callable[[str], None]:
    """Return a function that writes one line of a command to standard error, which the journal takes."""

    def log(text: str) -> None:
        with suppress(OSError):  # nobody reads it, or its disk is full: that ends no service
            print(f"faultline {command}: {text}", file=sys.stderr, flush=True)

    return log


class Notifier:
    """Sends states; without $NOTIFY_SOCKET nobody listens, and none is sent."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address  # an abstract name begins with @
        self.watchdog_s = _watchdog(environment) if address else None

    def tell(self, **states: str | int) -> None:
        """Send the states, such as `READY=1` and `STATUS=...`; a manager that does not listen is no error."""
        if not self._address:
            return
        content = "\n".join(f"{name}={' '.join(str(value).split())}" for name, value in states.items()).encode()
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sock:
            sock.settimeout(READY_S if "READY" in states else 0.0)  # the others are told again soon
            with suppress(OSError):  # its queue is full, or it is being replaced: the next feed comes soon
                sock.sendto(content, self._address)


def _watchdog(environment: Mapping[str, str]) -> float | None:
    """Return the watchdog's time [s], if this process is the one that is watched."""
    microseconds = environment.get("WATCHDOG_USEC", "")
    mine = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
    return int(microseconds) / 1e6 if mine and microseconds.isdecimal() and int(microseconds) > 0 else None


class Heartbeat:
    """Heartbeat of one part: when it was last alive, and for how long that is good [s]."""

    def __init__(self, lasts_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._lasts, self._clock = lasts_s, clock
        self._at = clock()

    def beat(self) -> None:
        """Note that the part is alive."""
        self._at = self._clock()

    @property
    def fresh(self) -> bool:
        """Return True if the part was alive lately."""
        return self._clock() - self._at <= self._lasts


class Part(Protocol):
    """A part of the service that must be alive."""

    @property
    def fresh(self) -> bool:
        """Return True if it is alive."""


class Supervisor:
    """Feeds the watchdog while all `parts` are alive, from a thread that does nothing else."""

    def __init__(self, notifier: Notifier, parts: Mapping[str, Part], say: Callable[[str], None]) -> None:
        self._notifier, self._parts, self._say = notifier, parts, say
        self._ended = threading.Event()
        self._silent: list[str] = []
        self._thread = threading.Thread(target=self._run, name="supervisor", daemon=True)

    def __enter__(self) -> "Supervisor":
        if self._notifier.watchdog_s is not None:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()

    def look(self) -> None:
        """Feed the watchdog, or say which part is silent."""
        silent = [name for name, part in self._parts.items() if not part.fresh]
        if not silent:
            self._notifier.tell(WATCHDOG=1)
        elif silent != self._silent:
            self._say(f"{', '.join(silent)} without a sign of life: the watchdog is not fed")
        self._silent = silent

    def _run(self) -> None:
        assert self._notifier.watchdog_s is not None
        while not self._ended.wait(self._notifier.watchdog_s / FEEDS):
            self.look()

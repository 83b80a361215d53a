"""Detection of clock steps and suspended machines, by comparing the kernel's clocks with each other.

Decisions are made on the monotonic clock, which nobody sets; it stands while the machine sleeps. The wall clock only
dates what is told.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

STEP_S = 1.0
"""A wall clock that is off by less was trimmed, not set."""
SLEEP_S = 1.0
STOPPED_S = 10.0
"""Who looks again after so long was stopped: what waits since then is of a time that is gone."""
SAME_S, READINGS = 0.1, 5
"""Clocks are read at one moment, or once more."""


class Moved(NamedTuple):
    """Changes since the last look: the wall clock was set by `stepped_s`, the machine slept for `slept_s` [s].

    `stopped_s` [s] is for how long nobody looked, where that is longer than anything but a stopped process takes.
    """

    stepped_s: float
    slept_s: float
    stopped_s: float


class Clocks:
    """Compares the kernel's clocks; polled every second or so."""

    def __init__(
        self,
        monotonic: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
        boot: Callable[[], float] = lambda: time.clock_gettime(time.CLOCK_BOOTTIME),
    ) -> None:
        self._monotonic, self._wall, self._boot = monotonic, wall, boot
        self._apart = self._now()
        self._looked = monotonic()

    def look(self) -> Moved:
        """Return the changes, 0 if there are none; a wall clock that goes on during sleep has made no step."""
        now, before = self._now(), self._apart
        looked, self._looked = self._looked, self._monotonic()
        stopped = self._looked - looked if self._looked - looked >= STOPPED_S else 0.0
        slept = now[1] - before[1]
        stepped = now[0] - before[0] - slept
        if abs(stepped) < STEP_S and slept < SLEEP_S:
            return Moved(0.0, 0.0, stopped)  # and is compared with the same again: a slow drift adds up to a step, once
        self._apart = now
        return Moved(stepped if abs(stepped) >= STEP_S else 0.0, slept if slept >= SLEEP_S else 0.0, stopped)

    def _now(self) -> tuple[float, float]:
        """Return how far wall clock and boot-time clock are ahead of the monotonic one [s]."""
        for _ in range(READINGS):
            monotonic, wall, boot = self._monotonic(), self._wall(), self._boot()
            if self._monotonic() - monotonic < SAME_S:  # else we were stopped between them
                break
        return wall - monotonic, boot - monotonic

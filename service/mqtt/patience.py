"""How long to wait before the next try, and how often the same is said."""

import secrets
from collections.abc import Callable
from typing import Protocol

SAID_S = 60.0
"""The same is said once in so long."""
SAID = 64
"""So many different sayings are remembered."""


_chance = secrets.SystemRandom().random


class Backoff:
    """When to try again [s]: after `first`, then twice as long each time until `longest`, less up to half by chance.

    The chance is for a fleet whose broker was away: it must not come back all at once.
    """

    def __init__(self, first: float, longest: float, chance: Callable[[], float] = _chance) -> None:
        self._first, self._longest, self._chance = first, longest, chance
        self._next = first
        self.at = float("-inf")

    def failed(self, now: float) -> float:
        """A try failed at `now`; gives when the next one is due."""
        self.at = now + self._next * (1 - 0.5 * self._chance())
        self._next = min(2 * self._next, self._longest)
        return self.at

    def well(self) -> None:
        """It is well again: the next failure waits for the shortest time."""
        self._next, self.at = self._first, float("-inf")


class Say(Protocol):
    """Tells a person something; what is `about` the same is not told too often."""

    def __call__(self, text: str, about: str = "") -> None:
        """Tells it; where it is about nothing in particular, about itself."""


class Said:
    """Says a thing once a minute at most, however often it happens; and how often that was, when it says it again."""

    def __init__(self, say: Callable[[str], None], clock: Callable[[], float]) -> None:
        self._say, self._clock = say, clock
        self._last: dict[str, tuple[float, int]] = {}  # when it was said, and how often it was not since

    def __call__(self, text: str, about: str = "") -> None:
        """Says it, unless something about the same was said within the minute."""
        now, about = self._clock(), about or text
        at, kept = self._last.pop(about, (float("-inf"), 0))
        if now - at < SAID_S:
            self._last[about] = at, kept + 1
            return
        self._last[about] = now, 0
        while len(self._last) > SAID:
            del self._last[next(iter(self._last))]
        self._say(f"{text} ({kept} times more since the last time)" if kept else text)

"""Exponential back-off with jitter."""

import secrets
from collections.abc import Callable

_chance = secrets.SystemRandom().random


class Backoff:
    """Exponential back-off [s]: `first`, then twice as long each time until `longest`, less up to half by chance.

    The jitter keeps a fleet whose broker was away from coming back all at once; `chance` draws it from [0, 1). State:
    the next wait, and `at`, when the next try is due.
    """

    def __init__(self, first: float, longest: float, chance: Callable[[], float] = _chance) -> None:
        self._first, self._longest, self._chance = first, longest, chance
        self._next = first
        self.at = float("-inf")

    def wait(self) -> float:
        """A try failed: return how long to wait before the next one [s]."""
        wait_s = self._next * (1 - 0.5 * self._chance())
        self._next = min(2 * self._next, self._longest)
        return wait_s

    def failed(self, now: float) -> float:
        """A try failed at `now`: return when the next one is due."""
        self.at = now + self.wait()
        return self.at

    def well(self) -> None:
        """Reset after a success: the next failure waits for the shortest time."""
        self._next, self.at = self._first, float("-inf")

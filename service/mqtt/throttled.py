"""Rate-limited messages for a person."""

from collections.abc import Callable
from typing import Protocol

SAID_S = 60.0
"""The same is said once in so long."""
SAID = 64
"""So many different sayings are remembered."""


class Say(Protocol):
    """Writes a message; messages `about` the same are rate-limited."""

    def __call__(self, text: str, about: str = "") -> None:
        """Write it; without `about` it is rate-limited by its text."""


class Said:
    """Writes a message once a minute at most; the next one says how many were left out."""

    def __init__(self, say: Callable[[str], None], clock: Callable[[], float]) -> None:
        self._say, self._clock = say, clock
        self._last: dict[str, tuple[float, int]] = {}  # when it was said, and how often it was not since

    def __call__(self, text: str, about: str = "") -> None:
        """Write it, unless one about the same was written within the minute."""
        now, about = self._clock(), about or text
        at, kept = self._last.pop(about, (float("-inf"), 0))
        if now - at < SAID_S:
            self._last[about] = at, kept + 1
            return
        self._last[about] = now, 0
        while len(self._last) > SAID:
            del self._last[next(iter(self._last))]
        self._say(f"{text} ({kept} times more since the last time)" if kept else text)

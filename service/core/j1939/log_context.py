"""Trouble codes of other devices along a log, on the time scale of its events."""

from collections import deque
from collections.abc import Iterable, Iterator
from typing import TypeVar

from faultline.service.core.frames import Frames
from faultline.service.core.j1939.context import Change, CodeTracker
from faultline.service.core.j1939.identifiers import named
from faultline.service.core.records.context import Context

F = TypeVar("F", bound=Frames)


class LogContext:
    """Looks at the frames of a log as they pass. State: that of a `CodeTracker`, and changes that are not taken yet."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._tracker = CodeTracker()
        self._changes: deque[Change] = deque()
        self._count = 0

    def passing(self, batches: Iterable[F]) -> Iterator[F]:
        """Yield the frames unchanged."""
        for frames in batches:
            self._changes += self._tracker.frames(frames)
            yield frames

    def until(self, t_s: float, origin_s: float | None) -> Iterator[Context]:
        """Yield the records up to log time `t_s` [s], at which sample 0 is known to be at `origin_s` [s], if it is."""
        while self._changes and self._changes[0].t <= t_s:
            change = self._changes.popleft()
            self._count += 1
            identity = f"{self._source}-context-{self._count}", self._count, None
            yield change.record(identity, None if origin_s is None else round(change.t - origin_s, 3))

    def losses(self) -> str:
        """Return what could not be read, in words; nothing where all was."""
        senseless = sorted(self._tracker.unreadable.items())
        found = [
            *self._tracker.parts.not_whole(),
            *(f"{count} of {named(sender)} that make no sense" for sender, count in senseless),
        ]
        return f"trouble codes of other devices that could not be read: {', '.join(found)}" if found else ""

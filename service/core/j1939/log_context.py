"""Trouble codes of other devices along a log, on the time scale of its events."""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import TypeVar

import numpy as np

from faultline.service.core.frames import Frames
from faultline.service.core.j1939.context import Change, CodeTracker
from faultline.service.core.j1939.identifiers import named
from faultline.service.core.records.context import Context

F = TypeVar("F", bound=Frames)


class LogContext:
    """Looks at the frames of a log as they pass. State: a `CodeTracker` a channel, and changes that are not taken yet.

    `channels` are the names of the log's channels, by the index that frames have; records name them where there are
    several.
    """

    def __init__(self, source: str, channels: Sequence[str] = ()) -> None:
        self._source, self._channels = source, channels
        self._trackers: dict[int, CodeTracker] = {}
        self._changes: deque[tuple[str | None, Change]] = deque()
        self._count = 0

    def passing(self, batches: Iterable[F]) -> Iterator[F]:
        """Yield the frames unchanged."""
        for frames in batches:
            self._changes = deque(sorted([*self._changes, *self._changed(frames)], key=_time))  # of several passes
            yield frames

    def _changed(self, frames: Frames) -> list[tuple[str | None, Change]]:
        """Return what changes, with its channel: an address on one bus is not that of another."""
        for channel in np.unique(frames.channel).tolist():
            self._trackers.setdefault(channel, CodeTracker())
        found: list[tuple[str | None, Change]] = []
        for channel, tracker in self._trackers.items():
            name = self._channels[channel] if len(self._channels) > 1 else None
            found += [(name, change) for change in tracker.frames(frames, frames.channel == channel)]
        return found

    def until(self, t_s: float, origin_s: float | None) -> Iterator[Context]:
        """Yield the records up to log time `t_s` [s], at which sample 0 is known to be at `origin_s` [s], if it is."""
        while self._changes and self._changes[0][1].t <= t_s:
            name, change = self._changes.popleft()
            self._count += 1
            identity = f"{self._source}-context-{self._count}", self._count, None
            yield change.record(identity, None if origin_s is None else round(change.t - origin_s, 3), name)

    def losses(self) -> str:
        """Return what could not be read, in words; nothing where all was."""
        found: list[str] = []
        for tracker in self._trackers.values():
            senseless = sorted(tracker.unreadable.items())
            found += tracker.parts.not_whole()
            found += [f"{count} of {named(sender)} that make no sense" for sender, count in senseless]
        return f"trouble codes of other devices that could not be read: {', '.join(found)}" if found else ""


def _time(change: tuple[str | None, Change]) -> float:
    return change[1].t

"""A bundle at work on a bus: its monitor, how its frames come, and the clock that turns arrival into log time."""

from collections.abc import Callable

from service.bundle import Bundle
from service.bus import Bus
from service.bus.losses import Losses
from service.core.decode import DecodeTable
from service.core.events import Event
from service.core.health import Condition, Kind
from service.core.monitor import Monitor
from service.core.traffic import Traffic
from service.logs import Frame

LAG_S = 0.02
"""Ticks run this far [s, wall] behind the clock, so that a frame still in the socket's queue is in its own tick."""

LOST_S = 10.0
"""For so long after the last frame that was lost, frames are being lost [s, wall]."""

_TROUBLES: dict[str, Kind] = {
    "down": "bus-down",
    "removed": "bus-removed",
    "bus-off": "bus-off",
    "error-passive": "error-passive",
}
_SILENT = ("bus-down", "bus-removed", "bus-off")


class Watched:
    """Log time is monotonic time since the first frame, times `speed`."""

    def __init__(self, table: DecodeTable, make: Callable[[], tuple[Monitor, Traffic]], speed: float) -> None:
        """`make` gives fresh ones, of log time 0, that decode by `table`."""
        self.table, self._make, self._speed = table, make, speed
        self._monitor, self._traffic = make()
        self._start: float | None = None  # monotonic time of the first frame
        self._begun: float | None = None  # of the first look, where no frame has come

    def frame(self, frame: Frame) -> list[Event]:
        """Takes a frame; gives the events of the ticks that lie before it."""
        if self._start is None:
            self._start = frame.t
        return self._monitor.frame(self._log_time(frame.t), frame.can_id, frame.is_extended, frame.data)

    def silence(self, until: float) -> list[Event]:
        """Nothing has come up to the monotonic time `until` [s]."""
        return [] if self._start is None else self._monitor.advance(self._log_time(until - LAG_S))

    def look(self, now: float) -> set[Condition]:
        """What is wrong with the frames and signals at the monotonic time `now` [s]."""
        if self._begun is None:
            self._begun = now
        begin = self._begun if self._start is None else self._start
        return self._traffic.look((now - begin) * self._speed, self._monitor.quality)

    def restart(self) -> None:
        """Forgets all that was seen: what comes next has nothing to do with it."""
        self._monitor, self._traffic = self._make()
        self._start = self._begun = None

    def due(self) -> float | None:
        """The monotonic time of the next tick [s]; None before the first frame."""
        tick = self._monitor.next_tick_s
        return None if tick is None or self._start is None else self._start + tick / self._speed + LAG_S

    def _log_time(self, monotonic: float) -> float:
        assert self._start is not None
        return (monotonic - self._start) * self._speed


def watched(bundle: Bundle, source: str, speed: float) -> Watched:
    """A bundle at work; `source` is the vehicle's name."""

    def make() -> tuple[Monitor, Traffic]:
        monitor = Monitor(bundle.manifest, bundle.bank(), bundle.table, source, bundle.id)
        return monitor, Traffic(bundle.table, bundle.manifest.inputs, 0.0)

    return Watched(bundle.table, make, speed)


class Line:
    """A bus and the bundles that listen to it."""

    def __init__(self, name: str, bus: Bus, bundles: list[Watched]) -> None:
        self.name, self.bus, self.bundles = name, bus, bundles
        self.losses = Losses(bus, [bundle.table for bundle in bundles])
        self._dropped, self._lost_at = bus.dropped, -float("inf")

    def listen(self, now: float) -> list[Event]:
        """Takes what the bus has; `now` is the monotonic time before that [s]: what came later has not been read."""
        frames = self.bus.receive()
        events = [event for frame in frames for bundle in self.bundles for event in bundle.frame(frame)]
        if not frames:
            events += [event for bundle in self.bundles for event in bundle.silence(now)]
        return events

    def look(self, now: float) -> set[Condition]:
        """What is wrong with the bus; and with frames and signals, where they could come."""
        found = {Condition(_TROUBLES[self.bus.trouble], self.name)} if self.bus.trouble else set()
        if (dropped := self.bus.dropped) != self._dropped:
            self._dropped, self._lost_at = dropped, now
        if now - self._lost_at < LOST_S:
            found.add(Condition("frames-lost", self.name))
        if any(condition.kind in _SILENT for condition in found):
            return found
        return found.union(*(bundle.look(now) for bundle in self.bundles))

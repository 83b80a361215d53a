"""A bundle at work on a bus: its monitor, how its frames come, and the clock that turns arrival into log time."""

from collections.abc import Callable

import numpy as np

from service.bundle import GRAPH_ERRORS, Bundle
from service.bundle_files import one_line
from service.bus import Bus
from service.bus.losses import Losses
from service.core.alike import decide_alike
from service.core.events import Event
from service.core.health import Condition, Kind
from service.core.monitor import Monitor
from service.core.traffic import Traffic
from service.logs import Frame

LAG_S = 0.02
"""Ticks run this far [s, wall] behind the clock, so that a frame still in the socket's queue is in its own tick."""

FAILED_S = 60.0
"""For so long after a bundle has failed and begun anew, that is told [s, wall]."""

FAILURES: tuple[type[Exception], ...] = (*GRAPH_ERRORS, np.linalg.LinAlgError, FloatingPointError)
"""What a bundle's numbers may do that loads and computes its golden vectors."""

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

    def __init__(self, bundle: Bundle, make: Callable[[Bundle], tuple[Monitor, Traffic]], speed: float) -> None:
        """`make` gives fresh ones, of log time 0."""
        self.bundle, self._make, self._speed = bundle, make, speed
        self._monitor, self._traffic = make(bundle)
        self._start: float | None = None  # monotonic time of the first frame
        self._begun: float | None = None  # of the first look, or of the first frame where that was before
        self._failed_at = -float("inf")

    def frame(self, frame: Frame) -> list[Event]:
        """Takes a frame; gives the events of the ticks that lie before it."""
        if self._start is None:
            self._start = frame.t
            self._begun = frame.t if self._begun is None else self._begun
        return self._monitor.frame(self._log_time(frame.t), frame.can_id, frame.is_extended, frame.data)

    def silence(self, until: float) -> list[Event]:
        """Nothing has come up to the monotonic time `until` [s]."""
        return [] if self._start is None else self._monitor.advance(self._log_time(until - LAG_S))

    def look(self, now: float) -> set[Condition]:
        """What is wrong with the frames and signals at the monotonic time `now` [s]."""
        if self._begun is None:
            self._begun = now
        found = self._traffic.look((now - self._begun) * self._speed, self._monitor.quality)
        self._monitor.doubt(self._traffic.doubted)  # what is doubted is not believed
        if now - self._failed_at < FAILED_S:
            found = found | {Condition("bundle-failed", self.bundle.manifest.name)}
        return found

    def fail(self, now: float) -> None:
        """Something went wrong in it at the monotonic time `now` [s]: it begins anew."""
        self._failed_at = now
        self.restart()

    def restart(self) -> None:
        """Forgets all that was seen: what comes next has nothing to do with it."""
        self._monitor, self._traffic = self._make(self.bundle)
        self._start = self._begun = None

    def take_up(self, bundle: Bundle) -> bool:
        """Goes on with another bundle: with all that was seen if it decides alike, which is returned."""
        if decide_alike(self.bundle.manifest, bundle.manifest) and self.bundle.table.layouts == bundle.table.layouts:
            self.bundle = bundle._replace(table=self.bundle.table)  # with its counts
            self._monitor.rename(bundle.id)
            return True
        self._monitor, self._traffic = self._make(bundle)
        self.bundle, self._start, self._begun = bundle, None, None
        return False

    def due(self) -> float | None:
        """The monotonic time of the next tick [s]; None before the first frame."""
        tick = self._monitor.next_tick_s
        return None if tick is None or self._start is None else self._start + tick / self._speed + LAG_S

    def _log_time(self, monotonic: float) -> float:
        assert self._start is not None
        return (monotonic - self._start) * self._speed


def watched(bundle: Bundle, source: str, speed: float) -> Watched:
    """A bundle at work; `source` is the vehicle's name."""

    def make(bundle: Bundle) -> tuple[Monitor, Traffic]:
        monitor = Monitor(bundle.manifest, bundle.bank(), bundle.table, source, bundle.id)
        return monitor, Traffic(bundle.table, bundle.manifest.inputs, 0.0)

    return Watched(bundle, make, speed)


class Line:
    """A bus and the bundles that listen to it."""

    def __init__(self, name: str, bus: Bus, bundles: list[Watched], say: Callable[[str], None]) -> None:
        self.name, self.bus, self.bundles, self._say = name, bus, bundles, say
        self.losses = Losses(bus, [each.bundle.table for each in bundles])
        self._dropped, self._lost_at = bus.dropped, -float("inf")
        self._why = ""

    def listen(self, now: float) -> list[Event]:
        """Takes what the bus has; `now` is the monotonic time before that [s]: what came later has not been read."""
        frames = self.bus.receive()
        return [event for bundle in self.bundles for event in self._heard_by(bundle, frames, now)]

    def _heard_by(self, bundle: Watched, frames: list[Frame], now: float) -> list[Event]:
        """What one bundle makes of it; where its graphs fail, the others go on."""
        try:
            if not frames:
                return bundle.silence(now)
            return [event for frame in frames for event in bundle.frame(frame)]
        except FAILURES as error:
            self._say(f"bundle {bundle.bundle.manifest.name} begins anew: {one_line(error)}")
            bundle.fail(now)
            return []

    def take_up(self, watched: Watched, bundle: Bundle) -> bool:
        """One of the bundles is another from now on; whether it goes on with what was seen."""
        alike = watched.take_up(bundle)
        tables = [each.bundle.table for each in self.bundles]
        self.bus.want(sorted({one for table in tables for one in table.wanted}))
        self.losses.tables = tables
        return alike

    def look(self, now: float) -> set[Condition]:
        """What is wrong with the bus; and with frames and signals, where they could come."""
        if self.bus.why != self._why:
            self._why = self.bus.why
            self._say(self._why)
        found = {Condition(_TROUBLES[self.bus.trouble], self.name)} if self.bus.trouble else set()
        if (dropped := self.bus.dropped) != self._dropped:
            self._dropped, self._lost_at = dropped, now
        if now - self._lost_at < LOST_S:
            found.add(Condition("frames-lost", self.name))
        if any(condition.kind in _SILENT for condition in found):
            return found
        return found.union(*(bundle.look(now) for bundle in self.bundles))

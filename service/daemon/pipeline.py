"""A bundle at work on a bus: its monitor, how its frames come, and the clock that turns arrival into log time."""

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from faultline.service.bundle.files import one_line
from faultline.service.bundle.load import GRAPH_ERRORS, Bundle
from faultline.service.bus import Bus
from faultline.service.bus.base import Trouble
from faultline.service.bus.losses import Losses
from faultline.service.core.compatibility import decide_alike
from faultline.service.core.decision.decision import Decision
from faultline.service.core.j1939.context import GROUPS, Change, CodeTracker
from faultline.service.core.memory.freeze import Sample
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.event import Event
from faultline.service.core.records.health import Condition, Kind
from faultline.service.core.residuals.observer import Tick
from faultline.service.core.signals.decode import DecodeTable, Wanted, whole_group
from faultline.service.core.signals.traffic import EXPECTED_S, Traffic
from faultline.service.logs import Frame

LAG_S = 0.02
"""Ticks run this far [s, wall] behind the clock, so that a frame still in the socket's queue is in its own tick."""

FAILED_S = 60.0
"""For so long after a bundle has begun anew because it failed, that is told [s, wall]."""
OUT_S, LONGEST_OUT_S = 1.0, 60.0
"""A bundle that fails begins anew after so long [s, wall]; twice as long each time that it fails soon after."""

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
_SILENT: tuple[Trouble, ...] = ("down", "removed", "bus-off")


class Pipeline:
    """Log time is monotonic time since the first frame, times `speed`."""

    def __init__(
        self,
        bundle: Bundle,
        make: Callable[[Bundle], tuple[Monitor, Traffic]],
        speed: float,
        seen: Callable[[Sample], None] | None = None,
        place: str | None = None,
    ) -> None:
        """`make` gives fresh ones, of log time 0; `seen`, where given, is told each tick besides.

        `place` is the folder that the configuration names, where the bundle was taken from another slot.
        """
        self.bundle, self._make, self._speed, self._seen = bundle, make, speed, seen
        self.place = place or bundle.where
        self._samples: list[Sample] = []
        self._renew()
        self._start: float | None = None  # monotonic time of the first frame
        self._begun: float | None = None  # of the first look, or of the first frame where that was before
        self._out_until = -float("inf")
        self._out_s = 0.0

    def hear(self, frames: Sequence[Frame]) -> Iterator[Event]:
        """Takes all frames up to the last one; gives the events of the ticks that lie before it."""
        for frame in frames:
            if frame.t < self._out_until:
                continue
            if self._start is None:
                self._start = frame.t
                self._begun = frame.t if self._begun is None else self._begun
            yield from self._monitor.frame(self._log_time(frame.t), frame.can_id, frame.is_extended, frame.data)
        if frames:
            self._note(frames[-1].t)

    def silence(self, until: float) -> list[Event]:
        """Nothing has come up to the monotonic time `until` [s]."""
        self._note(until)
        return [] if self._start is None else self._monitor.advance(self._log_time(until - LAG_S))

    def look(self, now: float) -> set[Condition]:
        """What is wrong with the frames and signals at the monotonic time `now` [s]."""
        failed = {Condition("bundle-failed", self.bundle.manifest.name)} if now - self._out_until < FAILED_S else set()
        if now < self._out_until:
            return failed
        if self._begun is None:
            self._begun = now
        found = self._traffic.look((now - self._begun) * self._speed, self._monitor.quality)
        self._monitor.doubt(self._traffic.doubted)  # what is doubted is not believed
        return found | failed

    def knows(self, now: float) -> bool:
        """Whether at the monotonic time `now` [s] it has seen enough to say what is wrong with frames."""
        waited = self._begun is not None and now - self._begun >= EXPECTED_S
        return self._monitor.quality is not None or waited

    def fail(self, now: float) -> float:
        """Something went wrong in it at the monotonic time `now` [s]: it begins anew, after the seconds returned."""
        soon = now - self._out_until < FAILED_S
        self._out_s = min(2.0 * self._out_s, LONGEST_OUT_S) if soon else OUT_S
        self._out_until = now + self._out_s
        self.restart()
        return self._out_s

    def restart(self) -> None:
        """Forgets all that was seen: what comes next has nothing to do with it."""
        self._renew()
        self._start = self._begun = None

    def taken(self) -> list[Sample]:
        """The ticks since this was asked last."""
        samples, self._samples = self._samples, []
        return samples

    def take_up(self, bundle: Bundle) -> bool:
        """Goes on with another bundle: with all that was seen if it decides alike, which is returned."""
        if decide_alike(self.bundle.manifest, bundle.manifest) and self.bundle.table.layouts == bundle.table.layouts:
            self.bundle = bundle._replace(table=self.bundle.table)  # with its counts
            self._monitor.rename(bundle.id)
            return True
        self.bundle, self._start, self._begun = bundle, None, None
        self._renew()
        return False

    def due(self) -> float | None:
        """The monotonic time of the next tick [s]; None before the first frame."""
        tick = self._monitor.next_tick_s
        return None if tick is None or self._start is None else self._start + tick / self._speed + LAG_S

    def _renew(self) -> None:
        self._monitor, self._traffic = self._make(self.bundle)
        self._monitor.watch = self._watch

    def _watch(self, tick: Tick, decision: Decision) -> None:
        sample = Sample.of(tick, decision)
        self._samples.append(sample)
        if self._seen is not None:
            self._seen(sample)

    def _note(self, t: float) -> None:
        """All frames up to the monotonic time `t` [s] have been decoded."""
        if self._begun is not None:
            self._traffic.note((t - self._begun) * self._speed)

    def _log_time(self, monotonic: float) -> float:
        assert self._start is not None
        return (monotonic - self._start) * self._speed


def watched(
    bundle: Bundle,
    source: str,
    speed: float,
    seen: Callable[[Sample], None] | None = None,
    place: str | None = None,
) -> Pipeline:
    """A bundle at work; `source` is the vehicle's name, `seen` who keeps all ticks."""

    def make(bundle: Bundle) -> tuple[Monitor, Traffic]:
        monitor = Monitor(bundle.manifest, bundle.bank(), bundle.table, source, bundle.id)
        bundle.table.run_at(speed)
        return monitor, Traffic(bundle.table, bundle.manifest.inputs, 0.0, speed)

    return Pipeline(bundle, make, speed, seen, place)


def wanted_by(tables: Iterable[DecodeTable], codes: bool) -> list[Wanted]:
    """Return the frames that tables need, and with `codes` those of other devices' trouble codes."""
    found = {one for table in tables for one in table.wanted}
    return sorted(found | {whole_group(pgn) for pgn in GROUPS} if codes else found)


class BusChannel:
    """A bus and the bundles that listen to it."""

    def __init__(
        self,
        name: str,
        bus: Bus,
        bundles: list[Pipeline],
        say: Callable[[str], None],
        interface: str = "",
        codes: CodeTracker | None = None,
    ) -> None:
        """`interface` is what the configuration calls it; `codes`, where given, tracks what other devices report."""
        self.name, self.bus, self.bundles, self._say = name, bus, bundles, say
        self.interface = interface
        self.losses = Losses(bus, [each.bundle.table for each in bundles])
        self._dropped, self._lost_at = bus.dropped, -float("inf")
        self._why = ""
        self._codes = codes
        self._changes: list[Change] = []

    def listen(self, now: float) -> list[tuple[Pipeline, list[Event]]]:
        """Takes what the bus has; `now` is the monotonic time before that [s]: what came later has not been read."""
        frames = self.bus.receive()
        if self._codes is not None:
            for frame in frames:
                self._changes += self._codes.frame(*frame)
            self._changes += self._codes.look(now) if not frames else []
        return [(bundle, self._heard_by(bundle, frames, now)) for bundle in self.bundles]

    def changes(self) -> list[Change]:
        """Return what other devices have said of their trouble codes since this was asked last."""
        found, self._changes = self._changes, []
        return found

    def _heard_by(self, bundle: Pipeline, frames: list[Frame], now: float) -> list[Event]:
        """What one bundle makes of it; where its graphs fail, the others go on."""
        events: list[Event] = []
        try:
            events.extend(bundle.hear(frames) if frames else bundle.silence(now))  # those before a failure stay
        except FAILURES as error:
            out_s = bundle.fail(now)
            self._say(f"bundle {bundle.bundle.manifest.name} begins anew in {out_s:.0f} s: {one_line(error)}")
        return events

    def take_up(self, watched: Pipeline, bundle: Bundle) -> bool:
        """One of the bundles is another from now on; whether it goes on with what was seen."""
        alike = watched.take_up(bundle)
        self._want()
        return alike

    def add(self, watched: Pipeline) -> None:
        """Listen for one bundle more."""
        self.bundles.append(watched)
        self._want()

    def _want(self) -> None:
        tables = [each.bundle.table for each in self.bundles]
        self.bus.want(wanted_by(tables, self._codes is not None))
        self.losses.tables = tables

    def knows(self, now: float) -> bool:
        """Whether what is not found is not there: the bundles have had time to see it, or the bus says why not."""
        return self.bus.trouble in _SILENT or all(bundle.knows(now) for bundle in self.bundles)

    def look(self, now: float) -> set[Condition]:
        """What is wrong with the bus; and with frames and signals, where they could come."""
        if self.bus.why != self._why:
            self._why = self.bus.why
            if self._why:
                self._say(self._why)
        found = {Condition(_TROUBLES[self.bus.trouble], self.name)} if self.bus.trouble else set()
        if (dropped := self.bus.dropped) != self._dropped:
            self._dropped, self._lost_at = dropped, now
        if now - self._lost_at < LOST_S:
            found.add(Condition("frames-lost", self.name))
        if self.bus.trouble in _SILENT:
            return found
        return found.union(*(bundle.look(now) for bundle in self.bundles))

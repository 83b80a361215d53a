"""Pipeline of a bundle on a bus: its monitor, its traffic check, and the clock that turns arrival into log time."""

from bisect import bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from itertools import groupby

import msgspec
import numpy as np

from faultline.service.bundle.files import BundleError, one_line
from faultline.service.bundle.load import GRAPH_ERRORS, Bundle
from faultline.service.bus import Bus
from faultline.service.bus.base import BATCH, Trouble
from faultline.service.bus.losses import Losses
from faultline.service.core.compatibility import are_compatible
from faultline.service.core.decision.decision import Decision
from faultline.service.core.decision.offsets import shifted
from faultline.service.core.decision.relearning import Baseline, Relearning
from faultline.service.core.j1939.context import GROUPS, Change, CodeTracker
from faultline.service.core.memory.freeze import Sample
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.event import Event
from faultline.service.core.records.health import Condition, Kind
from faultline.service.core.residuals.observer import Tick
from faultline.service.core.signals.decode import DecodeTable, Wanted, whole_group
from faultline.service.core.signals.received import Received
from faultline.service.core.signals.traffic import EXPECTED_S, Traffic
from faultline.service.logs import Frame

LAG_S = 0.02
"""Ticks run this far [s, wall] behind the clock, so that a frame still in the socket's queue is in its own tick."""

TOGETHER = 2
"""Ticks decided one after the other: the second finds the processor's caches warm. The first is a period late."""

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
    """Monitor of a bundle on a bus. Log time is monotonic time since the first frame, times `speed`."""

    def __init__(
        self,
        bundle: Bundle,
        make: Callable[[Bundle], tuple[Monitor, Traffic]],
        speed: float,
        seen: Callable[[Sample], None] | None = None,
        place: str | None = None,
    ) -> None:
        """Store the callables: `make` returns fresh objects, of log time 0; `seen`, if given, is called with each tick.

        `place` is the folder that the configuration names, where the bundle was taken from another slot.
        """
        self.bundle, self._make, self._speed, self._seen = bundle, make, speed, seen
        self.place = place or bundle.where
        self._baseline: Baseline | None = None
        self._relearning: Relearning | None = None
        self._samples: list[Sample] = []
        self._renew()
        self._waiting: list[tuple[float, str, Frame]] = []  # of a bundle of several buses: time, bus, frame
        self._read_until: dict[str, float] = {}  # by bus: all frames until that monotonic time have been read
        self._start: float | None = None  # monotonic time of the first frame
        self._begun: float | None = None  # of the first look, or of the first frame where that was before
        self._out_until = -float("inf")
        self._out_s = 0.0

    def put(self, bus: str, frames: Sequence[Frame], now: float) -> None:
        """Keep the frames of one of several buses, read at the monotonic time `now` [s], until all have been read."""
        self._waiting += [(frame.t, bus, frame) for frame in frames]
        self._read_until[bus] = frames[-1].t if len(frames) >= BATCH else now

    def hear_all(self, frames: Sequence[Frame], now: float) -> Iterator[Event]:
        """Take the frames of the bus without a name, and those that were put, in order of time; yield the events.

        So far as all buses have been read: what may still be in a queue is waited for.
        """
        self.put("", frames, now)
        until = min(self._read_until.get(bus, -float("inf")) for bus in ("", *self.bundle.table.buses)) - LAG_S
        self._waiting.sort(key=lambda each: each[0])
        count = bisect_right(self._waiting, until, key=lambda each: each[0])
        ready, self._waiting = self._waiting[:count], self._waiting[count:]
        for bus, group in groupby(ready, key=lambda each: each[1]):
            yield from self.hear([frame for _, _, frame in group], bus)
        if until > -float("inf"):
            yield from self.silence(until + LAG_S)

    def hear(self, frames: Sequence[Frame], bus: str = "") -> Iterator[Event]:
        """Take all frames of a bus up to the last one; yield the events of the ticks before it."""
        for frame in frames:
            if frame.t < self._out_until:
                continue
            if self._start is None:
                self._start = frame.t
                self._begun = frame.t if self._begun is None else self._begun
            yield from self._monitor.frame(self._log_time(frame.t), frame.can_id, frame.is_extended, frame.data, bus)
        if frames:
            self._note(frames[-1].t)

    def take(self, piece: Received) -> Iterator[Event]:
        """Take the next piece of a log's signals, from time 0 on; yield the events of the ticks before its end."""
        self._start = self._begun = 0.0
        yield from self._monitor.piece(piece)
        self._note(piece.last_s)

    def silence(self, until: float) -> list[Event]:
        """Advance to the monotonic time `until` [s] without frames; return the events."""
        self._note(until)
        return [] if self._start is None else self._monitor.advance(self._log_time(until - LAG_S))

    def look(self, now: float) -> set[Condition]:
        """Return the conditions of frames and signals at the monotonic time `now` [s]."""
        failed = {Condition("bundle-failed", self.bundle.manifest.name)} if now - self._out_until < FAILED_S else set()
        if now < self._out_until:
            return failed
        if self._begun is None:
            self._begun = now
        if self._relearning is not None and not self._relearning.wanting:
            self._take_baseline()
            self._begun = now
        if self._relearning is not None:
            failed.add(Condition("relearning", self.bundle.manifest.name))
        found = self._traffic.look((now - self._begun) * self._speed, self._monitor.quality)
        self._monitor.doubt(self._traffic.doubted)  # what is doubted is not believed
        return found | failed

    @property
    def baseline(self) -> Baseline | None:
        """Return what replaces the bundle's baseline, learnt or still being learnt; None where nothing does."""
        if self._baseline is None or self._relearning is None:
            return self._baseline
        return msgspec.structs.replace(self._baseline, sums=self._relearning.sums)

    @property
    def wanting(self) -> list[str]:
        """Return the operating modes of which more has to be seen while the baseline is learnt."""
        return [] if self._relearning is None else self._relearning.wanting

    def begin_with(self, baseline: Baseline) -> None:
        """Begin anew with a baseline that has been learnt, or go on to learn it."""
        self._baseline = baseline
        is_learnt = baseline.moved is not None
        self._relearning = None if is_learnt else Relearning(self.bundle.manifest, baseline.sums)
        self.restart()

    def _take_baseline(self) -> None:
        """Begin anew with what has been learnt."""
        assert self._relearning is not None
        assert self._baseline is not None
        moved = self._relearning.moved().tolist()
        self.begin_with(msgspec.structs.replace(self._baseline, sums=None, moved=moved))

    def knows(self, now: float) -> bool:
        """Return True if by the monotonic time `now` [s] it has seen enough to judge the frames."""
        waited = self._begun is not None and now - self._begun >= EXPECTED_S
        return self._monitor.quality is not None or waited

    def fail(self, now: float) -> float:
        """Begin anew after a failure at the monotonic time `now` [s]; return the seconds until then."""
        soon = now - self._out_until < FAILED_S
        self._out_s = min(2.0 * self._out_s, LONGEST_OUT_S) if soon else OUT_S
        self._out_until = now + self._out_s
        self.restart()
        return self._out_s

    def restart(self) -> None:
        """Reset the diagnosis state: what comes next is unrelated."""
        self._renew()
        self._start = self._begun = None
        self._waiting = []

    def taken(self) -> list[Sample]:
        """Return the ticks since the last call."""
        samples, self._samples = self._samples, []
        return samples

    def take_up(self, bundle: Bundle) -> bool:
        """Go on with another bundle; return True if it is compatible, and the diagnosis state kept."""
        ours, theirs = self.bundle.table, bundle.table
        if are_compatible(self.bundle.manifest, bundle.manifest) and ours.all_layouts == theirs.all_layouts:
            self.bundle = bundle._replace(table=ours)  # with its counts
            self._monitor.rename(bundle.id)
            return True
        self.bundle, self._start, self._begun = bundle, None, None
        self._baseline = self._relearning = None
        self._renew()
        return False

    def due(self) -> float | None:
        """Return the monotonic time at which the next `TOGETHER` ticks are due [s]; None before the first frame."""
        tick = self._monitor.next_tick_s
        if tick is None or self._start is None:
            return None
        last = tick + (TOGETHER - 1) * self.bundle.manifest.period_s
        return self._start + last / self._speed + LAG_S

    def _renew(self) -> None:
        bundle = self.bundle
        if self._baseline is not None and self._baseline.moved is not None:
            bundle = bundle._replace(manifest=shifted(bundle.manifest, np.array(self._baseline.moved)))
        self._monitor, self._traffic = self._make(bundle)
        self._monitor.watch, self._monitor.relearning = self._watch, self._relearning

    def _watch(self, tick: Tick, decision: Decision) -> None:
        sample = Sample.of(tick, decision)
        self._samples.append(sample)
        if self._seen is not None:
            self._seen(sample)

    def _note(self, t: float) -> None:
        """Note that all frames up to the monotonic time `t` [s] have been decoded."""
        if self._begun is not None:
            self._traffic.note((t - self._begun) * self._speed)

    def _log_time(self, monotonic: float) -> float:
        assert self._start is not None
        return (monotonic - self._start) * self._speed


def watched(
    bundle: Bundle, source: str, speed: float, seen: Callable[[Sample], None] | None = None, place: str | None = None
) -> Pipeline:
    """Return the pipeline of a bundle; `source` is the vehicle's name, `seen` is called with each tick."""

    def make(bundle: Bundle) -> tuple[Monitor, Traffic]:
        monitor = Monitor(bundle.manifest, bundle.bank(), bundle.table, source, bundle.id)
        bundle.table.run_at(speed)
        return monitor, Traffic(bundle.table, bundle.manifest.inputs, 0.0, speed)

    return Pipeline(bundle, make, speed, seen, place)


def wanted_by(tables: Iterable[DecodeTable], codes: bool) -> list[Wanted]:
    """Return the frames that tables need, and with `codes` those of other devices' trouble codes."""
    found = {one for table in tables for one in table.wanted}
    return sorted(found | {whole_group(pgn) for pgn in GROUPS} if codes else found)


def check_buses(bundle: Bundle, names: Collection[str]) -> None:
    """Refuse a bundle that takes messages from a bus which is none of these.

    Raises:
        BundleError: it does.
    """
    for bus, table in bundle.table.buses.items():
        if bus not in names:
            messages = " and ".join(layout.name for layout in table.layouts)
            raise BundleError(
                f"{bundle.where}: {messages} come on bus {bus}, which the configuration has not; its buses are "
                f"{', '.join(names)}: add a [[bus]] of that name"
            )


def connect(lines: Sequence["BusChannel"]) -> None:
    """Let each bus listen for the pipelines of others some of whose messages come on it."""
    for line in lines:
        line.welcome([each for other in lines for each in other.bundles if line.name in each.bundle.table.buses])


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
        self.guests: list[Pipeline] = []
        """Pipelines of other buses some of whose messages come on this one."""
        self.losses = Losses(bus, [each.bundle.table for each in bundles])
        self._dropped, self._lost_at = bus.dropped, -float("inf")
        self._why = ""
        self._codes = codes
        self._changes: list[Change] = []
        self.rest_s = 0.0
        """For how long the bus need not be looked at [s]: 0 while it is silent, or has more than was read."""

    def listen(self, now: float) -> list[tuple[Pipeline, list[Event]]]:
        """Takes what the bus has; `now` is the monotonic time before that [s]: what came later has not been read."""
        frames = self.bus.receive()
        self.rest_s = self.bus.rest_s if frames and self.bus.is_read_out else 0.0
        if self._codes is not None:
            for frame in frames:
                self._changes += self._codes.frame(*frame)
            self._changes += self._codes.look(now) if not frames else []
        for guest in self.guests:
            guest.put(self.name, frames, now)
        return [(bundle, self._heard_by(bundle, frames, now)) for bundle in self.bundles]

    def changes(self) -> list[Change]:
        """Return what other devices have said of their trouble codes since this was asked last."""
        found, self._changes = self._changes, []
        return found

    def _heard_by(self, bundle: Pipeline, frames: list[Frame], now: float) -> list[Event]:
        """Yield the events of one bundle; if its graphs fail, the others go on."""
        events: list[Event] = []
        try:
            if bundle.bundle.table.buses:
                events.extend(bundle.hear_all(frames, now))
            else:
                events.extend(bundle.hear(frames))  # those before a failure stay
                if self.bus.is_read_out or not frames:
                    events.extend(bundle.silence(now))
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

    def welcome(self, guests: list[Pipeline]) -> None:
        """Listen for pipelines of other buses too, instead of those before."""
        if guests != self.guests:
            self.guests = guests
            self._want()

    def _want(self) -> None:
        tables = [each.bundle.table for each in self.bundles]
        others = [each.bundle.table.of_bus(self.name) for each in self.guests]
        self.bus.want(wanted_by([*tables, *others], self._codes is not None))
        self.losses.tables = tables

    def knows(self, now: float) -> bool:
        """Return True if absent conditions are refuted: the bundles have had time, or the bus says why not."""
        return self.bus.trouble in _SILENT or all(bundle.knows(now) for bundle in self.bundles)

    def look(self, now: float) -> set[Condition]:
        """Return the conditions of the bus; and of frames and signals, if they could come."""
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

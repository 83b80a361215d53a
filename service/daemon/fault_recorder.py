"""Recording of faults: events, ticks and operation cycles in; records and rows of the store out."""

import re
import traceback
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import chain, count
from pathlib import Path

import msgspec

from faultline.service.core.decision.relearning import Baseline
from faultline.service.core.memory.fault_memory import FaultChange, FaultMemory, Remembered
from faultline.service.core.memory.freeze import Recorder, Sample
from faultline.service.core.memory.rules import Rules
from faultline.service.core.memory.system import System
from faultline.service.core.records.event import Event
from faultline.service.core.records.fault import CLEARED, SCHEMA, Change, Cleared, Fault, FaultRecord
from faultline.service.core.records.freeze_frame import FreezeFrame
from faultline.service.core.records.health import Condition
from faultline.service.core.records.line import encode
from faultline.service.daemon.cycle import Cycle, OperationCycle
from faultline.service.daemon.kept_rows import KeptRows
from faultline.service.daemon.pipeline import BusChannel, Pipeline
from faultline.service.daemon.sequencer import Sequencer
from faultline.service.daemon.sequencer import now as wall_clock
from faultline.service.store.file import Record
from faultline.service.store.journal import Journal

FRAMED: frozenset[Change | None] = frozenset(("pending", "confirmed", "failed"))
"""Changes of which a freeze frame is taken."""

UNKEPT = 1000
"""Events of a run that are kept for a store that opens late, of all systems together."""

BASELINES_S = 30.0
"""How often what has been learnt of a baseline is kept [s]: a loss of power costs so much of it."""

FAILED_S = 60.0
"""For so long after the fault memory has failed, that is told [s]."""


class SystemState:
    """System with its recent samples, and the freeze frames whose excerpt goes on, by their name."""

    def __init__(self, line: BusChannel, watched: Pipeline, seconds: float) -> None:
        self.line, self.watched, self._seconds = line, watched, seconds
        self.name = watched.bundle.manifest.name
        self.system: System
        self.unfinished: dict[str, FreezeFrame] = {}
        self.begin()

    def rename(self, name: str) -> None:
        """Take the name that the fault memory has for it: another than the bundle's where two have that."""
        self.name, self.system = name, self.system._replace(name=name)

    def begin(self) -> None:
        """With the bundle that is at work now."""
        self.bundle = self.watched.bundle
        self.system = System.of(self.bundle.manifest, self.bundle.id)._replace(name=self.name)
        self.recorder = Recorder(self.bundle.manifest, self._seconds)

    @property
    def counters(self) -> dict[str, int]:
        """Return the counters of its bus since the service started."""
        return {**vars(self.line.bus.counts), "dropped": self.line.bus.dropped}


class FaultRecorder:
    """Keeps the fault memory as the journal has it, and puts records into the journal.

    `boot` is the kernel's identifier of this boot, `now` the monotonic time [s], `standing` gives the conditions that
    stand as text, for freeze frames; `absent` are bundles that are configured and do not run, as `PLACE on BUS`.
    What an earlier run kept and makes no sense is set aside; and whatever fails in here, the fault memory goes on with
    what is kept: both are `conditions`, and `say` is told.
    """

    def __init__(
        self,
        sequencer: Sequencer,
        journal: Journal,
        lines: Sequence[BusChannel],
        rules: Rules,
        frame_s: float,
        boot: str,
        now: float,
        say: Callable[[str], None],
        standing: Callable[[], Sequence[str]],
        absent: Collection[str] = (),
    ) -> None:
        self._sequencer, self._journal, self.lines = sequencer, journal, lines
        self._say, self._standing = say, standing
        self._rules, self._boot, self._now = rules, boot, now
        self._failed_at, self._failure = -float("inf"), ""
        self._rows = KeptRows(journal, say)
        self._baselines_due = now
        self._frame_s, self._absent = frame_s, frozenset(absent)
        self._unkept = deque[tuple[SystemState, Event, list[str]]](maxlen=UNKEPT)
        self._given = next(self._rows.read(["names"], dict[str, str]), {})
        self.systems: dict[str, SystemState] = {}
        for line in lines:
            for each in line.bundles:
                self._observe(line, each)
        self.begin()

    def add(self, line: BusChannel, watched: Pipeline) -> None:
        """Remember the faults of a bundle that came up after the start too."""
        self.memory.watch(self._observe(line, watched).system)

    def take_up(self) -> None:
        """Go on with a store that was opened late: faults of this run are added to those of the store."""
        systems = [*self.systems.values()]
        self.systems, self._given = {}, next(self._rows.read(["names"], dict[str, str]), {})
        for here in systems:
            self._name(here)
            self._recall(here)
        self.begin()
        self.look(self._now)  # the cycle that lasts is this run's
        for here, event, showing in self._unkept:
            with self._surviving():
                news = self.memory.event(here.name, event, showing)
                self._tell([], news, self._framed(here, news, event))
        self._unkept.clear()

    def _observe(self, line: BusChannel, watched: Pipeline) -> SystemState:
        here = SystemState(line, watched, self._frame_s)
        self._name(here)
        self._recall(here)
        return here

    def relearn(self, here: SystemState, by: str) -> None:
        """Let a system learn its baseline anew, on behalf of the person `by`."""
        self._say(f"{here.name}: {by} lets it learn its baseline anew; until then it finds no fault")
        here.watched.begin_with(Baseline(bundle=here.bundle.id, begun=wall_clock(), by=by))
        self._keep_baseline(here)

    def _recall(self, here: SystemState) -> None:
        """Go on with the baseline that an earlier run has learnt, or had begun to learn, for the same bundle."""
        key = f"baseline/{here.name}"
        for baseline in self._rows.read([key], Baseline):
            if not baseline.is_of(here.bundle.manifest):
                self._rows.set_aside(key, "it is of other generators or modes")
            elif baseline.bundle == here.bundle.id:
                here.watched.begin_with(baseline)
            else:
                self._say(f"{here.name}: the baseline that was learnt is of bundle {baseline.bundle[:12]}; forgotten")
                self._journal.remember({key: None})

    def _keep_baseline(self, here: SystemState) -> None:
        """Keep what replaces the bundle's baseline, as far as it has been learnt."""
        key, baseline = f"baseline/{here.name}", here.watched.baseline
        row = None
        if baseline is not None:
            row = msgspec.json.encode(msgspec.structs.replace(baseline, bundle=here.watched.bundle.id))
        if row != self._journal.kept.get(key):
            self._journal.remember({key: row})

    def _name(self, here: SystemState) -> None:
        """Give the bundle's system a name of its own, and keep it: whatever else is configured or refused later.

        It is the bundle's, with the bus's where two have the same, or a number too.
        """
        line, own = here.line, here.bundle.manifest.name
        key = f"{here.watched.place} on {line.name}"
        is_first = key not in [f"{each.watched.place} on {each.line.name}" for each in self.systems.values()]
        before = self._given.get(key, "") if is_first else ""
        taken = {*self.systems, *(name for of, name in self._given.items() if of in self._absent and of != key)}
        everybody = [each.bundle.manifest.name for other in self.lines for each in other.bundles]
        usual = own if everybody.count(own) == 1 and own not in taken else f"{own}@{line.name}"
        names = chain([before] * before.startswith(own), [usual], (f"{usual}-{number}" for number in count(2)))
        name = next(each for each in names if each not in taken)
        here.rename(name)
        self.systems[name] = here
        if is_first and before != name:
            self._given = {**self._given, key: name}
            self._journal.remember({"names": msgspec.json.encode(self._given)})

    def begin(self) -> None:
        """Begin with the content of the store, as after a restart."""
        cycle = next(self._rows.read(["cycle"], Cycle), Cycle())
        self._cycle = OperationCycle(cycle, self._boot, self._now)
        rows = [*self._journal.kept]
        faults = {f"fault/{each.number}": each for each in self._rows.read(self._rows.named("fault"), Fault)}
        for name in self._rows.named("frame"):
            if f"fault/{name.split('/')[1]}" in faults:
                [*self._rows.read([name], FreezeFrame)]
            else:
                self._rows.set_aside(name, "it is of no fault that is remembered")
        memory = next(self._rows.read(["memory"], Remembered), Remembered())
        used = [int(each) for name in rows for each in re.findall(r"(?:fault|frame)/(\d{1,15})", name)]
        memory = msgspec.structs.replace(memory, number=max([memory.number, *(each + 1 for each in used)]))
        self.memory = FaultMemory(self._rules, faults.values(), memory, cycle.number)
        for each in self.systems.values():
            each.unfinished.clear()
            self.memory.watch(each.system)

    @property
    def conditions(self) -> set[Condition]:
        """Return the conditions of the fault memory."""
        found = set()
        if self._rows.is_damaged:
            found.add(Condition("rows-set-aside", str(self._journal.path)))
        if self._now - self._failed_at < FAILED_S:
            found.add(Condition("memory-failed", "the fault memory"))
        return found

    @property
    def cycle(self) -> int:
        """Return the number of the operation cycle."""
        return self._cycle.cycle.number

    def take(self, watched: Pipeline, events: Iterable[Event]) -> None:
        """Take the ticks of a bundle since the last call, and their events."""
        here = next(each for each in self.systems.values() if each.watched is watched)
        if here.bundle is not watched.bundle:
            here.begin()
            self.memory.watch(here.system)
        samples = iter(watched.taken())
        for event in events:
            for sample in samples:
                self._see(here, sample)
                if sample.tick >= event.tick:
                    break
            self._hear(here, self._sequencer.event(event))
        for sample in samples:
            self._see(here, sample)

    def look(self, now: float) -> None:
        """Update operation cycles, and freeze frames whose excerpt is complete; `now` is the monotonic time [s]."""
        self._now = now
        with self._surviving():
            self._follow(self._cycle.look(sum(line.bus.counts.frames for line in self.lines), now))
            if now >= self._baselines_due:
                self._baselines_due = now + BASELINES_S
                for here in self.systems.values():
                    self._keep_baseline(here)
            for here in self.systems.values():
                for name, frame in [*here.unfinished.items()]:
                    if (done := here.recorder.completed(frame)) is not None:
                        del here.unfinished[name]
                        if name in self._journal.kept:  # else it was erased meanwhile
                            self._journal.remember({name: msgspec.json.encode(done)})

    def slept(self) -> None:
        """End the operation cycle: the machine slept."""
        with self._surviving():
            self._follow(self._cycle.end())

    def clear(self, number: int | None, by: str) -> Cleared | None:
        """Erase one fault, or all, on behalf of the person `by`.

        The record of that, which is not kept yet; None where the fault memory failed, and nothing is erased.
        """
        cleared: Cleared | None = None
        with self._surviving():
            cleared = self._clear(number, by)
        return cleared  # noqa: RET504 None where it failed

    def _clear(self, number: int | None, by: str) -> Cleared:
        names = {fault: self._names(fault) for fault in self.memory.faults}
        numbers = self.memory.clear(number)
        named, seq, wall = self._sequencer.next()
        cleared = Cleared(schema=CLEARED, id=named, seq=seq, wall=wall, numbers=numbers, by=by)
        gone: dict[str, bytes | None] = dict.fromkeys(chain.from_iterable(names[each] for each in numbers))
        gone["memory"] = msgspec.json.encode(self.memory.remembered)  # the overflow flag
        self._put([Record(seq, "fault", encode(cleared))], gone)
        return cleared

    def frames(self, number: int) -> dict[str, msgspec.Raw]:
        """Return the freeze frames of a fault: `first`, and `latest` where it occurred again."""
        found = ((name.rpartition("/")[2], self._journal.kept.get(name)) for name in self._names(number)[1:])
        return {which: msgspec.Raw(text) for which, text in found if text is not None}

    def _see(self, here: SystemState, sample: Sample) -> None:
        with self._surviving():
            here.recorder.add(sample)
            news = self.memory.tick(here.name, sample.mode, sample.usable, sample.suspicious)
            if news:
                event = self.memory.told(here.name)
                self._tell([], news, self._framed(here, news, event) if event is not None else {})

    def _hear(self, here: SystemState, event: Event) -> None:
        record = Record(event.seq, "event", encode(event))
        is_put = False
        with self._surviving():
            sample = here.recorder.latest
            showing = [*sample.showing] if sample else []
            if not self._journal.is_open:
                self._unkept.append((here, event, showing))
            news = self.memory.event(here.name, event, showing)
            self._tell([record], news, self._framed(here, news, event))
            is_put = True
        if not is_put:
            self._put([record], {})  # it is told whatever becomes of the memory

    @contextmanager
    def _surviving(self) -> Iterator[None]:
        """Catch a failure of the body; the memory then goes on with what the store has, as after a restart."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 diagnosis goes on whatever the memory does: that is told
            place = traceback.extract_tb(error.__traceback__)[-1]
            failure = f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"
            if failure != self._failure or self._now - self._failed_at >= FAILED_S:
                self._say(f"the fault memory failed, and goes on with what is kept: {failure}")
            self._failed_at, self._failure = self._now, failure
            self.begin()

    def _framed(self, here: SystemState, news: Iterable[FaultChange], event: Event) -> dict[str, bytes]:
        """Return the freeze frames of what has failed, by their names in the store."""
        frames: dict[str, bytes] = {}
        for each in news:
            if each.change in FRAMED and here.recorder.holds(event.tick):
                first, latest = self._names(each.fault.number)[1:]
                name = latest if first in self._journal.kept else first
                frame = here.recorder.frame(event, self._standing(), here.counters)
                here.unfinished[name], frames[name] = frame, msgspec.json.encode(frame)
        return frames

    def _follow(self, steps: Iterable[str]) -> None:
        for step in steps:
            news = self.memory.begin_cycle(self.cycle) if step == "begun" else self.memory.end_cycle()
            self._tell([], news, {"cycle": msgspec.json.encode(self._cycle.cycle)})

    def _tell(self, records: list[Record], news: Sequence[FaultChange], kept: dict[str, bytes] | None = None) -> None:
        """Put the records, those of changed faults, and their rows into the store: all of it or nothing."""
        rows: dict[str, bytes | None] = {}
        for change, fault in news:
            if change is not None:
                named, seq, wall = self._sequencer.next()
                record = FaultRecord(schema=SCHEMA, id=named, seq=seq, wall=wall, change=change, fault=fault)
                records.append(Record(seq, "fault", encode(record)))
            if fault.number not in self.memory.faults:
                rows.update(dict.fromkeys(self._names(fault.number)))
            elif change == "withdrawn":  # the latest frame is of what it was not
                latest = self._names(fault.number)[2]
                rows[latest] = None
                for here in self.systems.values():
                    here.unfinished.pop(latest, None)
                rows[self._names(fault.number)[0]] = msgspec.json.encode(fault)
            else:
                rows[self._names(fault.number)[0]] = msgspec.json.encode(self.memory.faults[fault.number])
        self._put(records, {**rows, **(kept or {})})

    def _put(self, records: Sequence[Record], rows: dict[str, bytes | None]) -> None:
        if rows:
            rows["memory"] = msgspec.json.encode(self.memory.remembered)
        self._journal.put(*records, kept=rows)

    def _names(self, number: int) -> list[str]:
        """Return the names of the rows of a fault and its freeze frames."""
        return [f"fault/{number}", f"frame/{number}/first", f"frame/{number}/latest"]

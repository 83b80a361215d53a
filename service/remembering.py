"""The fault memory at work: told events, ticks and operation cycles in; records, and what is to be kept, out."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import TypeVar

import msgspec

from service.core.events import Event, encode
from service.core.faults import (
    CLEARED,
    SCHEMA,
    Change,
    Cleared,
    Fault,
    FaultRecord,
    encode_record,
)
from service.core.frame import Frame
from service.core.freeze import Recorder, Sample
from service.core.memory import FaultMemory, News, Remembered, Rules
from service.core.system import System
from service.cycle import Cycle, OperationCycle
from service.scribe import Scribe
from service.store.file import Record
from service.store.journal import Journal
from service.watched import Line, Watched

FRAMED: frozenset[Change | None] = frozenset(("pending", "confirmed", "failed"))
"""Changes of which a freeze frame is taken."""

T = TypeVar("T")


class Observed:
    """A system with what was seen of it lately, and the freeze frames whose excerpt goes on, by their name."""

    def __init__(self, name: str, line: Line, watched: Watched, seconds: float) -> None:
        self.name, self.line, self.watched, self._seconds = name, line, watched, seconds
        self.unfinished: dict[str, Frame] = {}
        self.begin()

    def begin(self) -> None:
        """With the bundle that is at work now."""
        self.bundle = self.watched.bundle
        self.system = System.of(self.bundle.manifest, self.bundle.id)._replace(name=self.name)
        self.recorder = Recorder(self.bundle.manifest, self._seconds)

    @property
    def counters(self) -> dict[str, int]:
        """What came over its bus since the service started, and what did not."""
        return {**vars(self.line.bus.counts), "dropped": self.line.bus.dropped}


class Remembering:
    """Keeps the fault memory as the journal has it, and puts what is told into the journal.

    `boot` is the kernel's identifier of this boot, `now` the monotonic time [s], `standing` gives the conditions that
    stand as text, for freeze frames. What an earlier run kept and cannot be read is kept apart, and `say` is told.
    """

    def __init__(
        self,
        scribe: Scribe,
        journal: Journal,
        lines: Sequence[Line],
        rules: Rules,
        frame_s: float,
        boot: str,
        now: float,
        say: Callable[[str], None],
        standing: Callable[[], Sequence[str]],
    ) -> None:
        self._scribe, self._journal, self.lines = scribe, journal, lines
        self._say, self._standing = say, standing
        cycle = next(self._kept(["cycle"], Cycle), Cycle())
        self._cycle = OperationCycle(cycle, boot, now)
        faults = [*self._kept([name for name in journal.kept if name.startswith("fault/")], Fault)]
        remembered = next(self._kept(["memory"], Remembered), None)
        self.memory = FaultMemory(rules, faults, remembered, cycle.number)
        self.observed = {each.name: each for each in _observed(lines, frame_s)}
        for each in self.observed.values():
            self.memory.watch(each.system)

    @property
    def cycle(self) -> int:
        """The number of the operation cycle."""
        return self._cycle.cycle.number

    def take(self, watched: Watched, events: Iterable[Event]) -> None:
        """Takes the ticks of a bundle since the last time, and what was told in them."""
        here = next(each for each in self.observed.values() if each.watched is watched)
        if here.bundle is not watched.bundle:
            here.begin()
            self.memory.watch(here.system)
        samples = iter(watched.taken())
        for event in events:
            for sample in samples:
                self._see(here, sample)
                if sample.tick >= event.tick:
                    break
            self._hear(here, self._scribe.event(event))
        for sample in samples:
            self._see(here, sample)

    def look(self, now: float) -> None:
        """Operation cycles, and freeze frames whose excerpt is whole; `now` is the monotonic time [s]."""
        self._follow(self._cycle.look(sum(line.bus.counts.frames for line in self.lines), now))
        for here in self.observed.values():
            for name, frame in [*here.unfinished.items()]:
                if (done := here.recorder.completed(frame)) is not None:
                    del here.unfinished[name]
                    if name in self._journal.kept:  # else it was erased meanwhile
                        self._journal.remember({name: msgspec.json.encode(done)})

    def slept(self) -> None:
        """The machine slept: the key was off."""
        self._follow(self._cycle.end())

    def clear(self, number: int | None, by: str) -> Cleared:
        """Erases one, or all, because a person wants it; `by` says who. The record of that, which is not kept yet."""
        names = {fault: self._names(fault) for fault in self.memory.faults}
        numbers = self.memory.clear(number)
        named, seq, wall = self._scribe.next()
        cleared = Cleared(schema=CLEARED, id=named, seq=seq, wall=wall, numbers=numbers, by=by)
        gone: dict[str, bytes | None] = dict.fromkeys(chain.from_iterable(names[each] for each in numbers))
        gone["memory"] = msgspec.json.encode(self.memory.remembered)  # the overflow flag
        self._put([Record(seq, "fault", encode_record(cleared))], gone)
        return cleared

    def frames(self, number: int) -> dict[str, msgspec.Raw]:
        """The freeze frames of a fault: `first`, and `latest` where it occurred again."""
        found = ((name.rpartition("/")[2], self._journal.kept.get(name)) for name in self._names(number)[1:])
        return {which: msgspec.Raw(text) for which, text in found if text is not None}

    def _see(self, here: Observed, sample: Sample) -> None:
        here.recorder.add(sample)
        news = self.memory.tick(here.name, sample.mode, sample.usable, sample.suspicious)
        if news:
            event = self.memory.told(here.name)
            self._tell([], news, self._framed(here, news, event) if event is not None else {})

    def _hear(self, here: Observed, event: Event) -> None:
        sample = here.recorder.latest
        news = self.memory.event(here.name, event, sample.showing if sample else [])
        self._tell([Record(event.seq, "event", encode(event))], news, self._framed(here, news, event))

    def _framed(self, here: Observed, news: Iterable[News], event: Event) -> dict[str, bytes]:
        """The freeze frames of what has failed, by their names in the store."""
        frames: dict[str, bytes] = {}
        for each in news:
            if each.change in FRAMED and here.recorder.latest is not None:
                first, latest = self._names(each.fault.number)[1:]
                name = latest if first in self._journal.kept else first
                frame = here.recorder.frame(event, self._standing(), here.counters)
                here.unfinished[name], frames[name] = frame, msgspec.json.encode(frame)
        return frames

    def _follow(self, steps: Iterable[str]) -> None:
        for step in steps:
            news = self.memory.begin_cycle(self.cycle) if step == "begun" else self.memory.end_cycle()
            self._tell([], news, {"cycle": msgspec.json.encode(self._cycle.cycle)})

    def _tell(self, records: list[Record], news: Sequence[News], kept: dict[str, bytes] | None = None) -> None:
        """Puts the records, those of what has become of faults, and what is kept of it: all of it or nothing."""
        rows: dict[str, bytes | None] = {}
        for change, fault in news:
            if change is not None:
                named, seq, wall = self._scribe.next()
                record = FaultRecord(schema=SCHEMA, id=named, seq=seq, wall=wall, change=change, fault=fault)
                records.append(Record(seq, "fault", encode_record(record)))
            if fault.number not in self.memory.faults:
                rows.update(dict.fromkeys(self._names(fault.number)))
            elif change == "withdrawn":  # the latest frame is of what it was not
                latest = self._names(fault.number)[2]
                rows[latest] = None
                for here in self.observed.values():
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
        """Under which a fault and its freeze frames are kept."""
        return [f"fault/{number}", f"frame/{number}/first", f"frame/{number}/latest"]

    def _kept(self, names: Iterable[str], kind: type[T]) -> Iterator[T]:
        for name in names:
            text = self._journal.kept.get(name)
            if text is None:
                continue
            try:
                yield msgspec.json.decode(text, type=kind)
            except (msgspec.MsgspecError, ValueError) as error:
                self._say(f"the store's {name} cannot be read ({error}); it is kept as unreadable/{name}")
                self._journal.remember({name: None, f"unreadable/{name}": text})


def _observed(lines: Sequence[Line], seconds: float) -> Iterator[Observed]:
    """What is watched, by names that differ: the bundle's, with the bus's where two have the same, or a number too."""
    all_names = [watched.bundle.manifest.name for line in lines for watched in line.bundles]
    given = Counter[str]()
    for line in lines:
        for watched in line.bundles:
            name = watched.bundle.manifest.name
            name = name if all_names.count(name) == 1 else f"{name}@{line.name}"
            given[name] += 1
            yield Observed(name if given[name] == 1 else f"{name}-{given[name]}", line, watched, seconds)

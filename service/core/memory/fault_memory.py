"""The fault memory: what failed, is there or was, and for how long that is remembered.

It takes what is told of a system (`core.records.event`), looks at every tick, and the operation cycles; it gives what
changed. One episode of a system is one entry, however many candidates it has: fewer later refine it. A new episode is
one of an entry whose candidates it shares, and else a new one.

Source: AUTOSAR SWS Diagnostics R22-11: status bits, trips to confirm (SWS_DM_00218), warning and healing (00224,
01266), aging after it (00238, 01264), displacement and overflow (00922, 00923, 00928), clearing (00086).
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import msgspec
from msgspec import structs

from faultline.service.core.memory.entries import Episode, fresh, in_new_cycle, with_told
from faultline.service.core.memory.rules import Rules
from faultline.service.core.memory.system import System
from faultline.service.core.records.event import Event, candidates
from faultline.service.core.records.fault import Change, Fault, Number, names
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.signals.values import Mask
from faultline.service.core.time_scale import Span

LOOK = Span(periods=25)
"""Between two looks at faults of earlier runs."""


class FaultChange(NamedTuple):
    """Change of a fault. `change` None: to be stored, without a record."""

    change: Change | None
    fault: Fault


class Remembered(msgspec.Struct, frozen=True, kw_only=True):
    """State that outlives a run besides the faults: whether one was ever displaced, and the next number."""

    overflow: bool = False
    number: Number = 1


class FaultMemory:
    """The faults of all systems of one vehicle. State: `faults` by number, the open episodes, the cycle."""

    def __init__(
        self, rules: Rules, faults: Iterable[Fault] = (), remembered: Remembered | None = None, cycle: int = 0
    ) -> None:
        """`faults` and `remembered` are those of earlier runs, `cycle` the number of the operation cycle."""
        self._rules, self.cycle = rules, cycle
        self.faults = {fault.number: fault for fault in sorted(faults, key=lambda each: each.number)}
        self.remembered = remembered or Remembered()
        after = max(self.faults, default=0) + 1  # no number is used twice, whatever was lost
        if self.remembered.number < after:
            self.remembered = structs.replace(self.remembered, number=after)
        self._episodes: dict[str, Episode] = {}

    def watch(self, system: System) -> None:
        """This system is watched from now on, or with another bundle."""
        episode = self._episodes.get(system.name)
        if episode is None or episode.system.tests != system.tests:
            self._episodes[system.name] = Episode(system, self._rules)
        else:
            episode.system = system

    def event(self, name: str, event: Event, modes: Sequence[str]) -> list[FaultChange]:
        """Take an event of the system `name`; `modes` are those that show it now."""
        episode = self._episodes[name]
        if event.transition in ("occurred", "refined"):
            episode.told, episode.modes = event, [*modes]
            if episode.number is not None and event.transition == "refined":
                return [*self._refine(episode)]
            return self._occur(episode)
        if event.transition == "healed":
            return self._seen(episode, is_there=False)
        if event.transition == "withdrawn":
            return [*self._withdraw(episode)]
        if event.transition == "started":  # it has forgotten what it told
            episode.told = episode.number = episode.before = None
            episode.debounce.counter = 0
        return []

    def tick(self, name: str, mode: int, usable: Mask, suspicious: bool) -> list[FaultChange]:
        """Takes a look at the system: the mode, which generators (T,) can tell, whether anything is suspected."""
        episode = self._episodes[name]
        if suspicious:
            episode.quiet[:] = 0
        elif episode.told is None:
            episode.quiet[mode] += usable
        episode.ticks += 1
        news = self._count(episode, usable, suspicious)
        if episode.ticks % episode.system.time.ticks(LOOK) == 0 and not suspicious:
            news += self._look(episode)
        return news

    def begin_cycle(self, cycle: int) -> list[FaultChange]:
        """An operation cycle begins: nothing has failed or passed in it yet."""
        self.cycle = cycle
        for episode in self._episodes.values():
            episode.debounce.counter = 0
            episode.quiet[:] = 0
            if episode.before is not None:
                episode.before = in_new_cycle(episode.before)
        return [self._put(in_new_cycle(fault), None) for fault in [*self.faults.values()]]

    def end_cycle(self) -> list[FaultChange]:
        """End an operation cycle: what could have failed in it and did not heals, then ages."""
        return [
            self._settle(fault)
            for fault in [*self.faults.values()]
            if not (fault.status.test_failed_this_cycle or fault.status.not_completed_this_cycle)
        ]

    def clear(self, number: int | None) -> list[int]:
        """Erase one, or all; return their numbers. A present fault fails anew, under a number of its own."""
        erased = [*self.faults] if number is None else [number] if number in self.faults else []
        for each in erased:
            self._erase(each)
        if number is None:
            self.remembered = structs.replace(self.remembered, overflow=False)
        return erased

    def told(self, name: str) -> Event | None:
        """Return the event of the system's present diagnosis; None if there is none."""
        return self._episodes[name].told

    def _count(self, episode: Episode, usable: Mask, suspicious: bool) -> list[FaultChange]:
        """Count one more observation of a fault that is present, or healed, and does not count as that yet."""
        told, counter = episode.told, episode.debounce
        if told is None:
            if episode.number is not None:
                return self._seen(episode, is_there=False)
        elif suspicious and (episode.number is None or counter.fdc < 127):
            rows = [k for k, test in enumerate(episode.system.tests) if test in told.alarm]
            if usable[rows or slice(None)].any():
                return self._seen(episode, is_there=True)
            counter.disable(self._rules.disabled)
        return []

    def _seen(self, episode: Episode, *, is_there: bool) -> list[FaultChange]:
        found = episode.debounce.seen(is_there)
        if not is_there:
            episode.told = None
        if found == "failed" and not self._has_failed(episode):
            return [*self._fail(episode)]
        if found == "passed" and episode.number is not None:
            number, episode.number, episode.before = episode.number, None, None
            return [self._pass(self.faults[number])]
        return []

    def _occur(self, episode: Episode) -> list[FaultChange]:
        """Handle a new diagnosis while the previous may not count as passed yet: it is that again, or another."""
        assert episode.told is not None
        if episode.number is None:
            return self._seen(episode, is_there=True)
        before = self.faults[episode.number]
        if names(before.diagnoses) & names(episode.told.diagnoses):
            return self._seen(episode, is_there=True) or [*self._refine(episode)]
        episode.number = episode.before = None
        episode.debounce.counter = 0
        return [self._pass(before), *self._seen(episode, is_there=True)]

    def _has_failed(self, episode: Episode) -> bool:
        """Return True if the diagnosis counts as failed in this cycle."""
        return episode.number is not None and self.faults[episode.number].status.test_failed_this_cycle

    def _fail(self, episode: Episode) -> Iterator[FaultChange]:
        """Count the diagnosis as failed in this cycle: as the same entry, an earlier one again, or a new one."""
        assert episode.told is not None
        episode.quiet[:] = 0
        if episode.number is None:
            episode.before = self._entry_of(episode)
        entry = episode.before if episode.number is None else self.faults[episode.number]
        if entry is None:
            yield from self._make_room()
            entry = fresh(self.remembered.number, episode, self.cycle)
            self.remembered = structs.replace(self.remembered, number=entry.number + 1)
            episode.number, status = entry.number, entry.status
            again = False
        else:
            episode.number, status = entry.number, entry.status
            again = not status.test_failed
        trips = entry.trips + (not status.test_failed_this_cycle)
        confirmed = status.confirmed or trips >= self._rules.confirm_trips
        change: Change | None = "failed"
        if confirmed != status.confirmed:
            change = "confirmed"
        elif not confirmed:
            change = "pending"
        if status.test_failed:  # the service was started again meanwhile, or a cycle began
            change = "confirmed" if confirmed != status.confirmed else None
            if candidates(entry.diagnoses) != candidates(episode.told.diagnoses):
                change = change or "refined"
        entry = structs.replace(
            with_told(entry, episode, self.cycle),
            occurrences=entry.occurrences + again,
            trips=trips,
            healing=0,
            aging=0,
            fdc=episode.debounce.fdc,
        )
        yield self._put(
            entry,
            change,
            test_failed=True,
            test_failed_this_cycle=True,
            pending=True,
            confirmed=confirmed,
            not_completed_this_cycle=False,
            warning=confirmed,
        )

    def _refine(self, episode: Episode) -> Iterator[FaultChange]:
        """Other candidates: where they share none with what the entry was before, it was not that again.

        And a new entry all of whose candidates are a remembered one's now is that one again, and was no new one.
        """
        assert episode.told is not None
        assert episode.number is not None
        before = episode.before
        other = self._entry_of(episode)
        if before is None and other is not None and names(episode.told.diagnoses) <= names(other.diagnoses):
            own, counter = self.faults[episode.number], episode.debounce.counter
            self._erase(own.number)
            episode.debounce.counter = counter
            yield FaultChange("revoked", own)
            yield from self._fail(episode)
            return
        if before is None or names(before.diagnoses) & names(episode.told.diagnoses):
            entry = self.faults[episode.number]
            is_news = entry.diagnoses != episode.told.diagnoses  # also how large it is
            yield self._put(with_told(entry, episode, self.cycle), "refined" if is_news else None)
            return
        self.faults[before.number] = before
        yield FaultChange("withdrawn", before)
        episode.number = None
        yield from self._fail(episode)

    def _withdraw(self, episode: Episode) -> Iterator[FaultChange]:
        """Withdraw a diagnosis that rests on doubted samples: the entry is as it was before, or there is none."""
        number, before = episode.number, episode.before
        episode.told = episode.number = episode.before = None
        episode.debounce.counter = 0
        if before is not None:
            self.faults[before.number] = before
            yield FaultChange("withdrawn", before)
        elif number is not None:
            fault = self.faults[number]
            self._erase(number)
            yield FaultChange("revoked", fault)

    def _pass(self, fault: Fault) -> FaultChange:
        return self._put(structs.replace(fault, fdc=-128), "passed", test_failed=False, not_completed_this_cycle=False)

    def _look(self, episode: Episode) -> list[FaultChange]:
        """Pass faults of earlier runs or cycles that were quiet since where they could be seen."""
        least = self._rules.quiet_s / episode.system.time.period_s
        news = []
        for fault in [*self.faults.values()]:
            if fault.system != episode.system.name or fault.number == episode.number:
                continue
            if not fault.status.not_completed_this_cycle and not fault.status.test_failed:
                continue
            rows = [k for k, test in enumerate(episode.system.tests) if test in fault.tests]
            seen = episode.quiet[:, rows or slice(None)].min(axis=1)
            modes = [k for k, mode in enumerate(episode.system.modes) if mode in fault.modes]  # none: of another bundle
            if (seen[modes] if modes else seen[EDGE + 1 :].sum(keepdims=True)).min() >= least:
                was_failed = fault.status.test_failed
                news.append(self._pass(fault) if was_failed else self._put(fault, None, not_completed_this_cycle=False))
        return news

    def _settle(self, fault: Fault) -> FaultChange:
        """A cycle in which it could have failed and did not."""
        status = fault.status
        warned = status.warning and fault.healing + 1 < self._rules.heal_cycles
        if status.warning:
            fault = structs.replace(fault, trips=0, healing=fault.healing + 1)
        else:
            fault = structs.replace(fault, trips=0, aging=fault.aging + 1)
        if fault.aging >= self._rules.age_cycles:
            self._erase(fault.number)
            return FaultChange("aged", fault)
        changed = status.pending or status.warning != warned
        return self._put(fault, "settled" if changed else None, pending=False, warning=warned)

    def _entry_of(self, episode: Episode) -> Fault | None:
        """The entry, other than its own, whose candidates it shares: one that is failed, else the one seen last."""
        assert episode.told is not None
        here = names(episode.told.diagnoses)
        alike = [
            fault
            for fault in self.faults.values()
            if fault.system == episode.system.name and fault.number != episode.number and names(fault.diagnoses) & here
        ]
        return max(alike, key=lambda each: (each.status.test_failed, each.latest.cycle, each.number), default=None)

    def _make_room(self) -> Iterator[FaultChange]:
        """Displaces what matters least where all places are taken: passed before failed, pending before confirmed."""
        if len(self.faults) < self._rules.entries:
            return
        bound = {episode.number for episode in self._episodes.values()}
        least = min(
            (fault for fault in self.faults.values() if fault.number not in bound),
            key=lambda each: (each.status.test_failed, each.status.confirmed, each.latest.cycle, each.number),
            default=None,
        )
        if least is not None:
            self._erase(least.number)
            self.remembered = structs.replace(self.remembered, overflow=True)
            yield FaultChange("displaced", least)

    def _erase(self, number: int) -> None:
        del self.faults[number]
        for episode in self._episodes.values():
            if episode.number == number:
                episode.number = episode.before = None
                episode.debounce.counter = 0

    def _put(self, fault: Fault, change: Change | None, **bits: bool) -> FaultChange:
        status = structs.replace(fault.status, **bits)
        fault = structs.replace(fault, status=status, mask=status.mask)
        self.faults[fault.number] = fault
        return FaultChange(change, fault)

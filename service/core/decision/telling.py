"""When to say what: the state of the decision becomes events."""

from typing import Generic, NamedTuple, Protocol, TypeVar

from faultline.service.core.records.event import SCHEMA, Diagnosis, Event, Transition, candidates
from faultline.service.core.time_scale import Span, TimeScale

SETTLE = Span(periods=10)
"""A change is told once it has lasted this long: tests that fire within it tell their news together."""

State = TypeVar("State")


class Decided(Protocol):
    """What is told of a decision (`core.decision.decision.Decision`)."""

    @property
    def diagnoses(self) -> list[Diagnosis]:
        """What explains a confirmed fault, best first."""

    @property
    def named(self) -> list[Diagnosis]:
        """Return the same; sizes, which take their time, may be missing."""

    @property
    def alarm(self) -> list[str]:
        """Tests that alarm and can tell now."""

    @property
    def cannot_tell(self) -> list[str]:
        """Tests that cannot tell now."""

    @property
    def suspected(self) -> bool:
        """Whether something is suspected and nothing is confirmed."""

    @property
    def intermittent(self) -> bool:
        """Whether what is confirmed comes and goes."""

    @property
    def settled(self) -> bool:
        """Whether what is confirmed rests on how far residuals deviate in each mode."""

    @property
    def since(self) -> int | None:
        """The tick at which the evidence began."""

    @property
    def withdrawn(self) -> bool:
        """True if the last confirmed fault rested on samples that came to be doubted."""


class Told(NamedTuple):
    """What subscribers know: whether something is suspected, and what explains a confirmed fault."""

    suspected: bool
    candidates: list[tuple[tuple[str, ...], int, tuple[str, ...]]]
    settled: bool = False


class Settled(Generic[State]):
    """A value that changes only when the new one has stayed the same for so many further `ticks`."""

    def __init__(self, value: State, ticks: int) -> None:
        self.value = value
        self._ticks = ticks
        self._seen = value
        self._lasted = 0

    @property
    def waits(self) -> bool:
        """Return True if the new one has not lasted long enough, so that how many ticks there are matters."""
        return self._seen != self.value

    def update(self, seen: State) -> bool:
        """Takes what is seen at a tick; whether the value changed."""
        self._lasted = self._lasted + 1 if seen == self._seen else 0
        self._seen = seen
        if self._lasted < self._ticks or seen == self.value:
            return False
        self.value = seen
        return True


class Teller:
    """Makes the events of one source, numbered from 1. State: what has been told and what is about to be."""

    def __init__(self, source: str, bundle_id: str, time: TimeScale) -> None:
        self._source = source
        self.bundle = bundle_id
        self._period, self._settle = time.period_s, time.ticks(SETTLE)
        self._seq = 0
        self._told: Settled[Told] = Settled(Told(False, []), self._settle)
        self._diagnoses: list[Diagnosis] = []
        self._blind: Settled[list[str]] | None = None

    @property
    def waits(self) -> bool:
        """Return True if each tick matters now; if not, several are as the last of them."""
        return self._blind is None or self._told.waits or self._blind.waits

    def update(self, tick: int, decision: Decided) -> list[Event]:
        """The events of this tick, at most one for what is wrong and one for the tests that cannot tell."""
        if self._blind is None:
            self._blind = Settled(decision.cannot_tell, self._settle)
            return [self._event(tick, "started", decision)]
        events = []
        before = self._told.value
        if self._told.update(Told(decision.suspected, candidates(decision.named), decision.settled)):
            self._diagnoses = decision.diagnoses
            events.append(self._event(tick, _transition(before, self._told.value, decision.withdrawn), decision))
            if before.candidates and not self._told.value.candidates:
                self._told.value = Told(False, [])  # what is suspected besides is news of its own
        if self._blind.update(decision.cannot_tell):
            events.append(self._event(tick, "cannot_tell", decision))
        return events

    def _event(self, tick: int, transition: Transition, decision: Decided) -> Event:
        self._seq += 1
        return Event(
            schema=SCHEMA,
            id=f"{self._source}-{self._seq}",
            seq=self._seq,
            tick=tick,
            t_s=round(tick * self._period, 3),
            wall=None,
            transition=transition,
            diagnoses=self._diagnoses,
            alarm=decision.alarm,
            cannot_tell=decision.cannot_tell,
            since_tick=decision.since,
            bundle=self.bundle,
            suspected=decision.suspected,
            intermittent=decision.intermittent,
            settled=decision.settled,
        )


def _transition(before: Told, after: Told, withdrawn: bool) -> Transition:
    if after.candidates:
        return "refined" if before.candidates else "occurred"
    if before.candidates:
        return "withdrawn" if withdrawn else "healed"
    return "suspected" if after.suspected else "dismissed"

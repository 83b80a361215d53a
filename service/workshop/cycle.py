"""Observation of the active test cycle: live ticks in; progress, coverage and diagnoses out. Pure.

Time is log time, ticks times their period, so that a replay at any speed counts as a drive does; only silence is timed
by who listens.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

from faultline.service.core.records.discrimination import Separation
from faultline.service.core.records.event import Diagnosis, candidates
from faultline.service.core.time_scale import Span
from faultline.service.protocol.live import LiveTick, SystemDescription
from faultline.service.workshop.plan import QUIET, STOOD, Step
from faultline.service.workshop.progress import NEAR, Progress
from faultline.service.workshop.trace import Trace

LONGEST_GAP = Span(settlings=0.1, seconds=2)
"""Ticks that a slow reader was not sent count as those around them: an edge would have been longer."""

End = Literal["complete", "patience", "interrupted", "service-ended", "begun-anew"]
"""complete: every step is done, and what is told has settled. patience: nothing came further for too long.
interrupted: a person broke it off. service-ended: nothing comes any more. begun-anew: other tests than at the begin."""


class Episode(NamedTuple):
    """A confirmed fault as the cycle saw it, in log time [s]; `until_s` is None while it is there.

    `stood_before`: it was confirmed at the first tick. `begun_anew`: the service began anew, nobody saw it go.
    `diagnoses` and `separating` are as they were last.
    """

    since_s: float
    until_s: float | None
    stood_before: bool
    diagnoses: list[Diagnosis]
    separating: list[Separation]
    begun_anew: bool = False


class Cycle:
    """Follows one test of `system`. ServiceState: progress, coverage, episodes, and since when what is so has been so.

    `seconds[test][mode]` [s] is how long a test could tell in a mode; `worst[test]` the largest sum of its detectors in
    parts of the threshold, with its sign.
    """

    def __init__(self, system: SystemDescription, steps: Sequence[Step], patience_s: float) -> None:
        self.system, self.patience_s = system, patience_s
        self.modes = system.steady
        self.quiet_s, self._stand_s, self._gap_s = map(system.time.seconds, (QUIET, STOOD, LONGEST_GAP))
        self._steps = tuple(steps)
        self.episodes: list[Episode] = []
        self.suspicions = 0
        self.latest: LiveTick | None = None
        self.silent_s = 0.0
        self.waited_s = 0.0  # without progress
        self.trace = Trace()
        self._elapsed = 0.0
        self.restarts = 0
        self._begin()

    def _begin(self) -> None:
        self.progress = Progress(self._steps)
        self.seconds = {test: dict.fromkeys(self.modes, 0.0) for test in self.system.tests}
        self.worst: dict[str, float] = dict.fromkeys(self.system.tests, 0.0)
        self.alarmed: set[str] = set()
        self._quiet_s = 0.0
        self._stood_s = 0.0

    def take(self, tick: LiveTick) -> None:
        """Take a live tick. One that is older than the last is of a service that began anew: so does the cycle."""
        before, self.silent_s = self.latest, 0.0
        if before is not None and tick.tick == before.tick:
            return
        if before is not None and tick.tick < before.tick:
            self._begin()
            self.restarts += 1
            if self.episodes and self.episodes[-1].until_s is None:  # nobody saw it go
                self.episodes[-1] = self.episodes[-1]._replace(until_s=self._elapsed, begun_anew=True)
            before = None
        period = self.system.period_s
        gap = period if before is None else (tick.tick - before.tick) * period
        span = gap if gap <= self._gap_s + NEAR and before is not None and before.mode == tick.mode else period
        self._elapsed += gap
        self._note(tick, first=self.latest is None)
        self._settle(tick, before, gap)
        self._cover(tick, span)
        self.waited_s = (
            0.0 if self.progress.add(tick.mode, span if self._counts(tick) else 0.0) else self.waited_s + gap
        )
        self.trace.add(self._elapsed, tick)
        self.latest = tick

    def silent(self, seconds: float) -> None:
        """Note that nothing came for so long [s]."""
        self.silent_s += seconds
        self.waited_s += seconds

    @property
    def elapsed_s(self) -> float:
        """Return the log time since the first tick."""
        return self._elapsed

    @property
    def suspected(self) -> bool:
        """Return True if a test alarms or the baseline deviates now, confirmed or not."""
        return self.latest is not None and (self.latest.anomaly or bool(self.latest.alarm))

    @property
    def settled(self) -> bool:
        """Return True if the diagnosis has been stable for long enough to end with."""
        if self.latest is not None and self.latest.diagnoses:
            return self._stood_s >= self._stand_s - NEAR
        return self._quiet_s >= self.quiet_s - NEAR

    @property
    def ended(self) -> End | None:
        """Return why it is over, None while it is not."""
        if self.progress.complete and self.settled and self.silent_s == 0.0:
            return "complete"
        return "patience" if self.waited_s >= self.patience_s else None

    def _counts(self, tick: LiveTick) -> bool:
        """Return True if the tick counts: all tests can tell, or any while a confirmed fault may blind some."""
        return any(tick.usable) if tick.diagnoses else all(tick.usable)

    def _cover(self, tick: LiveTick, span: float) -> None:
        telling = {row.test for row, usable in zip(self.system.generators, tick.usable, strict=True) if usable}
        for test in telling - {*tick.cannot_tell} if tick.mode in self.modes else ():
            self.seconds[test][tick.mode] += span
        for row, value, usable in zip(self.system.generators, tick.sums, tick.usable, strict=True):
            if usable and value is not None and abs(value) > abs(self.worst[row.test]):
                self.worst[row.test] = value
        self.alarmed |= {*tick.alarm}

    def _note(self, tick: LiveTick, *, first: bool) -> None:
        """Record confirmed faults as they come and go."""
        open_now = bool(self.episodes) and self.episodes[-1].until_s is None
        if tick.diagnoses:
            since, before = self._elapsed, first
            if open_now:
                last = self.episodes.pop()
                since, before = last.since_s, last.stood_before
            self.episodes.append(Episode(since, None, before, tick.diagnoses, tick.separating))
        elif open_now:
            self.episodes[-1] = self.episodes[-1]._replace(until_s=self._elapsed)

    def _settle(self, tick: LiveTick, before: LiveTick | None, gap: float) -> None:
        is_suspected = tick.anomaly or bool(tick.alarm)
        was_suspected = before is not None and (before.anomaly or bool(before.alarm))
        self.suspicions += is_suspected and not was_suspected
        self._quiet_s = 0.0 if is_suspected or tick.diagnoses else self._quiet_s + gap
        same = before is not None and candidates(before.diagnoses) == candidates(tick.diagnoses)
        self._stood_s = self._stood_s + gap if same and tick.diagnoses else 0.0

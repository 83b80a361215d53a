"""The decision of a tick, in two stages: detectors suspect, a fresh window confirms; conflicts, ranked diagnoses.

A detector that alarms opens a window. What is seen from then on confirms a fault once some hypothesis fits it better
than no fault does, by more than chance makes; until then nothing is named. Names are hitting sets of the conflicts: of
the tests that alarm, and of those that the window shows to deviate. Networks raise suspicion and are no conflicts: they
may alarm where a fault that their test decouples brings operation that was rare in training.

Hypotheses say where residuals end; how they get there lasts as long as the tests' warm-up. So the window is cleared
once after that time, and until then candidates are not ranked.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from service.core.detectors.bank import DetectorBank
from service.core.events import Diagnosis
from service.core.generators import Residuals
from service.core.hypotheses import Hypotheses, Weighed, Window
from service.core.isolation import diagnoses
from service.core.manifest import Manifest
from service.core.signals import Vector

RANKING_PERIOD = 15
"""The window is looked at at every tick that this divides: the same ticks whatever the episode's first.

Less often than it takes for a change to be told (`service.core.telling.SETTLE_TICKS`): what alternates is told too. A
bus delivers the same recording with a little jitter each time; misfits compared at every tick would cross at another
one each time.
"""

SURE = 100.0
"""A misfit of no fault from which something is wrong even if no hypothesis points there."""

CONFIRMED = 30.0
"""How much better than no fault a hypothesis must fit. Fault-free windows of eight vehicles had up to 26."""

TIE = 9.0
TIE_PART = 0.25
"""Hypotheses whose misfits differ by less than three standard deviations, or than this part of the larger one, are not
told apart: the data do not separate them, or neither explains the data."""

DEVIATING = 5.0
"""Standard deviations from which a mean of the window is a conflict."""

LINGER_TICKS = 300
"""A confirmed episode is over once no test has alarmed for 60 s: a fault near a threshold is one fault, not many."""


class Decision:
    """Detectors and isolation: residuals in; alarmed tests, tests that cannot tell and ranked diagnoses out."""

    def __init__(self, manifest: Manifest) -> None:
        self._tests = [generator.test for generator in manifest.generators]
        self._sensitive = [frozenset(generator.faults) for generator in manifest.generators]
        names = [generator.name for generator in manifest.generators]
        self._detectors = DetectorBank(manifest.detectors, names)
        of_equations = {g.graph for g in manifest.generators if g.name in manifest.evidence.generators}
        self._trusted = frozenset(row for row, g in enumerate(manifest.generators) if g.graph in of_equations)
        self._settle_ticks = max(g.warm_up_ticks for g in manifest.generators if g.name in manifest.evidence.generators)
        self._looked_at = [names.index(name) for name in manifest.evidence.generators]
        self._hypotheses = Hypotheses(manifest.evidence)
        self._window = Window(manifest.evidence, names)
        self._latest: int | None = None  # tick at which a test alarmed last, in this episode
        self._alarming = 0  # ticks of the episode at which one did
        self._alarmed: frozenset[int] = frozenset()  # those that did, the last time that any did
        self._deviating: frozenset[int] = frozenset()  # tests that deviate in the window
        self._weighed: Weighed | None = None
        self._settled = False
        self.confirmed = False
        self._usable = np.zeros(len(self._tests), dtype=np.bool_)

    def update(self, tick: int, mode: int, residuals: Residuals) -> None:
        """Takes the residuals of a tick. The detector of a test that cannot tell is frozen, its alarm stands."""
        self._usable = residuals.usable
        self._detectors.update(tick, mode, residuals)
        if not self._detectors.suspicious:  # the window waits
            self._window.leave()
            if self._latest is not None and tick - self._latest >= LINGER_TICKS * self.confirmed:
                self._latest, self._alarming, self.confirmed = None, 0, False
            return
        if self._latest is None:
            self._weighed, self._deviating, self._settled = None, frozenset(), False
            self._alarmed = frozenset()
            self._window.clear()
        self._latest, self._alarmed = tick, self._detectors.alarmed or self._alarmed
        if self._alarming == self._settle_ticks:
            self._window.clear()
        self._alarming += 1
        self._window.add(mode, residuals.r, residuals.usable)
        if tick % RANKING_PERIOD == 0:
            self._weigh(settled=self._alarming > self._settle_ticks)

    def _weigh(self, settled: bool) -> None:
        """Looks at the window; what the one before it said stands until it has seen enough."""
        weighed = self._hypotheses.weigh(self._window.means)
        if weighed is None:
            return
        self._weighed, self._settled = weighed, settled
        deviating = self._hypotheses.deviating(self._window.means, DEVIATING)
        self._deviating = frozenset(row for row, beyond in zip(self._looked_at, deviating, strict=True) if beyond)
        self.confirmed = self.confirmed or weighed.gain > CONFIRMED or weighed.nothing > SURE

    @property
    def sums(self) -> Vector:
        """Each generator's largest level detector in parts of its threshold, with the residual's sign (T,)."""
        return self._detectors.sums

    @property
    def alarm(self) -> list[str]:
        """Tests that alarm and can tell now: one of their generators does."""
        alarmed = self._detectors.alarmed
        return list(dict.fromkeys(test for row, test in enumerate(self._tests) if row in alarmed and self._usable[row]))

    @property
    def cannot_tell(self) -> list[str]:
        """Tests that cannot tell now: none of their generators can, or one that alarms cannot and no other alarms."""
        telling = {test for test, usable in zip(self._tests, self._usable, strict=True) if usable}
        frozen = {self._tests[row] for row in self._detectors.alarmed if not self._usable[row]} - {*self.alarm}
        return [test for test in dict.fromkeys(self._tests) if test not in telling or test in frozen]

    @property
    def since(self) -> int | None:
        """The tick at which the evidence of the alarmed tests began."""
        return self._detectors.since

    @property
    def diagnoses(self) -> list[Diagnosis]:
        """What explains a confirmed fault, best first. An alarm whose test has become unable to tell still counts."""
        if not self.confirmed or self._weighed is None:
            return []
        trusted = sorted((self._alarmed & self._trusted) | self._deviating)
        conflicts = [self._sensitive[row] for row in trusted] or [frozenset(self._hypotheses.faults)]
        return [
            Diagnosis(faults=list(faults), rank=rank, p=None)
            for faults, rank in ranked(diagnoses(conflicts), self._weighed.faults if self._settled else {})
        ]


def ranked(candidates: Sequence[tuple[str, ...]], misfits: Mapping[str, float]) -> list[tuple[tuple[str, ...], int]]:
    """Candidates with their ranks, best first; all are equal where one is not a single known fault.

    >>> ranked([("fA",), ("fB",), ("fC",)], {"fA": 30.0, "fB": 2.0, "fC": 8.0})
    [(('fB',), 1), (('fC',), 1), (('fA',), 3)]
    >>> ranked([("fA", "fB"), ("fA", "fC")], {"fA": 30.0, "fB": 2.0, "fC": 80.0})
    [(('fA', 'fB'), 1), (('fA', 'fC'), 1)]
    """
    if not all(len(candidate) == 1 and candidate[0] in misfits for candidate in candidates):
        return [(candidate, 1) for candidate in candidates]
    q = {candidate: misfits[candidate[0]] for candidate in candidates}
    behind = {candidate: value - max(TIE, TIE_PART * value) for candidate, value in q.items()}
    rank = {candidate: 1 + sum(other < behind[candidate] for other in q.values()) for candidate in candidates}
    return sorted(rank.items(), key=lambda item: (item[1], item[0]))

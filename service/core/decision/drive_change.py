"""The change detection of one drive: suspicion, the baseline before the change, and whether it is still there.

While nothing is suspected, the filter follows the baseline. A change is suspected where a ratio exceeds a threshold
(`nats`), and sure where it exceeds a higher one. From then on the baseline is that before the onset, and is held: a
filter that went on would take the fault for the baseline's in time. Evidence that could not tell for long begins anew.
"""

from collections.abc import Sequence
from math import inf

import numpy as np

from faultline.service.core.decision.baseline import BaselineModel, GaussianState
from faultline.service.core.decision.baseline_level import BaselineLevel
from faultline.service.core.decision.blocks import BLOCK, BlockMeans
from faultline.service.core.decision.change_detector import ChangeDetector
from faultline.service.core.decision.hypotheses import Hypotheses
from faultline.service.core.decision.straying import Level, Means
from faultline.service.core.decision.window import Recent
from faultline.service.core.detectors.bank import FROZEN
from faultline.service.core.manifest import Evidence
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.values import FloatArray
from faultline.service.core.time_scale import TimeScale

SURE_H = 5000.0
"""The average run length of the higher threshold [h]: ten times what one false diagnosis in 500 h would need, as the
model of a fault-free drive is not exact."""

SAME = 5.0
"""A fault is there as long as it fits what was seen of late by so much [nats] better than none does, or its ratio has
not fallen by more from its peak."""


class DriveChange:
    """The detector, the baseline's level and what was seen of late, of one drive."""

    def __init__(
        self,
        evidence: Evidence,
        generators: Sequence[str],
        hypotheses: Hypotheses,
        time: TimeScale,
        detector: type[ChangeDetector] = ChangeDetector,
    ) -> None:
        self._frozen = time.ticks(FROZEN)
        self._rows = [generators.index(name) for name in evidence.generators]
        self._hypotheses, self._count = hypotheses, evidence.simple
        self._model, self._period_s = BaselineModel(evidence, time), time.period_s
        self._baseline = BaselineLevel(evidence, generators, self._model)
        self._blocks = BlockMeans(evidence, generators, time)
        self._recent = Recent(evidence, generators, time)
        self._of_changes = detector
        self._detector = self._fresh()
        self._blind = 0  # ticks since any of the evidence could tell
        self._suspected, self._sure = (
            nats(hours, len(self._detector.faults), time)
            for hours in (evidence.run_length_h, max(SURE_H, evidence.run_length_h))
        )
        self._peak = 0.0  # the largest ratio of what is held
        self._held = self._lasts = False
        self.blind = False  # some of the evidence cannot tell now
        self._since_s = np.inf  # the earliest of the likeliest onsets of what alarms: those of severe faults wander
        self.alarm = self.sure = False

    @property
    def is_held(self) -> bool:
        """Return True if the baseline is held: then blocks do not change whether it alarms, and looks do."""
        return self._held

    @property
    def level(self) -> Level:
        """Return the level of the means by the baseline as it was before what is suspected."""
        return self._baseline.level

    def without_baseline(self, mode: int, residuals: Residuals) -> FloatArray:
        """Return the residuals (..., T) of ticks as detectors of the level see them."""
        return self._baseline.taken_off(mode, residuals.r, residuals.excess)

    def room(self, mode: int) -> float:
        """Return how many ticks in this mode it takes at once, the last of which may say something."""
        until_fresh = self._frozen - self._blind - 1
        return min(self._blocks.room(mode), max(1, until_fresh) if self._blind else inf)

    def extend(self, tick: int, mode: int, residuals: Residuals, *, suspected: bool) -> None:
        """Take ticks in a row from this one on, in which the same tests can tell; something is suspected or not."""
        usable = residuals.usable[0, self._rows]
        self.blind = not usable.all()
        self._blind = 0 if usable.any() else self._blind + len(residuals.r)
        if self._blind == self._frozen:
            self._detector = self._fresh()
            self._baseline.follow(self._of_filter())
            self.rest()
        self._recent.extend(mode, residuals)
        block = self._blocks.extend(tick, mode, residuals)
        if block is None:
            return
        change = self._detector.step(block)
        ratio = float(change.log_ratio[0])
        if self._held:
            since = self._detector.since(self._since_s)
            self._peak = max(self._peak, since)
            self._lasts = self._peak > self._suspected and since > self._peak - SAME
            return
        self.alarm = ratio > self._suspected or (self.alarm and ratio > SAME)
        self.sure = ratio > self._sure
        if self.alarm:
            self._since_s = min(self._since_s, float(self._detector.onset_s[0, change.onset[0]]))
            self._baseline.follow(self._before(self._since_s))
            return
        self._since_s = np.inf
        if not suspected:
            self._baseline.follow(self._of_filter())

    def look(self) -> None:
        """Look whether a change that is held is still there; asked now and then.

        The last seconds show a large one. A small one lasts as long as its ratio does not fall.
        """
        if self._held:
            recent = self._recent.means  # ticks that wait are added up, whether their sum is needed or not
            self.alarm = self._lasts or self._shows(recent)

    def _shows(self, recent: Means) -> bool:
        seen = self._hypotheses.look(recent, self._baseline.level)
        return seen is not None and seen.gain > 2.0 * SAME

    def suspect(self, tick: int) -> None:
        """Keep the baseline as it was before this tick: something is suspected from then on."""
        if not self.alarm:
            self._baseline.follow(self._before(tick * self._period_s))

    def hold(self) -> None:
        """Hold the baseline: the fault is sure."""
        if not self._held:
            self._held, self._peak = True, 0.0

    def accept(self) -> None:
        """Go on from what the filter has followed: what was suspected is the baseline's."""
        self._baseline.follow(self._of_filter())
        if self.alarm or self._held:
            self.rest()

    def rest(self) -> None:
        """Begin to look for changes anew, from the baseline that is known: what was suspected is over."""
        self._detector.forget_onsets(self._baseline.state)
        self._held = self._lasts = self.alarm = self.sure = False
        self._peak = 0.0
        self._since_s = np.inf
        self._recent.clear()

    def _fresh(self) -> ChangeDetector:
        return self._of_changes(self._model, self._hypotheses.segments, self._count)

    def _of_filter(self) -> GaussianState:
        return self._detector.filter.state

    def _before(self, t_s: float) -> GaussianState:
        """The state at the last onset that the detector keeps until this time, or the filter's."""
        earlier = np.flatnonzero(self._detector.onset_s[0] <= t_s)
        if not len(earlier):
            return self._of_filter()
        before = self._detector.before
        return GaussianState(*(each[:, earlier[-1]].copy() for each in before))


def nats(run_length_h: float, faults: int, time: TimeScale) -> float:
    """Return the threshold of the log-likelihood ratio [nats] for an average run length without a fault [h].

    A ratio of one fault exceeds h in a block with a probability of exp(-h) at most, and one of F + 1 does, with the
    undeclared one, with (F + 1) exp(-h) (Lorden, Annals of Mathematical Statistics 42, 1971; Bonferroni). It is `SAME`
    at least.

    >>> scale = TimeScale(period_s=0.2, settling_s=20.0)
    >>> round(nats(10.0, 10, scale), 1), round(nats(5000.0, 10, scale), 1)
    (11.8, 18.0)
    """
    return max(SAME, float(np.log((faults + 1) * run_length_h * 3600.0 / time.seconds(BLOCK))))

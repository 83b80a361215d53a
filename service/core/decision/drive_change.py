"""The change detection of one drive: suspicion, the baseline before the change, and whether it is still there.

While nothing is suspected, the filter follows the baseline. A change is suspected where a ratio exceeds `SUSPECTED`,
and sure where one exceeds `SURE`. From then on the baseline is that before the onset, and is held: a filter that went
on would take the fault for the baseline's in time. Evidence that could not tell for long begins anew.
"""

from collections.abc import Sequence

import numpy as np

from faultline.service.core.decision.baseline import BaselineModel, GaussianState
from faultline.service.core.decision.baseline_level import BaselineLevel
from faultline.service.core.decision.blocks import BlockMeans
from faultline.service.core.decision.change_detector import ChangeDetector
from faultline.service.core.decision.hypotheses import Hypotheses
from faultline.service.core.decision.straying import Level
from faultline.service.core.decision.window import Recent
from faultline.service.core.detectors.bank import FROZEN
from faultline.service.core.manifest import Evidence
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.values import FloatArray
from faultline.service.core.time_scale import TimeScale

SUSPECTED, SURE = 18.0, 25.0
"""Log-likelihood ratios [nats]. Chosen on fault-free drives of three simulated trucks (404, 407, 601; six hours, each
tuned on half an hour of its own, one with a sensor's backlash), which had up to 18; not shown on others yet."""

SAME = 5.0
"""A fault is there as long as it fits what was seen of late by so much [nats] better than none does."""


class DriveChange:
    """The detector, the baseline's level and what was seen of late, of one drive."""

    def __init__(self, evidence: Evidence, generators: Sequence[str], hypotheses: Hypotheses, time: TimeScale) -> None:
        self._frozen = time.ticks(FROZEN)
        self._rows = [generators.index(name) for name in evidence.generators]
        self._hypotheses, self._count = hypotheses, evidence.simple
        self._model, self._period_s = BaselineModel(evidence, time), time.period_s
        self._baseline = BaselineLevel(evidence, generators, self._model)
        self._blocks = BlockMeans(evidence, generators, time)
        self._recent = Recent(evidence, generators, time)
        self._detector = self._fresh()
        self._blind = 0  # ticks since any of the evidence could tell
        self._held = False
        self.blind = False  # some of the evidence cannot tell now
        self._since_s = np.inf  # the earliest of the likeliest onsets of what alarms: those of severe faults wander
        self.alarm = self.sure = False

    @property
    def level(self) -> Level:
        """Return the level of the means by the baseline as it was before what is suspected."""
        return self._baseline.level

    def without_baseline(self, mode: int, residuals: Residuals) -> FloatArray:
        """Return the residuals (T,) of a tick as detectors of the level see them."""
        return self._baseline.taken_off(mode, residuals.r)

    def add(self, tick: int, mode: int, residuals: Residuals, *, suspected: bool) -> None:
        """Take a tick, at which something is suspected already or not."""
        usable = residuals.usable[self._rows]
        self.blind = not usable.all()
        self._blind = 0 if usable.any() else self._blind + 1
        if self._blind == self._frozen:
            self._detector = self._fresh()
            self._baseline.follow(self._of_filter())
            self.rest()
        self._recent.add(mode, residuals)
        block = self._blocks.add(tick, mode, residuals)
        if block is None or self._held:
            return
        change = self._detector.step(block)
        ratio = float(change.log_ratio[0])
        self.alarm = ratio > SUSPECTED or (self.alarm and ratio > SAME)
        self.sure = ratio > SURE
        if self.alarm:
            self._since_s = min(self._since_s, float(self._detector.onset_s[0, change.onset[0]]))
            self._baseline.follow(self._before(self._since_s))
            return
        self._since_s = np.inf
        if not suspected:
            self._baseline.follow(self._of_filter())

    def look(self) -> None:
        """Look whether a change that is held is still there; asked now and then."""
        if self._held:
            seen = self._hypotheses.look(self._recent.means, self._baseline.level)
            self.alarm = seen is not None and seen.gain > 2.0 * SAME

    def suspect(self, tick: int) -> None:
        """Keep the baseline as it was before this tick: something is suspected from then on."""
        if not self.alarm:
            self._baseline.follow(self._before(tick * self._period_s))

    def hold(self) -> None:
        """Hold the baseline: the fault is sure."""
        self._held = True

    def accept(self) -> None:
        """Go on from what the filter has followed: what was suspected is the baseline's."""
        self._baseline.follow(self._of_filter())
        if self.alarm or self._held:
            self.rest()

    def rest(self) -> None:
        """Begin to look for changes anew, from the baseline that is known: what was suspected is over."""
        self._detector.forget_onsets(self._baseline.state)
        self._held = self.alarm = self.sure = False
        self._since_s = np.inf
        self._recent.clear()

    def _fresh(self) -> ChangeDetector:
        return ChangeDetector(self._model, self._hypotheses.segments, self._count)

    def _of_filter(self) -> GaussianState:
        return self._detector.filter.state

    def _before(self, t_s: float) -> GaussianState:
        """The state at the last onset that the detector keeps until this time, or the filter's."""
        earlier = np.flatnonzero(self._detector.onset_s[0] <= t_s)
        if not len(earlier):
            return self._of_filter()
        before = self._detector.before
        return GaussianState(before.mean[:, earlier[-1]], before.covariance[:, earlier[-1]])

"""All detectors of a bundle: built from its manifest, fed with every tick's residuals, asked by generator."""

from collections.abc import Sequence

import numpy as np

from faultline.service.core.detectors.adaptive import Adaptive
from faultline.service.core.detectors.cusum import Cusum
from faultline.service.core.detectors.low_pass import LowPass
from faultline.service.core.detectors.protocol import Detector
from faultline.service.core.detectors.spread import Spread
from faultline.service.core.detectors.standard import Standard
from faultline.service.core.detectors.threshold import Threshold
from faultline.service.core.manifest import (
    AdaptiveDetector,
    CusumDetector,
    LowPassDetector,
    SpreadDetector,
    ThresholdDetector,
)
from faultline.service.core.manifest import Detector as Settings
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.values import FloatArray
from faultline.service.core.time_scale import Span, TimeScale, ticks_of

FROZEN = Span(settlings=15, seconds=300)
NONE: frozenset[int] = frozenset()


def detector(settings: Settings, period_s: float) -> Detector:
    """A fresh detector of ticks that are `period_s` [s] apart."""
    hold = 0 if isinstance(settings, CusumDetector) else ticks_of(settings.hold_s, period_s)
    match settings:
        case CusumDetector():
            return Cusum(settings.nu, settings.J, settings.side)
        case ThresholdDetector():
            return Threshold(settings.J, hold)
        case LowPassDetector():
            return LowPass(settings.J, hold, max(1.0, settings.time_s / period_s))
        case AdaptiveDetector():
            return Adaptive(settings.J, hold)
        case SpreadDetector():
            return Spread(settings.J, hold, max(1.0, settings.memory_s / period_s))


class DetectorBank:
    """The detectors of T generators, of which each has one that tests its level, and may have more.

    A detector of a generator that cannot tell is frozen and its alarm stands, for `FROZEN`: a sensor that died in
    mid-alarm says nothing of now, and would keep an episode open for ever. One that tests the spread raises
    suspicion; only one that tests the level can be a conflict, because only that has the structural row of its
    generator.
    """

    def __init__(self, settings: Sequence[Settings], generators: Sequence[str], time: TimeScale) -> None:
        self._longest = time.ticks(FROZEN)
        self._count = len(generators)
        self._rows = [generators.index(each.generator) for each in settings]
        self._level = [not isinstance(each, SpreadDetector) for each in settings]
        self._detectors = [detector(each, time.period_s) for each in settings]
        self._standard = Standard(settings, self._rows)
        self._frozen = np.zeros(len(generators), dtype=np.int64)  # ticks since each could tell
        self._standing: list[int] = []  # the detectors whose alarm stands
        self.firing: frozenset[int] = NONE
        """The generators of which some detector alarms."""
        self.alarmed: frozenset[int] = NONE
        """The generators whose level alarms."""

    def update(self, tick: int, mode: int, residuals: Residuals) -> None:
        """Takes the residuals (T,) of a tick; those that are no evidence are not looked at."""
        standard = self._standard(mode, residuals).tolist()
        counts = residuals.counted
        self._frozen = np.where(counts, 0, self._frozen + 1)
        can_tell = counts.tolist()
        standing = []
        for k, (each, row, s) in enumerate(zip(self._detectors, self._rows, standard, strict=True)):
            if can_tell[row]:
                each.update(tick, s)
            if each.alarm and self._frozen[row] <= self._longest:
                standing.append(k)
        if standing != self._standing:
            self._standing = standing
            self.firing = frozenset(self._rows[k] for k in standing)
            self.alarmed = frozenset(self._rows[k] for k in standing if self._level[k])

    def beside(self, covered: frozenset[int]) -> bool:
        """Return whether a detector alarms that is none of the level of the `covered` generators."""
        return any(not (self._level[k] and self._rows[k] in covered) for k in self._standing)

    @property
    def since(self) -> int | None:
        """The tick at which the evidence of what alarms began."""
        since = [self._detectors[k].since for k in self._standing]
        return min((tick for tick in since if tick is not None), default=None)

    @property
    def sums(self) -> FloatArray:
        """Return for each generator (T,) its largest level detector, in parts of the threshold, signed."""
        sums = np.zeros(self._count)
        for each, row, level in zip(self._detectors, self._rows, self._level, strict=True):
            if level and each.value > abs(sums[row]):
                sums[row] = each.sign * each.value
        return sums

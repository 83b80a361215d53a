"""All detectors of a bundle: built from its manifest, fed with every tick's residuals, asked by generator."""

from collections.abc import Sequence

import numpy as np

from faultline.service.core.detectors.adaptive import Adaptive
from faultline.service.core.detectors.cusum import Cusum, Cusums
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
from faultline.service.core.signals.values import FloatArray, Indices, Mask
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


class Each:
    """Detectors of any kind, one tick at a time."""

    def __init__(self, settings: Sequence[Settings], period_s: float) -> None:
        self._detectors = [detector(each, period_s) for each in settings]

    def ahead(self, tick: int, s: FloatArray, counted: Mask) -> Mask:
        """Take a tick, the only one of a row (1, D); return which alarm (1, D)."""
        for each, value, counts in zip(self._detectors, s[0].tolist(), counted[0].tolist(), strict=True):
            if counts:
                each.update(tick, value)
        return np.array([[each.alarm for each in self._detectors]], dtype=np.bool_)

    @property
    def since(self) -> list[int]:
        """Return since which tick each has had evidence; -1 where it has none."""
        return [-1 if each.since is None else each.since for each in self._detectors]

    @property
    def signed(self) -> FloatArray:
        """Return the statistic of each (D,) in parts of its threshold, with the sign of the residual."""
        return np.array([each.sign * each.value for each in self._detectors])


class DetectorBank:
    """The detectors of T generators, of which each has one that tests its level, and may have more.

    A detector of a generator that cannot tell is frozen and its alarm stands, for `FROZEN`: a sensor that died in
    mid-alarm says nothing of now, and would keep an episode open for ever. One that tests the spread raises
    suspicion; only one that tests the level can be a conflict, because only that has the structural row of its
    generator.
    """

    def __init__(
        self, settings: Sequence[Settings], generators: Sequence[str], time: TimeScale, cusums: type[Cusums] = Cusums
    ) -> None:
        self._longest = time.ticks(FROZEN)
        self._count = len(generators)
        self._rows = [generators.index(each.generator) for each in settings]
        self._level = [not isinstance(each, SpreadDetector) for each in settings]
        of_cusums = [each for each in settings if isinstance(each, CusumDetector)]
        self._cusums = cusums(of_cusums) if len(of_cusums) == len(settings) else None
        self._each = Each(settings, time.period_s)
        self._standard = Standard(settings, self._rows)
        self._frozen = np.zeros(len(generators), dtype=np.int64)  # ticks since each could tell
        self._stands = np.zeros(len(settings), dtype=np.bool_)  # the detectors whose alarm stands
        self.takes_rows = self._cusums is not None
        """True if it can take several ticks at once."""
        self.firing: frozenset[int] = NONE
        """The generators of which some detector alarms."""
        self.alarmed: frozenset[int] = NONE
        """The generators whose level alarms."""

    def update(self, tick: int, mode: int, residuals: Residuals) -> None:
        """Takes the residuals (T,) of a tick; those that are no evidence are not looked at."""
        self.extend(tick, mode, residuals.in_a_row)

    def extend(self, tick: int, mode: int, residuals: Residuals) -> int:
        """Take ticks in a row as long as the same alarms stand, or the one at which they change; return how many."""
        s, counts = self._standard(mode, residuals), residuals.counted
        counted = counts[:, self._rows]
        if self._cusums is None:
            alarm = self._each.ahead(tick, s, counted)
        else:
            ahead = self._cusums.ahead(s, counted)
            alarm = ahead.alarm
        frozen = np.zeros_like(counts, dtype=np.int64) if counts.all() else self._frozen_for(counts)
        ticks = self._standing(alarm, frozen) if self.firing or alarm.any() else len(counts)
        if self._cusums is not None:
            self._cusums.go(tick, ahead, ticks)
        self._frozen = frozen[ticks - 1]
        return ticks

    def _standing(self, alarm: Mask, frozen: Indices) -> int:
        """Take the ticks (n,) in which the same alarms stand as before, or the first; return how many."""
        stands = alarm & (frozen[:, self._rows] <= self._longest)
        changes = (stands != self._stands).any(axis=1)
        if not changes[0]:
            return int(changes.argmax()) if changes.any() else len(changes)
        self._stands = stands[0]
        standing = np.flatnonzero(self._stands).tolist()
        self.firing = frozenset(self._rows[k] for k in standing)
        self.alarmed = frozenset(self._rows[k] for k in standing if self._level[k])
        return 1

    def _frozen_for(self, counts: Mask) -> Indices:
        """Return for how many ticks each generator could not tell, at each of the next ticks (n, T)."""
        number = np.arange(1, 1 + len(counts))[:, None]
        last = np.maximum.accumulate(np.where(counts, number, 0), axis=0)
        return np.asarray(np.where(last > 0, number - last, self._frozen + number))

    def beside(self, covered: frozenset[int]) -> bool:
        """Return whether a detector alarms that is none of the level of the `covered` generators."""
        if not self.firing:
            return False
        return any(not (self._level[k] and self._rows[k] in covered) for k in np.flatnonzero(self._stands).tolist())

    @property
    def since(self) -> int | None:
        """The tick at which the evidence of what alarms began."""
        since = np.asarray(self._of_all.since)[self._stands]
        return int(since[since >= 0].min()) if (since >= 0).any() else None

    @property
    def sums(self) -> FloatArray:
        """Return for each generator (T,) its largest level detector, in parts of the threshold, signed."""
        sums = np.zeros(self._count)
        for row, level, value in zip(self._rows, self._level, self._of_all.signed.tolist(), strict=True):
            if level and abs(value) > abs(sums[row]):
                sums[row] = value
        return sums

    @property
    def _of_all(self) -> Cusums | Each:
        return self._each if self._cusums is None else self._cusums

"""The decision of a tick: detectors, conflicts, ranked diagnoses."""

import numpy as np

from service.core.cusum import Cusum
from service.core.events import Diagnosis
from service.core.generators import Residuals
from service.core.isolation import diagnoses
from service.core.manifest import Manifest
from service.core.ranking import EvidenceWindow, ranked
from service.core.signals import Vector

RANKING_PERIOD = 50
"""Ranks are computed anew at every tick that this divides: seldom, and at the same ticks whatever the episode's first.

A bus delivers the same recording with a little jitter each time; misfits compared at every tick would cross at
another one each time.
"""


class Decision:
    """Detectors and isolation: residuals in; alarmed tests, tests that cannot tell and ranked diagnoses out."""

    def __init__(self, manifest: Manifest) -> None:
        self._tests = [generator.test for generator in manifest.generators]
        self._sensitive = [frozenset(generator.faults) for generator in manifest.generators]
        self._detectors = [Cusum(detector.nu, detector.J) for detector in manifest.detectors]
        self._offset = np.array([detector.offset for detector in manifest.detectors])  # (T, modes)
        self._scale = np.array([detector.scale for detector in manifest.detectors])
        self._window = EvidenceWindow(manifest.evidence, [generator.name for generator in manifest.generators])
        self._episode: int | None = None  # tick of its first alarm
        self._misfits: dict[str, float] = {}
        self._usable = np.zeros(len(self._tests), dtype=np.bool_)

    def update(self, tick: int, mode: int, residuals: Residuals) -> None:
        """Takes the residuals of a tick. The detector of a test that cannot tell is frozen, its alarm stands."""
        self._usable = residuals.usable
        s = (residuals.r - self._offset[:, mode]) / self._scale[:, mode]
        for row, detector in enumerate(self._detectors):
            if residuals.usable[row]:
                detector.update(tick, float(s[row]))
        if not any(detector.alarm for detector in self._detectors):
            self._episode = None
            return
        if self._episode is None:
            self._episode = tick
            self._window.clear()
            self._misfits = {}
        self._window.add(mode, residuals.r, residuals.usable)
        if tick % RANKING_PERIOD == 0:
            self._misfits = self._window.misfits()

    @property
    def sums(self) -> Vector:
        """Each test's CUSUM in parts of its threshold, with the residual's sign (T,)."""
        return np.array([detector.sign * detector.value for detector in self._detectors])

    @property
    def alarm(self) -> list[str]:
        """Tests that alarm and can tell now: one of their generators does."""
        rows = zip(self._tests, self._detectors, self._usable, strict=True)
        return list(dict.fromkeys(test for test, detector, usable in rows if detector.alarm and usable))

    @property
    def cannot_tell(self) -> list[str]:
        """Tests that cannot tell now: none of their generators can, or one that alarms cannot and no other alarms."""
        rows = [*zip(self._tests, self._detectors, self._usable, strict=True)]
        telling = {test for test, _, usable in rows if usable}
        frozen = {test for test, detector, usable in rows if detector.alarm and not usable} - {*self.alarm}
        return [test for test in dict.fromkeys(self._tests) if test not in telling or test in frozen]

    @property
    def since(self) -> int | None:
        """The tick at which the evidence of the alarmed tests began."""
        return min((d.since for d in self._detectors if d.alarm and d.since is not None), default=None)

    @property
    def diagnoses(self) -> list[Diagnosis]:
        """What explains the alarms, best first. An alarm whose test has become unable to tell still counts."""
        conflicts = [s for s, detector in zip(self._sensitive, self._detectors, strict=True) if detector.alarm]
        ranks = ranked(diagnoses(conflicts), self._misfits)
        return [Diagnosis(faults=list(faults), rank=rank, p=None) for faults, rank in ranks]

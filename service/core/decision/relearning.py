"""Relearning: after a repair, or with another sensor, a vehicle's residuals without a fault lie elsewhere than tuned.

The offset of each residual in each operating mode is its mean there, over at least `VISITS` visits and `SEEN` in all:

    offset_m = 1 / n_m  sum of r_k over the ticks k of mode m that are counted

What a visit adds to its residuals does not average out within it, so that several are wanted. That of the edge between
modes, if it has not been seen for so long, moves as far as those of the modes in the mean. The spreads stay as tuned.
Meanwhile no test can tell: a fault that is there is learnt as the vehicle's own, so it must have been repaired.
"""

import msgspec
import numpy as np

from faultline.service.core.manifest import Manifest
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.signals.values import FloatArray
from faultline.service.core.time_scale import Span

VISITS = 4
"""Least visits to each mode: the mean of four has half the spread of one."""
SEEN = Span(settlings=3.0)
"""Least time of each mode in all."""


class Sums(msgspec.Struct, frozen=True, kw_only=True):
    """What has been seen: sums and numbers of residuals by mode and generator (modes, T), and the modes' visits."""

    total: list[list[float]]
    ticks: list[list[int]]
    visits: list[int]


class Relearning:
    """State: sums, by mode and generator, and the mode of the tick before.

    `sums` are those of an earlier run. They are begun anew where they are not of as many modes and generators.
    """

    def __init__(self, manifest: Manifest, sums: Sums | None = None) -> None:
        modes, generators = len(manifest.modes.names), len(manifest.generators)
        offset = {detector.generator: detector.offset for detector in reversed(manifest.detectors)}
        self._offset = np.array([offset[generator.name] for generator in manifest.generators])  # (T, modes)
        self._names = manifest.modes.names
        self._least = manifest.time.ticks(SEEN)
        self._mode = EDGE
        self._total, self._ticks = np.zeros((modes, generators)), np.zeros((modes, generators), dtype=np.int64)
        self._visits = np.zeros(modes, dtype=np.int64)
        if sums is not None and np.shape(sums.total) == np.shape(sums.ticks) == (modes, generators):
            self._total, self._ticks = np.array(sums.total), np.array(sums.ticks)
            self._visits = np.array(sums.visits)

    def add(self, mode: int, residuals: Residuals) -> None:
        """Take the residuals of a tick."""
        counted = residuals.counted & np.isfinite(residuals.r)
        if mode != self._mode and counted.any():
            self._mode = mode
            self._visits[mode] += 1
        self._total[mode] += np.where(counted, residuals.r, 0.0)
        self._ticks[mode] += counted

    @property
    def sums(self) -> Sums:
        """Return what has been seen."""
        return Sums(total=self._total.tolist(), ticks=self._ticks.tolist(), visits=self._visits.tolist())

    @property
    def wanting(self) -> list[str]:
        """Return the modes of which more has to be seen."""
        enough = (self._visits >= VISITS) & (self._ticks >= self._least).all(axis=1)
        return [name for mode, name in enumerate(self._names) if mode != EDGE and not enough[mode]]

    def moved(self) -> FloatArray:
        """Return how far the offsets lie from those of the tuning (T, modes), once nothing is wanting."""
        by = (self._total / np.maximum(self._ticks, 1)).T - self._offset
        steady = np.arange(len(self._names)) != EDGE
        is_known = self._ticks[EDGE] >= self._least
        by[:, EDGE] = np.where(is_known, by[:, EDGE], by[:, steady].mean(axis=1))
        return np.asarray(by)


class Baseline(msgspec.Struct, frozen=True, kw_only=True):
    """A baseline that replaces a bundle's: begun at a wall clock time, asked for by a person; a row of the store.

    `bundle` is the SHA-256 of the manifest. `moved` (T, modes) is None until it has been learnt, `sums` from then on.
    """

    bundle: str
    begun: str | None
    by: str
    sums: Sums | None = None
    moved: list[list[float]] | None = None

    def is_of(self, manifest: Manifest) -> bool:
        """Return True if it is of as many generators and modes, all of them numbers."""
        if self.moved is None:
            return True
        shape = len(manifest.generators), len(manifest.modes.names)
        return [len(row) for row in self.moved] == [shape[1]] * shape[0] and bool(np.isfinite(self.moved).all())

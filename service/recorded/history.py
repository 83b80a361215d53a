"""Ticks of a drive as columns, and any part of them with no more points than a picture has room for."""

from array import array
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from msgspec.structs import replace

from faultline.service.core.manifest import Manifest
from faultline.service.core.memory.freeze import Sample
from faultline.service.core.records.discrimination import separations
from faultline.service.core.signals.values import Quality
from faultline.service.protocol.live import Column, History, Stand

Columns = npt.NDArray[np.float32]


class Ticks:
    """Grows by a tick at a time; some 300 bytes each with ten tests."""

    def __init__(self, manifest: Manifest) -> None:
        self._manifest = manifest
        self._width = 1 + 2 * len(manifest.inputs) + 5 * len(manifest.generators)
        self._values = array("f")
        self._ticks = array("q")
        self._stands: list[Stand] = []

    def add(self, sample: Sample) -> None:
        """Takes a tick."""
        self._ticks.append(sample.tick)
        parts = (sample.z, sample.quality, sample.y_hat, sample.r, sample.sigma, sample.sums, sample.usable)
        row = np.concatenate([[sample.mode], *parts]).astype(np.float32)
        self._values.frombytes(row.tobytes())
        stand = Stand(
            tick=sample.tick,
            alarm=sample.alarm,
            cannot_tell=sample.cannot_tell,
            suspected=sample.suspected,
            anomaly=sample.suspicious,
            diagnoses=sample.diagnoses,
        )
        if not self._stands or stand != replace(self._stands[-1], tick=sample.tick):
            self._stands.append(stand)

    @property
    def latest(self) -> int | None:
        """The last tick; None before the first."""
        return self._ticks[-1] if self._ticks else None

    def part(self, name: str | None, after: int, before: int, most: int) -> History:
        """The ticks between both: each, or where that were more than `most`, of so many in a row one.

        Of those the one with the largest sum of any test stands for them, so that no alarm is lost to a picture.
        Signals are None where they were not usable, and what a generator made of a tick where it could not tell.
        """
        ticks = np.frombuffer(self._ticks, np.int64)
        first, last = np.searchsorted(ticks, after, "right"), np.searchsorted(ticks, before, "left")
        rows = np.frombuffer(self._values, np.float32).reshape(-1, self._width)[first:last]
        every = max(1, -(-len(rows) // most))
        chosen = self._standing_for(rows, every)
        rows, ticks = rows[chosen], ticks[first:last][chosen]
        mode, z, quality, y_hat, r, sigma, sums, usable = self._split(rows)
        good, can_tell = quality == Quality.GOOD, usable > 0
        signals = [each.signal for each in self._manifest.inputs]
        generators = [each.name for each in self._manifest.generators]
        return History(
            name=name,
            every=every,
            latest=self.latest,
            tick=ticks.tolist(),
            t_s=np.round(ticks * self._manifest.period_s, 3).tolist(),
            mode=[self._manifest.modes.names[int(each)] for each in mode[:, 0]],
            z=_named(signals, z, good),
            quality={
                name: [Quality(int(each)).name.lower() for each in quality[:, k]] for k, name in enumerate(signals)
            },
            y_hat=_named(generators, y_hat, can_tell),
            r=_named(generators, r, can_tell),
            sigma=_named(generators, sigma, can_tell),
            sums=_named(generators, sums, np.isfinite(sums)),
            stands=self._standing(ticks),
        )

    def _standing_for(self, rows: Columns, every: int) -> npt.NDArray[np.intp]:
        """Return of each `every` rows the one with the largest sum."""
        if every == 1:
            return np.arange(len(rows))
        largest = np.abs(np.nan_to_num(self._split(rows)[6])).max(axis=1, initial=0.0)
        return np.array([k + int(np.argmax(largest[k : k + every])) for k in range(0, len(rows), every)], np.intp)

    def _split(self, rows: Columns) -> list[Columns]:
        """Mode (n, 1), z and quality (n, nz), then y_hat, r, sigma, sums and usable (n, T)."""
        inputs, tests = len(self._manifest.inputs), len(self._manifest.generators)
        return np.split(rows, np.cumsum([1, inputs, inputs, tests, tests, tests, tests]), axis=1)

    def _standing(self, ticks: npt.NDArray[np.int64]) -> list[Stand]:
        """Return the decision at each of the ticks, once if it is the same: no more of them than ticks."""
        begins = np.array([each.tick for each in self._stands], np.int64)
        chosen = np.unique(np.searchsorted(begins, ticks, "right") - 1)
        generators = self._manifest.generators
        return [
            replace(stand, separating=separations(generators, stand.diagnoses, stand.cannot_tell))
            for stand in (self._stands[k] for k in chosen)
        ]


def _named(names: Sequence[str], columns: Columns, there: npt.NDArray[np.bool_]) -> Column:
    """The columns by name, with six digits; None where a value is not there."""
    return {
        name: [
            float(f"{value:.6g}") if here else None
            for value, here in zip(columns[:, k].tolist(), there[:, k] & np.isfinite(columns[:, k]), strict=True)
        ]
        for k, name in enumerate(names)
    }

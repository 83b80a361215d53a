"""What rivals are given: the residuals and signals of the campaign's recordings, and the false alarms they may have."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from diagnosis_judged import Judged, judged

Record = dict[str, Any]
Array = npt.NDArray[np.float64]

LINGER_S = 60.0
"""Alarms closer than this are one: as faultline counts them."""


@dataclass(frozen=True)
class Series:
    """A recording: log time t (K,) [s], samples z (K, nz), residuals r (K, T), whether usable (K, T), mode (K,).

    `judged` is what faultline told of it; `onset_s` [s] is its end where there is no fault.
    """

    judged: Judged
    t: Array
    z: npt.NDArray[np.float32]
    r: npt.NDArray[np.float32]
    usable: npt.NDArray[np.bool_]
    mode: npt.NDArray[np.int64]
    dosing: npt.NDArray[np.bool_]

    @property
    def vehicle(self) -> int:
        """Its number: no method is tried on a vehicle that it was made from."""
        return self.judged.vehicle

    @property
    def onset_s(self) -> float:
        """From here on nothing is fault-free."""
        return self.judged.free_s

    @property
    def free(self) -> npt.NDArray[np.bool_]:
        """The ticks (K,) before the onset."""
        return np.asarray(self.t < self.onset_s)


def load(records: Sequence[Record], root: Path) -> list[Series]:
    """The series of the records' recordings, kept by the campaign in `root`/truck-N/series.

    Raises:
        FileNotFoundError: they are gone, or were made by other code; run the campaign again.
    """
    found = []
    for record in records:
        for told in record["judged"]:
            with np.load(root / f"truck-{record['vehicle']}" / "series" / f"{told['case']}.npz") as kept:
                found.append(Series(judged(record["vehicle"], told), **kept))
    return found


def episodes(alarm: npt.NDArray[np.bool_], t: Array) -> Array:
    """When the alarms (K,) begin [s]: those that follow another one's end within `LINGER_S` are no new ones."""
    begins: list[float] = []
    last = -np.inf
    for at in t[alarm]:
        if at - last > LINGER_S:
            begins.append(float(at))
        last = at
    return np.array(begins)


def first_alarm(score: Array, limit: float, s: Series) -> float | None:
    """The first new alarm at or after the onset [s]; one that stands at the onset has to end first."""
    alarm = (score > limit) & np.isfinite(score)
    before = int(np.searchsorted(s.t, s.onset_s))
    k = before
    if before and alarm[before - 1]:
        while k < len(alarm) and alarm[k]:
            k += 1
    later = np.flatnonzero(alarm[k:])
    return float(s.t[k + later[0]]) if len(later) else None


def false_alarms(scores: Sequence[tuple[Array, Series]], limit: float) -> int:
    """Alarms before the onsets, over all recordings."""
    return sum(len(episodes((score > limit)[s.free], s.t[s.free])) for score, s in scores)


def limit_for(scores: Sequence[tuple[Array, Series]], allowed: int) -> float:
    """The smallest limit that leaves at most so many false alarms (bisection of its logarithm)."""
    highest = max(float(np.nanmax(score[s.free], initial=1e-6)) for score, s in scores)
    low, high = 1e-6, max(highest, 1e-6)
    while high > low * 1.002:
        middle = (low * high) ** 0.5
        low, high = (low, middle) if false_alarms(scores, middle) <= allowed else (middle, high)
    return high

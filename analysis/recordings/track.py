"""A signal as it was sampled, and where it was silent: what lies in a gap is not known."""

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from faultline.service.core.signals.received import Signals
from faultline.service.core.signals.values import FloatArray, are_good

SILENT_S, MOST_PERIODS = 1.0, 20.0
SILENT_PERIODS = 5.0
"""Samples further apart than this many periods have a gap between them; up to `SILENT_S` only from `MOST_PERIODS` on,
as a fast logger may be held up."""

Mask = npt.NDArray[np.bool_]


class Track(NamedTuple):
    """A signal at times `t` (N,) [s], increasing, with values (N,)."""

    t: FloatArray
    value: FloatArray

    @property
    def period_s(self) -> float:
        """Median time between samples [s]."""
        return float(np.median(np.diff(self.t)))

    def gaps(self) -> list[tuple[float, float]]:
        """Begin and end [s] of every silence."""
        ends = [(float(piece.t[0]), float(piece.t[-1])) for piece in self.pieces()]
        return [(before[1], after[0]) for before, after in pairwise(ends)]

    def pieces(self) -> list["Track"]:
        """The track cut at its gaps."""
        least_s = max(min(SILENT_S, MOST_PERIODS * self.period_s), SILENT_PERIODS * self.period_s)
        wide = np.flatnonzero(np.diff(self.t) > least_s) + 1
        return [Track(*part) for part in zip(np.split(self.t, wide), np.split(self.value, wide), strict=True)]

    def at(self, t: FloatArray) -> FloatArray:
        """Values at times `t` (K,) [s], linear between samples; whether they are known says `known`."""
        return np.asarray(np.interp(t, self.t, self.value))

    def held(self, t: FloatArray) -> FloatArray:
        """The last value at or before the times `t` (K,) [s]; before the first sample the first."""
        return self.value[np.maximum(np.searchsorted(self.t, t, side="right") - 1, 0)]

    def known(self, t: FloatArray, margin_s: float = 0.0) -> Mask:
        """Which of the times `t` (K,) [s] lie within the track, outside its gaps, and `margin_s` away from both."""
        inside = (t >= self.t[0] + margin_s) & (t <= self.t[-1] - margin_s)
        for begin, end in self.gaps():
            inside &= (t <= begin - margin_s) | (t >= end + margin_s)
        return np.asarray(inside)


def known_part(t: FloatArray, value: FloatArray) -> Track:
    """The samples that have a value."""
    good = np.isfinite(value)
    return Track(t[good], value[good])


def tracks_of(signals: Signals, names: Iterable[str]) -> dict[str, Track]:
    """The samples of these signals with the times of their frames [s].

    Those without a value, and all but the first of a time, are left out.
    """
    found: dict[str, list[Track]] = {name: [Track(np.zeros(0), np.zeros(0))] for name in names}
    for piece in signals.pieces(judged=False):
        for name in found.keys() & piece.columns.keys():
            column = piece.columns[name]
            good = are_good(column.quality)
            t, value = piece.time[column.row[good]], column.value[good]
            before = found[name][-1].t[-1:] if len(found[name]) > 1 else np.array([-np.inf])
            is_new = np.diff(t, prepend=before) > 0.0
            if is_new.any():
                found[name].append(Track(t[is_new], value[is_new]))
    return {name: Track(*map(np.concatenate, zip(*parts, strict=True))) for name, parts in found.items()}

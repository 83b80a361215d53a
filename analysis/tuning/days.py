"""Fault-free recordings as detectors will see them: with the day taken off, as the vehicle does it while it drives."""

from collections.abc import Sequence
from dataclasses import replace

from analysis.tuning.thresholds import Seen
from service.core.day import Day
from service.core.manifest import Evidence


def without_day(s: Seen, evidence: Evidence, generators: Sequence[str]) -> Seen:
    """The recording without its day; residuals of generators that are no evidence stay as they are."""
    rows = [generators.index(name) for name in evidence.generators]
    day, r = Day(evidence), s.r.copy()
    for tick, (mode, usable) in enumerate(zip(s.mode.tolist(), s.usable[:, rows], strict=True)):
        r[tick, rows] = day.taken_off(mode, s.r[tick, rows])
        day.add(mode, s.r[tick, rows], usable)
    return replace(s, r=r)

"""Fault-free recordings as detectors will see them: with the day taken off, as the vehicle does."""

from collections.abc import Sequence
from dataclasses import replace

from faultline.analysis.tuning.thresholds import Seen
from faultline.service.core.decision.day import Day
from faultline.service.core.manifest import Evidence


def without_day(s: Seen, evidence: Evidence, generators: Sequence[str]) -> Seen:
    """The recording without its day, taken off as it is known at the end: while it is not known, detectors are deafer.

    Residuals of networks stay as they are.
    """
    rows = [generators.index(name) for name in evidence.generators]
    moved = [*rows, *(generators.index(follower.generator) for follower in evidence.followers)]
    day, level = Day(evidence, s.time), s.r.copy()
    for mode, own, usable in zip(s.mode.tolist(), s.r[:, rows], s.usable[:, rows], strict=True):
        day.add(mode, own, usable)
    day.settle()
    for tick, mode in enumerate(s.mode.tolist()):
        level[tick, moved] = day.taken_off(mode, s.r[tick, moved])
    return replace(s, level=level)

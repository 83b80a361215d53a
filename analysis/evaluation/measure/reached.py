"""Delays that were reached, beside the shortest that any detector could reach (`faultline.analysis.limit`)."""

from collections.abc import Sequence
from math import log
from statistics import median

import msgspec

from faultline.analysis.evaluation.measure.facts import Facts
from faultline.analysis.evaluation.measure.intervals import Share, share
from faultline.analysis.evaluation.measure.sizes import PART, PERCENT
from faultline.analysis.evaluation.truth import TrueFault
from faultline.analysis.limit.limits import Limits, Smallest
from faultline.service.core.manifest import Evidence


class Reached(msgspec.Struct, frozen=True, kw_only=True):
    """A case of a single fault: the median delay of its recordings, and the limit's.

    `limit_s` is interpolated between the times of the limit; None where the size is below what it finds within the
    last. `smallest` is the smallest size that it finds until then, in the truth's `unit`.
    """

    case: str
    recordings: int
    detected: Share
    delay_s: float | None
    limit_s: float | None
    smallest: float | None
    within_s: float
    unit: str


def reached(of: Sequence[Facts], limits: Limits, evidence: Evidence) -> list[Reached]:
    """Every case of a single fault that the bundle has assumed sizes of."""
    found = []
    for case in dict.fromkeys(one.case for one in of if len(one.case.faults) == 1):
        here = [one for one in of if one.case == case]
        faults = [one.given.truth.fault[0] for one in here]
        rows = [_smallest_of(fault, limits, evidence) for fault in faults]
        if any(row is None for row in rows):
            continue
        delays = [one.verdict.delay_s for one in here if one.verdict.delay_s is not None]
        by_size = [_delay_s(abs(f.size), row, limits) for f, row in zip(faults, rows, strict=True) if row is not None]
        known = [each for each in by_size if each is not None]
        least = rows[0].size[-1][1] if rows[0] is not None else None
        found.append(
            Reached(
                case=case.label,
                recordings=len(here),
                detected=share(len(delays), len(here)),
                delay_s=round(median(delays), 1) if delays else None,
                limit_s=round(median(known), 1) if len(known) == len(here) else None,
                smallest=None if least is None else abs(least),
                within_s=limits.times_s[-1],
                unit=faults[0].unit,
            )
        )
    return found


def _smallest_of(fault: TrueFault, limits: Limits, evidence: Evidence) -> Smallest | None:
    """The limit's chain of sizes in the form and sign that the truth has: a part of what is lost, or so much more."""
    parts = {(each.fault, each.share_of) for each in evidence.sizes if each.display.unit == PERCENT}
    for row in limits.smallest:
        is_part = (row.fault, row.share_of) in parts
        sign = next((size for size in row.size[-1] if size is not None), 0.0)
        if row.fault == fault.name and is_part == (fault.unit == PART) and (is_part or sign * fault.size >= 0.0):
            return row
    return None


def _delay_s(size: float, row: Smallest, limits: Limits) -> float | None:
    """Return the time [s] at which the smallest size that is found has come down to this one, in the median."""
    before: tuple[float, float] | None = None
    for time_s, (_, least, _) in zip(limits.times_s, row.size, strict=True):
        if least is None:
            continue
        if abs(least) <= size:
            if before is None:  # information grows with the time and the size's square
                return max(time_s * (abs(least) / size) ** 2, limits.block_s)
            part = log(before[1] / size) / log(before[1] / abs(least))
            return before[0] + part * (time_s - before[0])
        before = time_s, abs(least)
    return None

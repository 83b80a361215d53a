"""Thresholds for a target: so many suspicions of the whole bank of detectors per hour.

Every detector's threshold is one factor times its own level (the mean over drives of the largest value it reached), so
that all share one question: how large must the factor be? The answer is read from drives that the levels were not set
on. With x(t) the largest value of any detector in parts of its level, suspicions are clusters of x above the factor.
Where the drives are too few for the target, the tail of the clusters' peaks above u is taken as exponential (Coles
2001, ch. 4, with shape 0) and drawn on, with the upper 95 % bounds of its rate and of its scale beta:

    rate(c) = (N / T) exp(-(c - u) / beta)        N clusters above u in T hours
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import floor, log

import numpy as np
import numpy.typing as npt
from scipy.special import gammaincinv

from faultline.analysis.tuning.baselines import without_baseline
from faultline.analysis.tuning.kinds import LEAST, OPEN, Kind, closed, described_by, opened, reached, unrest
from faultline.analysis.tuning.prior import Prior, no_lower
from faultline.analysis.tuning.thresholds import MARGIN, Seen, describe, in_order, standard
from faultline.analysis.tuning.vehicles import Vehicle, pooled, pooled_left_out
from faultline.service.core.detectors.kinds import kind_of
from faultline.service.core.manifest import Detector, Evidence
from faultline.service.core.time_scale import Span

Array = npt.NDArray[np.float64]

APART = Span(settlings=0.75)  # peaks that are closer are one cluster
PEAKS = 10  # a tail is fitted to so many clusters at least, where there are so many
CONFIDENCE = 0.95
RESAMPLES = 2000
SEED = 1


@dataclass(frozen=True)
class Rule:
    """How detectors are made: for these generators, `floor` (T,), `stand_ins`, `kinds` as in `tune_detectors`.

    `evidence` gives what drives of vehicles show of days, around the offsets (T, modes) that all are moved to, and the
    sizes of the drifts that the model names (`analysis.tuning.evidence`). `prior` is what a fleet teaches.
    """

    generators: Sequence[str]
    floor: Array
    stand_ins: Sequence[int]
    kinds: Sequence[Kind]
    evidence: Callable[[Sequence[Vehicle], Array], tuple[Evidence, list[float]]]
    prior: Prior | None = None

    def no_lower(self, detectors: Sequence[Detector]) -> list[Detector]:
        """The detectors, with thresholds not below a fleet's."""
        return [*detectors] if self.prior is None else no_lower(detectors, self.prior)


@dataclass(frozen=True)
class Trace:
    """x (K,) of a drive, over `hours`; peaks closer than `apart` ticks are one cluster."""

    x: Array
    hours: float
    apart: int

    def peaks(self, u: float) -> list[float]:
        """The largest value of each cluster above u."""
        return peaks(self.x, u, self.apart)


@dataclass(frozen=True)
class Factor:
    """Thresholds in parts of the levels, and whether a tail was drawn on to find it."""

    value: float
    extrapolated: bool


def levels(vehicles: Sequence[Vehicle], rule: Rule, to: Array, evidence: Evidence) -> list[Detector]:
    """Detectors whose thresholds are their levels; `to` (T, modes) are the offsets that everything is moved to."""
    centred, left_out = (
        [without_baseline(s, evidence, rule.generators) for s in together(vehicles, to, rule.stand_ins)]
        for together in (pooled, pooled_left_out)
    )
    time, found = centred[0].time, list[list[Detector]]()
    for row, name in enumerate(rule.generators):
        found.append([])
        for kind in rule.kinds:
            described = describe(name, row, centred, float(rule.floor[row]), rule.stand_ins, kind, to[row])
            runs = [standard(s, row, described, kind) for s in left_out]
            for detector in opened(kind, described, runs, time):
                typical = float(np.mean([reached(detector, run, time.period_s).max() for run in runs]))
                found[row].append(
                    closed(detector, max(LEAST[kind_of(detector)] * unrest(kind, runs) / MARGIN, typical))
                )
    return in_order(found)


def scaled(detectors: Sequence[Detector], factor: float) -> list[Detector]:
    """The detectors with thresholds of so many levels, none below the least of its kind."""
    return [closed(d, max(LEAST[kind_of(d)], factor * d.J)) for d in detectors]


def trace(detectors: Sequence[Detector], s: Seen, rule: Rule, hours: float) -> Trace:
    """The largest value of any of the detectors, whose thresholds are levels, at every tick of a drive."""
    x = np.zeros(len(s.r))
    for detector in detectors:
        row = rule.generators.index(detector.generator)
        use = s.usable[:, row]
        run = standard(s, row, described_by(detector), kind_of(detector))
        values = reached(closed(detector, OPEN), run, s.time.period_s) / detector.J
        x[use] = np.maximum(x[use], values)
    return Trace(x, hours, s.time.ticks(APART))


def factor_for(target: float, blocks: Sequence[Sequence[Trace]]) -> Factor:
    """The smallest factor at which the traces keep `target` [1/h]; the blocks are vehicles, or drives of one vehicle.

    It is counted where the target lets at least one suspicion happen in these hours, else drawn on.
    """
    traces = [each for block in blocks for each in block]
    hours = sum(each.hours for each in traces)
    allowed = floor(target * hours)
    if allowed >= 1:
        return Factor(_counted(traces, allowed), extrapolated=False)
    drawn = _drawn(traces, target)
    chosen = np.random.default_rng(SEED).integers(len(blocks), size=(RESAMPLES // 10, len(blocks)))
    resampled = [_drawn([t for index in row for t in blocks[index]], target, bound=False) for row in chosen]
    return Factor(max(drawn, float(np.quantile(resampled, CONFIDENCE))), extrapolated=True)


def peaks(x: Array, u: float, apart: int) -> list[float]:
    """The largest value of each cluster above u; clusters lie `apart` ticks apart.

    >>> peaks(np.concatenate([[0.0, 3.0, 1.0, 2.5], np.zeros(100), [4.0, 0.0]]), 2.0, 75)
    [3.0, 4.0]
    """
    above = np.flatnonzero(x > u)
    if not len(above):
        return []
    parts = np.split(above, np.flatnonzero(np.diff(above) > apart) + 1)
    return [float(x[part].max()) for part in parts]


def _counted(traces: Sequence[Trace], allowed: int) -> float:
    """The smallest level that no more clusters exceed than allowed, to a thousandth."""
    low, high = 0.0, max(float(each.x.max()) for each in traces)
    while high - low > 1e-3 * high:
        middle = (low + high) / 2.0
        if sum(len(each.peaks(middle)) for each in traces) > allowed:
            low = middle
        else:
            high = middle
    return high


def _drawn(traces: Sequence[Trace], target: float, bound: bool = True) -> float:
    """Where the tail has fallen to the target; with its bounds, or as estimated."""
    hours = sum(each.hours for each in traces)
    highest = max(float(each.x.max()) for each in traces)
    u, found = highest / 4.0, []
    for part in np.linspace(0.9, 0.25, 14):  # the highest u with enough clusters above it
        u = float(part * highest)
        found = [peak for each in traces for peak in each.peaks(u)]
        if len(found) >= PEAKS:
            break
    if not found:  # nothing ever left zero: the least thresholds will do
        return 0.0
    N = len(found)
    beta = float(np.mean(found)) - u
    if bound:
        beta *= N / float(gammaincinv(N, 1.0 - CONFIDENCE))
    rate = (float(gammaincinv(N + 1, CONFIDENCE)) if bound else N) / hours
    return max(u, u + beta * log(rate / target))

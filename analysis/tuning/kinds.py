"""The kinds of detectors that can be tuned: what each needs besides offset and scale, and how far runs take it.

A detector is first made with an open threshold, so high that it bounds nothing; what a fault-free run makes of it in
units of its own is then looked at, and the threshold set.
"""

from collections.abc import Sequence
from typing import Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from msgspec.structs import replace

from faultline.service.core.detectors.bank import detector
from faultline.service.core.detectors.spread import LARGEST
from faultline.service.core.manifest import (
    AdaptiveDetector,
    CusumDetector,
    Detector,
    LowPassDetector,
    Side,
    SpreadDetector,
    ThresholdDetector,
)
from faultline.service.core.time_scale import Span, TimeScale

Array = npt.NDArray[np.float64]
Kind = Literal["cusum", "one-sided", "threshold", "low-pass", "adaptive", "spread"]

LEVEL_KINDS: Final[tuple[Kind, ...]] = ("cusum", "one-sided", "threshold", "low-pass", "adaptive")

LASTING = Span(settlings=0.75, periods=75)
ALLOWANCE = 0.5  # of the mode's spread, on top of what lasted in the tuning recordings
HOLD = Span(settlings=0.5)  # as long as residuals take to calm down after a step
TIME, MEMORY = Span(settlings=0.25), Span(settlings=30)
OPEN = 1e9
MINIMUM_J = 15.0
LEAST = {"cusum": MINIMUM_J, "threshold": 4.0, "low-pass": 1.0, "adaptive": 4.0, "spread": 5.0}
"""No threshold is lower: a few minutes do not show less than this; of a variance ratio once in some thousand hours."""


class Described(NamedTuple):
    """A generator without a fault: per mode (modes,) offset and scale [unit of r], and what its sigma usually is."""

    generator: str
    offset: Array
    scale: Array
    usual: Array


def described_by(detector: Detector) -> Described:
    """What a detector says of its generator."""
    usual = detector.usual if isinstance(detector, AdaptiveDetector) else [1.0] * len(detector.scale)
    return Described(detector.generator, np.array(detector.offset), np.array(detector.scale), np.array(usual))


class Run(NamedTuple):
    """A standardised residual: tick numbers (n,) and s (n,)."""

    tick: npt.NDArray[np.int64]
    s: Array


def opened(kind: Kind, d: Described, runs: Sequence[Run], time: TimeScale) -> list[Detector]:
    """The detectors of a kind for one generator, their thresholds open."""
    name, offset, scale = d.generator, d.offset.tolist(), d.scale.tolist()
    hold_s, time_s, memory_s = map(time.seconds, (HOLD, TIME, MEMORY))
    match kind:
        case "cusum" | "one-sided":
            sides: tuple[Side, ...] = ("both",) if kind == "cusum" else ("above", "below")
            return [
                CusumDetector(
                    generator=name,
                    offset=offset,
                    scale=scale,
                    nu=ALLOWANCE + lasting(runs, time.ticks(LASTING), side),
                    J=OPEN,
                    side=side,
                )
                for side in sides
            ]
        case "threshold":
            return [ThresholdDetector(generator=name, offset=offset, scale=scale, J=OPEN, hold_s=hold_s)]
        case "low-pass":
            return [LowPassDetector(generator=name, offset=offset, scale=scale, J=OPEN, hold_s=hold_s, time_s=time_s)]
        case "adaptive":
            return [
                AdaptiveDetector(
                    generator=name, offset=offset, scale=scale, J=OPEN, hold_s=hold_s, usual=d.usual.tolist()
                )
            ]
        case "spread":
            return [
                SpreadDetector(
                    generator=name,
                    offset=offset,
                    scale=scale,
                    J=OPEN,
                    hold_s=hold_s,
                    memory_s=memory_s,
                )
            ]


def reached(settings: Detector, run: Run, period_s: float) -> Array:
    """What an open detector compares with its threshold (n,), in the threshold's units."""
    if isinstance(settings, CusumDetector):
        return _sums(settings, run.s)
    fresh = detector(settings, period_s)
    values = np.empty(len(run.s))
    for index, (tick, s) in enumerate(zip(run.tick, run.s, strict=True)):
        fresh.update(int(tick), float(s))
        values[index] = fresh.value
    return values * settings.J


def _sums(settings: CusumDetector, s: Array) -> Array:
    """The larger sum (n,) of an open CUSUM: how far the partial sums lie above the least of them so far (Page 1954)."""
    largest = np.zeros(len(s))
    for side, sign in (("above", 1.0), ("below", -1.0)):
        if settings.side in ("both", side):
            partial = np.cumsum(sign * s - settings.nu)
            np.maximum(largest, partial - np.minimum(np.minimum.accumulate(partial), 0.0), out=largest)
    return largest


def unrest(kind: Kind, runs: Sequence[Run]) -> float:
    """How many times as far as white noise the variance of fault-free runs goes up and down, 1 at least.

    Tuning drives are shorter than the windows of the test: the quarters of each, against its rest, say it instead.
    """
    if kind != "spread":
        return 1.0
    z = []
    for run in runs:
        steps = np.minimum(np.diff(run.s)[np.diff(run.tick) == 1] ** 2 / 2.0, LARGEST)
        for quarter in np.array_split(np.arange(len(steps)), 4):
            rest = np.delete(steps, quarter)
            if len(quarter) and steps[quarter].any() and rest.any():
                away = np.log(steps[quarter].mean() / rest.mean())
                z.append(away / np.sqrt(3.0 / len(quarter) + 3.0 / len(rest)))
    return max(1.0, float(np.sqrt(np.mean(np.square(z))))) if z else 1.0


def closed(settings: Detector, J: float) -> Detector:
    """The same with its threshold."""
    return replace(settings, J=J)


def lasting(runs: Sequence[Run], ticks: int, side: Side = "both") -> float:
    """The largest mean of any run over so many ticks in a row, or all of a shorter one, to either side or to one."""
    largest = 0.0
    for run in runs:
        sums = np.concatenate([[0.0], np.cumsum(run.s)])
        count = max(1, min(ticks, len(run.s)))
        means = (sums[count:] - sums[:-count]) / count
        means = {"both": np.abs(means), "above": means, "below": -means}[side]
        largest = max(largest, float(means.max(initial=0.0)))
    return largest

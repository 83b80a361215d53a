"""What can be promised: false alarms counted on drives that the thresholds have not seen.

Tuned on all vehicles but one (on all drives but one, where there is one vehicle), counted on the one left out, and so
on in turn. A vehicle left out is known by its offsets alone, and those from its other drives. Counts are of a Poisson
process within a vehicle, but vehicles differ: so the exact bound of the rate comes with the spread that resampling of
whole vehicles (drives) gives; resampling of seconds would not know the difference.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt
from scipy.special import gammaincinv

from faultline.analysis.tuning.baselines import without_baseline
from faultline.analysis.tuning.evaluators import evaluator_of
from faultline.analysis.tuning.target import CONFIDENCE, RESAMPLES, SEED, Rule, Trace, factor_for, levels, scaled, trace
from faultline.analysis.tuning.thresholds import MINIMUM_TICKS, more_of, tune_detectors
from faultline.analysis.tuning.vehicles import (
    Drive,
    Vehicle,
    hardly_seen,
    left_out_offset,
    moved,
    offsets,
    pooled,
    pooled_left_out,
)
from faultline.service.core.decision.decision import Decision
from faultline.service.core.decision.offsets import shifted
from faultline.service.core.decision.parts import Parts
from faultline.service.core.manifest import Claim, Count, Detector, Evidence, Manifest
from faultline.service.core.residuals.evaluator import Evaluator

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Fold:
    """Vehicles to tune on, and drives of a vehicle left out, with the offsets (T, modes) that it has without them."""

    train: Sequence[Vehicle]
    vehicle: Vehicle
    test: Sequence[tuple[Drive, Array]]

    @property
    def hours(self) -> float:
        """Of the drives left out."""
        return sum(drive.hours for drive, _ in self.test)


class Found(NamedTuple):
    """Detectors, and the evidence whose days they were set without, with the sizes of the model's drifts in it."""

    detectors: list[Detector]
    evidence: Evidence
    drift_sizes: list[float]


@dataclass(frozen=True)
class Thresholds:
    """What everything gives, what each fold gives, and whether a tail was drawn on for it."""

    whole: Found
    of_folds: list[Found]
    extrapolated: bool = False


def folds(vehicles: Sequence[Vehicle], stand_ins: Sequence[int]) -> list[Fold]:
    """What is left out in turn; nothing of a single drive, nor where the rest does not show every mode."""
    if len(vehicles) == 1:
        vehicle = vehicles[0]
        rests = [(drive, vehicle.without(index)) for index, drive in enumerate(vehicle.drives)]
        return [
            Fold([rest], vehicle, [(drive, offsets(rest.drives, stand_ins))])
            for drive, rest in rests
            if rest.drives and hardly_seen(rest.drives, stand_ins) is None
        ]
    found = []
    for index, vehicle in enumerate(vehicles):
        train = [*vehicles[:index], *vehicles[index + 1 :]]
        usual = np.mean([offsets(other.drives, stand_ins) for other in train], axis=0)
        drives = enumerate(vehicle.drives)
        found.append(Fold(train, vehicle, [(d, left_out_offset(vehicle, i, stand_ins, usual)) for i, d in drives]))
    return found


def why_no_folds(vehicle: Vehicle, stand_ins: Sequence[int]) -> str:
    """Return the reason why none of a single vehicle's drives can be left out, with the remedy."""
    if len(vehicle.drives) == 1:
        return "of a single drive none can be left out to count false alarms on; add another one"
    seen = [(drive, hardly_seen(vehicle.without(k).drives, stand_ins)) for k, drive in enumerate(vehicle.drives)]
    drive, (row, mode, ticks) = next((drive, found) for drive, found in seen if found is not None)
    generator = vehicle.runnable.generators[row].name
    return (
        f"no drive can be left out to count false alarms on: without {drive.seen.name}, {generator} saw mode "
        f"{drive.seen.modes[mode]!r} for {ticks} of {MINIMUM_TICKS} ticks; add a fault-free recording {more_of(mode)}"
    )


def thresholds(
    vehicles: Sequence[Vehicle], left_out: Sequence[Fold], rule: Rule, target: float | None, to: Array
) -> Thresholds:
    """Detectors by the usual rule, or for a target [1/h]; `to` (T, modes) are the first vehicle's offsets.

    A fold's factor is found without its own drives, so that what is counted there has chosen nothing.
    """
    (evidence, sizes), *of_folds = (rule.evidence(each, to) for each in (vehicles, *(fold.train for fold in left_out)))
    if target is None:
        usual = [
            Found(_usual(each, rule, to, own), own, own_sizes)
            for each, (own, own_sizes) in zip(
                (vehicles, *(fold.train for fold in left_out)), ((evidence, sizes), *of_folds), strict=True
            )
        ]
        return Thresholds(usual[0], usual[1:])
    whole = levels(vehicles, rule, to, evidence)
    each_level = [levels(fold.train, rule, to, own) for fold, (own, _) in zip(left_out, of_folds, strict=True)]
    blocks: list[list[Trace]] = [
        [
            trace(level, without_baseline(moved(d.seen, to - o), own, rule.generators), rule, d.hours)
            for d, o in fold.test
        ]
        for fold, level, (own, _) in zip(left_out, each_level, of_folds, strict=True)
    ]
    if not blocks:  # a single drive must do for both
        centred = [without_baseline(s, evidence, rule.generators) for s in pooled(vehicles, to, rule.stand_ins)]
        drives = [drive for vehicle in vehicles for drive in vehicle.drives]
        blocks = [[trace(whole, s, rule, d.hours)] for s, d in zip(centred, drives, strict=True)]
    factor = factor_for(target, blocks)
    others = [[*blocks[:index], *blocks[index + 1 :]] or blocks for index in range(len(each_level))]
    of_others = [factor_for(target, other) for other in others]
    return Thresholds(
        whole=Found(rule.no_lower(scaled(whole, factor.value)), evidence, sizes),
        of_folds=[
            Found(rule.no_lower(scaled(level, other.value)), *own)
            for level, other, own in zip(each_level, of_others, of_folds, strict=True)
        ],
        extrapolated=factor.extrapolated or any(other.extrapolated for other in of_others),
    )


def _usual(vehicles: Sequence[Vehicle], rule: Rule, to: Array, evidence: Evidence) -> list[Detector]:
    seen = [without_baseline(s, evidence, rule.generators) for s in pooled_left_out(vehicles, to, rule.stand_ins)]
    return rule.no_lower(tune_detectors(rule.generators, seen, rule.floor, rule.stand_ins, rule.kinds, to))


def told(manifest: Manifest, drive: Drive, evaluator: Evaluator, parts: Parts) -> tuple[int, int]:
    """Suspicions and confirmed diagnoses in a drive, its samples evaluated afresh."""
    decision = Decision(manifest, parts)
    suspicions = diagnoses = 0
    suspected = diagnosed = False
    z, usable, ages = (np.array([getattr(tick, name) for tick in drive.ticks]) for name in ("z", "usable", "ages"))
    modes, first = np.array([tick.mode for tick in drive.ticks]), 0
    for _, row in evaluator.evaluate(z, usable, ages):
        done, end = 0, len(row.r)
        while done < end:
            rest = modes[first + done : first + end]
            done += decision.extend(drive.ticks[first + done].number, rest, row.part(done, end))
            suspicions += decision.suspicious and not suspected
            suspected = decision.suspicious
            now = bool(decision.named)
            diagnoses += now and not diagnosed
            diagnosed = now
        first += end
    return suspicions, diagnoses


def count(left_out: Sequence[Fold], manifests: Sequence[Manifest], to: Array, say: Callable[[str], None]) -> Array:
    """Suspicions and diagnoses of every fold (folds, 2)."""
    counts = np.zeros((len(left_out), 2))
    ticks = sum(len(drive.ticks) for fold in left_out for drive, _ in fold.test)
    for index, (fold, manifest) in enumerate(zip(left_out, manifests, strict=True)):
        for drive, offset in fold.test:
            say(f"{drive.seen.name}, left out")
            moved_there = shifted(manifest, offset - to)
            ticks -= len(drive.ticks)
            by = evaluator_of(fold.vehicle.runnable, moved_there, len(drive.ticks), ticks)
            counts[index] += told(moved_there, drive, *by)
    return counts


def claim(
    vehicles: Sequence[Vehicle], left_out: Sequence[Fold], counts: Array, target: float | None, extrapolated: bool
) -> Claim:
    """The claim of counts (folds, 2): suspicions and diagnoses."""
    hours = np.array([fold.hours for fold in left_out])
    suspicions, diagnoses = (rate_of(column, hours) for column in counts.reshape(len(left_out), 2).T)
    drives = sum(len(vehicle.drives) for vehicle in vehicles)
    result: Literal["shown", "kept", "missed"] | None = None
    if target is not None and suspicions.hours > 0:
        kept = suspicions.count <= target * suspicions.hours
        shown = suspicions.upper is not None and suspicions.upper <= target
        result = "shown" if shown else "kept" if kept else "missed"
    made = Claim(
        drives=drives,
        vehicles=len(vehicles),
        left_out=sum(len(fold.test) for fold in left_out),
        suspicions=suspicions,
        diagnoses=diagnoses,
        target=target,
        result=result,
        extrapolated=extrapolated,
        said="",
    )
    return msgspec.structs.replace(made, said=sentence(made))


def rate_of(counts: Array, hours: Array) -> Count:
    """The rate of counts (n,) in hours (n,), each of a vehicle or drive.

    >>> one = rate_of(np.array([0.0, 0.0]), np.array([1.0, 2.0]))
    >>> one.count, one.hours, round(one.upper, 3), one.high  # 3 / T
    (0, 3.0, 0.999, 0.0)
    """
    total, n = float(hours.sum()), int(counts.sum())
    if total == 0.0:
        return Count(count=0, hours=0.0, upper=None, low=0.0, high=0.0)
    chosen = np.random.default_rng(SEED).integers(len(hours), size=(RESAMPLES, len(hours)))
    rates = counts[chosen].sum(axis=1) / hours[chosen].sum(axis=1)
    low, high = np.quantile(rates, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    upper = float(gammaincinv(n + 1, CONFIDENCE)) / total
    return Count(count=n, hours=total, upper=upper, low=float(low), high=float(high))


def sentence(claim: Claim) -> str:
    """The claim in words."""
    of = f"{_number(claim.drives, 'fault-free drive')} of {_number(claim.vehicles, 'vehicle')}"
    if claim.suspicions.upper is None:
        said = f"false alarms: {of}, none of which the others could do without, so nothing is known of their rate"
    else:
        suspicions, diagnoses = claim.suspicions, claim.diagnoses
        whole = "vehicles" if claim.vehicles > 1 else "drives"
        resampled = f"resampling {whole}: {suspicions.low:.2g} to {suspicions.high:.2g}"
        if claim.left_out == 1:
            resampled = "one drive cannot be resampled"
        said = (
            f"false alarms: {of}, {claim.left_out} left out of tuning in turn, {suspicions.hours:.2f} h: "
            f"{_number(suspicions.count, 'suspicion')}, {suspicions.count / suspicions.hours:.2g} per hour "
            f"(95 %: at most {suspicions.upper:.2g}; {resampled})"
            f"; {diagnoses.count} confirmed as faults (95 %: at most {diagnoses.upper:.2g} per hour)"
        )
    if claim.target is None:
        return said
    verdict = {"shown": "shown", "kept": "kept by the count, not shown", "missed": "missed", None: "cannot be told"}[
        claim.result
    ]
    said += f"; target {claim.target:g} suspicions per hour: {verdict}"
    if claim.result != "shown":
        said += f" (to show it needs {3.0 / claim.target:.3g} h without one, there are {claim.suspicions.hours:.2f} h)"
    if claim.extrapolated:
        said += "; the drives are too short for it: thresholds are drawn on by an exponential tail, at its upper bound"
    return said


def _number(count: int, what: str) -> str:
    """The count with its noun.

    >>> _number(1, "drive"), _number(3, "drive")
    ('1 drive', '3 drives')
    """
    return f"{count} {what}" if count == 1 else f"{count} {what}s"

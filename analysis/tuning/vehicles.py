"""Vehicles of one kind and their fault-free drives: read, checked, and centred each on its own offsets.

What differs between vehicles in a residual's level is the error of each one's calibration. It is known for a vehicle
from its own drives, and not from those of others: so residuals are centred per vehicle before anything is pooled.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.provenance import check_id, check_vehicle, vehicle_of
from faultline.analysis.graph.runnable import Runnable
from faultline.analysis.progress import Progress
from faultline.analysis.recordings.check import findings
from faultline.analysis.recordings.modes import modes_of, time_of
from faultline.analysis.recordings.observe import evaluated, open_for, trusted
from faultline.analysis.recordings.track import Track, tracks_of
from faultline.analysis.tuning.evaluators import residuals_of
from faultline.analysis.tuning.numbers import limited
from faultline.analysis.tuning.thresholds import MINIMUM_TICKS, Seen, edge_last, more_of, seen
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Input
from faultline.service.core.residuals.observer import Tick
from faultline.service.core.signals.arrivals import MARGIN

Array = npt.NDArray[np.float64]

TOWARDS_ZERO = 1e-3
"""How much a day weighs that is not zero, beside a median that is not met: what leaves the mean of all days open."""


@dataclass(frozen=True)
class Drive:
    """A fault-free recording through the generators of its vehicle; `ticks` are all, `seen` what tuning looks at.

    `inputs` have the limits that its numbers keep (`analysis.tuning.numbers`).
    """

    sha256: str
    ticks: Sequence[Tick]
    seen: Seen
    inputs: Sequence[Input]

    @cached_property
    def medians(self) -> tuple[Array, Array]:
        """The medians (T, modes) of the residuals, 0 where there are none, and of how many ticks they are."""
        shape = self.seen.usable.shape[1], len(self.seen.modes)
        medians, ticks = np.zeros(shape), np.zeros(shape)
        for row, mode in np.ndindex(shape):
            r = self.seen.r[self.seen.inside(row, mode), row]
            medians[row, mode], ticks[row, mode] = np.median(r) if len(r) else 0.0, len(r)
        return medians, ticks

    @property
    def hours(self) -> float:
        """For how long some test could tell."""
        return float(self.seen.usable.any(axis=1).sum()) * self.seen.time.period_s / 3600.0


@dataclass(frozen=True)
class Vehicle:
    """A calibrated model, runnable, and drives of the vehicle that it was calibrated for; at least one."""

    runnable: Runnable
    drives: Sequence[Drive]

    def only(self, *indices: int) -> "Vehicle":
        """With some of the drives."""
        return replace(self, drives=[self.drives[index] for index in indices])

    def without(self, index: int) -> "Vehicle":
        """With all drives but one."""
        return self.only(*(other for other in range(len(self.drives)) if other != index))


def read(runnable: Runnable, paths: Sequence[Path], used: Mapping[str, str], progress: Progress) -> Vehicle:
    """The vehicle's drives; `used` says of recordings (SHA-256) that must not be among them how they were used.

    Raises:
        InputError: a recording was used, is named twice or is of another vehicle, or its tests could hardly ever tell.
    """
    model = runnable.bank.model
    units = {channel.signal: channel.unit for channel in runnable.bank.inputs}
    drives: list[Drive] = []
    tracks: list[dict[str, Track]] = []
    for path in paths:
        log = open_for(model, path, progress.note)
        twice = "twice" if log.drive in {drive.sha256 for drive in drives} else None
        if (how := used.get(log.drive, used.get(log.sha256, twice))) is not None:
            raise InputError(f"{path}: this recording is used {how}; tune on fault-free recordings of their own")
        check_id(log, path, (drive.seen.name for drive in drives))
        check_vehicle(log, path, vehicle_of(model), f"the calibration of {model.name}")
        if runnable.networks:
            check_vehicle(log, path, runnable.networks.description.vehicle, "the training of the networks")
        progress.say(log.id)
        signals, jitter_s = trusted(log, units, str(path))
        for signal, early_s in jitter_s.items():
            progress.note(
                f"{path}: frames with {signal} come up to {early_s / MARGIN:.2g} s too soon; the vehicle will bear "
                f"{early_s:.2g} s, within which a second sender of them is counted only"
            )
        tracks.append(tracks_of(signals, units))
        ticks = evaluated(model, runnable.bank.inputs, signals, residuals_of(runnable))
        inputs = limited(runnable.bank.inputs, signals, model.residuals, jitter_s)
        drives.append(
            Drive(log.drive, ticks, seen(log.id, ticks, list(units), modes_of(model).names, time_of(model)), inputs)
        )
    for each in findings(model, tracks):
        progress.note(f"{model.name}: {each.text}")
    return Vehicle(runnable, drives)


def hardly_seen(drives: Sequence[Drive], stand_ins: Sequence[int]) -> tuple[int, int, int] | None:
    """The first generator and mode that drives show too little of, and its ticks; None where there is none."""
    for row, (_, stand_in) in product(range(drives[0].seen.usable.shape[1]), edge_last(stand_ins)):
        ticks = sum(int(drive.seen.inside(row, stand_in).sum()) for drive in drives)
        if ticks < MINIMUM_TICKS:
            return row, stand_in, ticks
    return None


def check_modes(vehicle: Vehicle, stand_ins: Sequence[int]) -> None:
    """Raises InputError where the vehicle's drives hardly show a mode: unknown is not zero."""
    if (missing := hardly_seen(vehicle.drives, stand_ins)) is not None:
        row, mode, ticks = missing
        raise InputError(
            f"tuning data ({', '.join(drive.seen.name for drive in vehicle.drives)}): "
            f"{vehicle.runnable.generators[row].name} saw mode {vehicle.drives[0].seen.modes[mode]!r} for {ticks} "
            f"ticks only; add a fault-free recording {more_of(mode)}"
        )


def offsets(drives: Sequence[Drive], stand_ins: Sequence[int], otherwise: Array | None = None) -> Array:
    """Where the residuals (T, modes) of a vehicle lie, `otherwise` (T, modes) where a mode was hardly seen.

    Every drive has a day of its own, which moves all modes by much more than these differ. So no mode may be that of
    one day and another that of the next: the medians m of a drive's modes are

        m[drive, mode] = offset[mode] + day[drive],  least squares, the days of all drives around zero.

    Where every drive shows every mode the offset is the mean over drives. Without `otherwise` the drives must show
    every mode (`check_modes`).
    """
    shape = drives[0].seen.usable.shape[1], len(stand_ins)
    found = np.full(shape, np.nan) if otherwise is None else otherwise.copy()
    modes = [*dict.fromkeys(stand_ins)]  # each once, or one would count as often as it stands for another
    column = [modes.index(mode) for mode in stand_ins]
    for row in range(shape[0]):
        medians, ticks = (np.array([drive.medians[k][row, modes] for drive in drives]) for k in (0, 1))
        shown = (ticks.sum(axis=0) >= MINIMUM_TICKS)[column]
        own = without_days(medians, np.minimum(ticks / MINIMUM_TICKS, 1.0))[column]
        found[row] = np.where(shown, own, found[row])
    assert np.isfinite(found).all(), "a mode is missing that nobody has checked"
    return found


def without_days(medians: Array, weight: Array) -> Array:
    """The offsets (modes,) of the medians (R, modes) of drives; a weight (R, modes) is zero where there is none.

    >>> medians = np.array([[10.0], [-20.0], [40.0]]) + [1.0, 2.0, 3.0]
    >>> np.round(without_days(medians, np.ones((3, 3))), 3).tolist()
    [11.0, 12.0, 13.0]
    >>> np.round(without_days(medians, np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]])), 3).tolist()
    [11.0, 12.0, 13.0]
    """
    drives, modes = medians.shape
    drive, mode = np.nonzero(weight)
    terms = np.zeros((len(drive) + drives, modes + drives))
    terms[np.arange(len(drive)), mode] = terms[np.arange(len(drive)), modes + drive] = weight[drive, mode]
    terms[len(drive) :, modes:] = TOWARDS_ZERO * np.eye(drives)
    values = np.concatenate([(weight * medians)[drive, mode], np.zeros(drives)])
    return np.asarray(np.linalg.lstsq(terms, values, rcond=None)[0][:modes])


def left_out_offset(vehicle: Vehicle, index: int, stand_ins: Sequence[int], otherwise: Array) -> Array:
    """What the vehicle's other drives say of its offsets (T, modes), `otherwise` where they say nothing."""
    others = vehicle.without(index).drives
    return offsets(others, stand_ins, otherwise) if others else otherwise


def moved(s: Seen, by: Array) -> Seen:
    """The same recording with its residuals moved by (T, modes)."""
    return replace(s, r=s.r + by.T[s.mode])


def pooled(vehicles: Sequence[Vehicle], to: Array, stand_ins: Sequence[int]) -> list[Seen]:
    """All drives, those of each vehicle moved such that their own offsets are `to` (T, modes)."""
    found: list[Seen] = []
    for vehicle in vehicles:
        by = to - offsets(vehicle.drives, stand_ins, to)
        found += [moved(drive.seen, by) for drive in vehicle.drives]
    return found


def pooled_left_out(vehicles: Sequence[Vehicle], to: Array, stand_ins: Sequence[int]) -> list[Seen]:
    """The same, each drive moved by what the other drives of its vehicle say: what differs from drive to drive stays.

    A vehicle's only drive is moved by what it says itself.
    """
    found: list[Seen] = []
    for vehicle in vehicles:
        own = offsets(vehicle.drives, stand_ins, to)
        for index, drive in enumerate(vehicle.drives):
            found.append(moved(drive.seen, to - left_out_offset(vehicle, index, stand_ins, own)))
    return found

"""What networks are trained on: the samples of recordings, as the vehicle's own sampler sees them at its ticks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.provenance import check_id, check_vehicle
from faultline.analysis.model import Model
from faultline.analysis.recordings.observe import Blind, open_for, ticks_of
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Input
from faultline.service.core.residuals.observer import Tick
from faultline.training.phases import starts

Array = npt.NDArray[np.float64]

LEAST = 150
"""Ticks of a stretch: its beginning is for the states to settle."""

ENOUGH = 600
"""Ticks of all stretches: with less, a network knows a few operating points by heart."""

MOVES = 3
"""Distinct values that a signal must have, or changes in one stretch: of two values it may be a switch, thrown once."""


@dataclass(frozen=True)
class Stretch:
    """Ticks in a row in which every signal was usable and in its operating region: samples `z` (K, nz).

    `begin_s` is the log time of the first. They are `natural` where messages came as they were recorded.
    """

    recording: str
    z: Array
    begin_s: float
    natural: bool = True


@dataclass(frozen=True)
class Samples:
    """The stretches of some recordings, with the SHA-256 of their drives (`Log.drive`); columns are `signals`.

    The `seconds` of the recordings are there once for each start (`training.phases`).
    """

    signals: tuple[str, ...]
    stretches: tuple[Stretch, ...]
    digests: tuple[str, ...]
    vehicle: str | None
    seconds: float


def load_samples(
    model: Model, inputs: Sequence[Input], recordings: Sequence[Path], say: Callable[[str], None]
) -> Samples:
    """The samples of fault-free recordings.

    Raises:
        InputError: a recording is none, is named twice or is of another vehicle than the rest; a signal never moves;
            there is too little.
    """
    units = {channel.signal: channel.unit for channel in inputs}
    stretches: list[Stretch] = []
    digests: list[str] = []
    vehicle: str | None = None
    seconds = 0.0
    for path in recordings:
        log = open_for(model, path, say)
        if log.drive in digests:
            raise InputError(f"{path}: this recording is named twice; name it once")
        check_id(log, path, (stretch.recording for stretch in stretches))
        if vehicle is not None:
            check_vehicle(log, path, vehicle, f"{recordings[0]}")
        vehicle = log.recording.vehicle if log.recording else vehicle
        table = log.table(units, str(path))
        found: list[Stretch] = []
        count = 0
        for start in starts(log.signals(table)):
            count += 1
            ticks = ticks_of(model, inputs, start, Blind())
            found += [Stretch(log.id, z, begin_s, start.natural) for begin_s, z in _stretches(ticks, inputs)]
        kept = model.period_s * sum(len(stretch.z) for stretch in found) / max(count, 1)
        seconds += kept
        say(f"{log.id}: {kept:.0f} s, seen from {count} starts of the vehicle")
        stretches += found
        digests.append(log.drive)
    signals = tuple(channel.signal for channel in inputs)
    samples = Samples(signals, tuple(stretches), tuple(digests), vehicle, seconds)
    _check(samples, recordings, model.period_s)
    return samples


def _stretches(ticks: Sequence[Tick], inputs: Sequence[Input]) -> list[tuple[float, Array]]:
    """Runs of ticks that are usable and in the operating region, of `LEAST` at least, with where they begin."""
    if not ticks:
        return []
    values, usable = np.array([tick.z for tick in ticks]), np.array([tick.usable for tick in ticks])
    lower, upper = (np.array([getattr(channel, name) for channel in inputs]) for name in ("lower", "upper"))
    good = usable.all(axis=1) & ((values >= lower) & (values <= upper)).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(np.int8)))
    runs = zip(edges[::2], edges[1::2], strict=True)
    return [(ticks[begin].t_s, values[begin:end]) for begin, end in runs if end - begin >= LEAST]


def _check(samples: Samples, recordings: Sequence[Path], period_s: float) -> None:
    names = ", ".join(str(path) for path in recordings)
    enough_s = ENOUGH * period_s
    if samples.seconds < enough_s:
        raise InputError(
            f"{names}: {samples.seconds:.0f} s in which all signals can be used and are in their operating region, in "
            f"pieces of at least {LEAST * period_s:g} s; {enough_s - samples.seconds:.0f} s more are needed, "
            f"{5 * enough_s:g} s are better"
        )
    z = np.concatenate([stretch.z for stretch in samples.stretches])
    for column, signal in enumerate(samples.signals):
        changes = max(np.count_nonzero(np.diff(stretch.z[:, column])) for stretch in samples.stretches)
        if len(np.unique(z[:, column])) < MOVES and changes < MOVES:
            raise InputError(
                f"{names}: {signal} hardly moves ({z[0, column]:g}): a sensor that is stuck, or an input that was "
                "held; record a cycle that moves it"
            )

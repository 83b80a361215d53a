"""Detectors from fault-free recordings that calibration has not seen.

A residual is standardised by the median and the spread of its mode. The drift nu of its CUSUM covers what lasts: the
largest mean over 15 s that any recording shows, of either sign, plus an allowance, because a constant bias above nu
crosses every threshold in the end. J is then a multiple of the largest sum reached, and never below `MINIMUM_J`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from service.core.cusum import Cusum
from service.core.errors import InputError
from service.core.manifest import MODES, Detector
from service.core.observer import Tick

Array = npt.NDArray[np.float64]

MINIMUM_TICKS = 50  # of a mode, over all recordings
LASTING_TICKS = 75  # 15 s
ALLOWANCE = 0.25  # of the mode's spread, on top of what lasted in the tuning recordings
MARGIN = 1.5  # J over the largest sum seen: a detector is to suspect, a window confirms
MINIMUM_J = 15.0
OWN = tuple(range(len(MODES)))  # every mode is described by its own ticks


@dataclass(frozen=True)
class Seen:
    """A recording through the generators: samples (K, nz), residuals (K, T), whether usable (K, T), mode (K,)."""

    name: str
    z: Array
    r: Array
    usable: npt.NDArray[np.bool_]
    mode: npt.NDArray[np.int64]

    def only(self, count: int) -> "Seen":
        """With the first `count` generators alone."""
        return replace(self, r=self.r[:, :count], usable=self.usable[:, :count])


def seen(name: str, ticks: Sequence[Tick]) -> Seen:
    """What tuning needs of a recording: the ticks with every input usable.

    Raises:
        InputError: some test could tell for less than 15 s of it.
    """
    ticks = [tick for tick in ticks if tick.usable.all()]
    usable = np.array([tick.residuals.usable for tick in ticks])
    told = int(usable.sum(axis=0).min()) if ticks else 0
    if told < LASTING_TICKS:
        raise InputError(
            f"{name}: some test could tell for {told} ticks only, {LASTING_TICKS} are needed; "
            "tune on minutes with all signals, within their operating ranges"
        )
    return Seen(
        name=name,
        z=np.array([tick.z for tick in ticks]),
        r=np.array([tick.residuals.r for tick in ticks]),
        usable=usable,
        mode=np.array([tick.mode for tick in ticks]),
    )


def tune_detectors(
    generators: Sequence[str], recordings: Sequence[Seen], floor: Array, stand_ins: Sequence[int] = OWN
) -> list[Detector]:
    """A detector for each generator; `floor` (T,) is the spread that the sensors alone give.

    Mode m is described by the ticks of mode `stand_ins[m]` (see `analysis.recordings.modes`).

    Raises:
        InputError: an operating mode was hardly visited: its residuals are unknown, and unknown is not zero.
    """
    return [_detector(name, row, recordings, float(floor[row]), stand_ins) for row, name in enumerate(generators)]


def _detector(name: str, row: int, recordings: Sequence[Seen], floor: float, stand_ins: Sequence[int]) -> Detector:
    offset, scale = [], []
    for mode in stand_ins:
        r = np.concatenate([s.r[s.usable[:, row] & (s.mode == mode), row] for s in recordings])
        if len(r) < MINIMUM_TICKS:
            raise InputError(
                f"tuning data ({', '.join(s.name for s in recordings)}): {name} saw mode {MODES[mode]!r} "
                f"for {len(r)} ticks only; add a fault-free recording that stays in it"
            )
        centre = float(np.median(r))
        offset.append(centre)
        scale.append(max(float(1.4826 * np.median(np.abs(r - centre))), floor / 2))
    centres, scales = np.array(offset), np.array(scale)
    runs = []
    for s in recordings:
        use = s.usable[:, row]
        runs.append((s.r[use, row] - centres[s.mode[use]]) / scales[s.mode[use]])
    nu = ALLOWANCE + max(_largest_lasting(run) for run in runs)
    J = max(MINIMUM_J, MARGIN * max(_largest_sum(run, nu) for run in runs))
    return Detector(generator=name, offset=offset, scale=scale, nu=nu, J=J)


def _largest_lasting(s: Array) -> float:
    """The largest absolute mean over `LASTING_TICKS` in a row."""
    sums = np.concatenate([[0.0], np.cumsum(s)])
    return float(np.abs(sums[LASTING_TICKS:] - sums[:-LASTING_TICKS]).max() / LASTING_TICKS)


def _largest_sum(s: Array, nu: float) -> float:
    cusum = Cusum(nu, np.inf)
    largest = 0.0
    for tick, value in enumerate(s):
        cusum.update(tick, float(value))
        largest = max(largest, cusum.value)
    return largest

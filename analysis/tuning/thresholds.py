"""Detectors from fault-free recordings that calibration has not seen.

A residual is standardised by the median and the spread of its mode. The drift nu of its CUSUM covers what lasts: the
largest mean over three quarters of a settling time that any recording shows, of either sign, plus an allowance, because
a constant bias above nu crosses every threshold in the end. J is then a multiple of the largest sum reached, and never
below a minimum. The thresholds of other kinds are set in the same way, from what they compare.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np
import numpy.typing as npt

from faultline.analysis.tuning.kinds import LEAST, Described, Kind, Run, closed, opened, reached, unrest
from faultline.service.core.detectors.kinds import kind_of
from faultline.service.core.detectors.spread import LARGEST
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Detector
from faultline.service.core.residuals.observer import Tick
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.signals.values import Quality
from faultline.service.core.time_scale import TimeScale

Array = npt.NDArray[np.float64]

TOLD_TICKS = 75  # in which a test of a recording can tell
MINIMUM_TICKS = 50  # of a mode, over all recordings
WHY: Mapping[Quality, str] = {
    Quality.MISSING: "has not come yet",
    Quality.LATE: "is older than its maximum_age_s",
    Quality.DOUBTED: "is sent by two, or more often than its DBC's cycle time says",
    Quality.OUT_OF_RANGE: "is out of its range in the DBC",
    Quality.NOT_AVAILABLE: "is not available, as its sender says",
    Quality.ERROR: "is at fault, as its sender says",
}
"""Reasons why a test cannot tell, by the quality of a sample."""
MARGIN = 1.5  # J over the largest sum seen: a detector is to suspect, a window confirms


@dataclass(frozen=True)
class Seen:
    """A recording through the generators: samples (K, nz), residuals (K, T), whether usable (K, T), mode (K,).

    `modes` are the names of the modes, `time` is that of the ticks.
    `sigma` (K, T) is the generators' own spread; only adaptive detectors need it. `level` (K, T) are the residuals
    without the day, once that has been taken off. `number` (K,) are those of the ticks, where not all are there.
    """

    name: str
    z: Array
    r: Array
    usable: npt.NDArray[np.bool_]
    mode: npt.NDArray[np.int64]
    modes: tuple[str, ...]
    time: TimeScale
    sigma: Array | None = None
    level: Array | None = None
    number: npt.NDArray[np.int64] | None = None

    @property
    def ticks(self) -> npt.NDArray[np.int64]:
        """The numbers (K,) of the ticks: where some are missing, one is no neighbour of the next."""
        return np.arange(len(self.mode)) if self.number is None else self.number

    def only(self, count: int) -> "Seen":
        """With the first `count` generators alone."""
        sigma, level = (None if each is None else each[:, :count] for each in (self.sigma, self.level))
        return replace(self, r=self.r[:, :count], usable=self.usable[:, :count], sigma=sigma, level=level)

    def tested(self, kind: str) -> Array:
        """The residuals (K, T) that a kind of detector tests: a test of the variance those of the tick."""
        return self.r if self.level is None or kind == "spread" else self.level

    def inside(self, row: int, mode: int) -> npt.NDArray[np.bool_]:
        """The ticks (K,) of a mode at which a generator could tell."""
        return np.asarray(self.usable[:, row] & (self.mode == mode))

    def visits(self, mode: int) -> Iterator[npt.NDArray[np.int64]]:
        """Yield the rows (n,) of every stay in a mode at which all generators could tell."""
        inside = np.flatnonzero(self.usable.all(axis=1) & (self.mode == mode))
        for visit in np.split(inside, np.flatnonzero(np.diff(self.ticks[inside]) > 1) + 1):
            if len(visit):
                yield visit


def more_of(mode: int) -> str:
    """What a drive does to show more of a mode; nothing stays at an edge."""
    return "with more steps of the inputs, or lower those of [edges]" if mode == EDGE else "that stays in it"


def seen(name: str, ticks: Sequence[Tick], signals: Sequence[str], modes: tuple[str, ...], time: TimeScale) -> Seen:
    """Return what tuning needs of a recording: the ticks at which all inputs (nz,), the `signals`, are usable.

    Raises:
        InputError: some test could tell for too little of it.
    """
    every, ticks = ticks, [tick for tick in ticks if tick.usable.all()]
    usable = np.array([tick.residuals.counted for tick in ticks])
    told = int(usable.sum(axis=0).min()) if ticks else 0
    if told < TOLD_TICKS:
        raise InputError(
            f"{name}: some test could tell for {told} ticks only, {TOLD_TICKS} are needed; {_why(every, signals)}"
            "tune on minutes with all signals, within their operating ranges"
        )
    return Seen(
        name=name,
        z=np.array([tick.z for tick in ticks]),
        r=np.array([tick.residuals.r for tick in ticks]),
        usable=usable,
        mode=np.array([tick.mode for tick in ticks]),
        modes=modes,
        time=time,
        sigma=np.array([tick.residuals.sigma for tick in ticks]),
        number=np.array([tick.number for tick in ticks]),
    )


def _why(ticks: Sequence[Tick], signals: Sequence[str]) -> str:
    """Return the most frequent hindrance: a signal not usable for more than half of the recording, and its quality."""
    kinds = list(WHY)
    counts = np.array(
        [[np.sum([tick.quality[k] == kind for tick in ticks]) for kind in kinds] for k in range(len(signals))]
    )
    if not counts.size or counts.max() <= len(ticks) / 2:
        return ""
    signal, kind = np.unravel_index(int(counts.argmax()), counts.shape)
    return f"for {100 * counts.max() / len(ticks):.0f} % of it {signals[int(signal)]} {WHY[kinds[int(kind)]]}; "


def tune_detectors(
    generators: Sequence[str],
    recordings: Sequence[Seen],
    floor: Array,
    stand_ins: Sequence[int],
    kinds: Sequence[Kind] = ("cusum",),
    offset: Array | None = None,
) -> list[Detector]:
    """Detectors for each generator; `floor` (T,) is the spread that the sensors alone give.

    Mode m is described by the ticks of mode `stand_ins[m]` (see `analysis.recordings.modes`). `offset` (T, modes) is
    known where the recordings have been centred on it, and else their median. The detectors of the first kind come
    first, one for each generator, as a manifest has them.

    Raises:
        InputError: an operating mode was hardly visited: its residuals are unknown, and unknown is not zero.
    """
    time = recordings[0].time
    found: list[list[Detector]] = []
    for name in generators:
        row = len(found)
        known = None if offset is None else offset[row]
        found.append([])
        for kind in kinds:
            described = describe(name, row, recordings, float(floor[row]), stand_ins, kind, known)
            runs = [standard(s, row, described, kind) for s in recordings]
            for detector in opened(kind, described, runs, time):
                largest = max(float(reached(detector, run, time.period_s).max()) for run in runs)
                found[row].append(
                    closed(detector, max(LEAST[kind_of(detector)] * unrest(kind, runs), MARGIN * largest))
                )
    return in_order(found)


def in_order(of_generators: Sequence[Sequence[Detector]]) -> list[Detector]:
    """All the generators' first detectors, then all their second ones, and so on."""
    return [each for rank in zip_longest(*of_generators) for each in rank if each is not None]


def edge_last(stand_ins: Sequence[int]) -> list[tuple[int, int]]:
    """Every mode with what describes it, the edge last: what is missing is told of a mode that can be held, if any."""
    return sorted(enumerate(stand_ins), key=lambda each: each[0] == EDGE)


def describe(
    name: str,
    row: int,
    recordings: Sequence[Seen],
    floor: float,
    stand_ins: Sequence[int],
    kind: Kind,
    offset: Array | None = None,
) -> Described:
    """A generator without a fault, as a kind of detector needs it.

    Raises:
        InputError: an operating mode was hardly visited.
    """
    count = len(stand_ins)
    centres, scales, usual = np.zeros(count), np.zeros(count), np.ones(count)
    for mode, stand_in in edge_last(stand_ins):
        inside = [s.inside(row, stand_in) for s in recordings]
        r = np.concatenate([s.tested(kind)[use, row] for s, use in zip(recordings, inside, strict=True)])
        if len(r) < MINIMUM_TICKS:
            raise InputError(
                f"tuning data ({', '.join(s.name for s in recordings)}): {name} saw mode "
                f"{recordings[0].modes[stand_in]!r} for {len(r)} ticks only; add a fault-free "
                f"recording {more_of(stand_in)}"
            )
        sigma = np.concatenate([_sigma(s, row)[use] for s, use in zip(recordings, inside, strict=True)])
        centres[mode] = float(np.median(r)) if offset is None else offset[mode]
        usual[mode] = float(np.median(sigma))
        away = r - centres[mode]
        if kind == "adaptive":
            away = away * usual[mode] / sigma
        if kind == "spread":
            away = np.concatenate([_steps(s, row, use) for s, use in zip(recordings, inside, strict=True)])
        scales[mode] = max(_spread_of(away, kind), floor / 2)
    return Described(name, centres, scales, usual)


def standard(s: Seen, row: int, described: Described, kind: str) -> Run:
    """The standardised residual of a generator, where it could tell."""
    use, mode = s.usable[:, row], s.mode[s.usable[:, row]]
    spread = described.scale[mode]
    if kind == "adaptive":
        spread = spread * _sigma(s, row)[use] / described.usual[mode]
    return Run(s.ticks[use], (s.tested(kind)[use, row] - described.offset[mode]) / spread)


def _sigma(s: Seen, row: int) -> Array:
    return np.ones(len(s.r)) if s.sigma is None else s.sigma[:, row]


def _steps(s: Seen, row: int, use: npt.NDArray[np.bool_]) -> Array:
    """Differences from one tick to the next within a mode, with the variance of r."""
    steps: Array = np.diff(s.r[:, row])[use[1:] & use[:-1] & (np.diff(s.ticks) == 1)] / np.sqrt(2.0)
    return steps


def _spread_of(away: Array, kind: Kind) -> float:
    """The robust spread of deviations; that of a variance test such that its variance has no bias."""
    if not len(away):
        return 0.0
    spread = float(1.4826 * np.median(np.abs(away)))
    if kind != "spread" or spread == 0.0:
        return spread
    return spread * float(np.sqrt(np.minimum((away / spread) ** 2, LARGEST).mean()))

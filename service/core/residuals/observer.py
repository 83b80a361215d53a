"""Observation of every tick: samples, operating mode, residuals; the front half of the monitor.

Tick k is at t_k = k Ts of log time after tick 0, which is `PHASE_S` after the first frame with which all signals are
known, or `start_within_s` after the first frame where a signal never appears. Calibration and tuning look through this
same object.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil
from typing import NamedTuple, Protocol

import numpy as np

from faultline.service.core.residuals.evaluator import Evaluator
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.holding import Samples
from faultline.service.core.signals.received import Received
from faultline.service.core.signals.sampling import Sampler
from faultline.service.core.signals.values import FloatArray, Indices, Mask, Qualities, Quality, are_good

PHASE_S = 0.045
"""How far the ticks stay off the grid of the frame that starts them [s]: 5 ms from frames every 10 ms, 45 from those
every 100 ms. On the grid, a bus's jitter would decide at every tick whether its newest frame is seen."""

BLOCK = 4096
"""Ticks whose samples are computed at once, of a piece of a log."""


class Tick(NamedTuple):
    """One tick: number, log time [s], samples (nz,), what each is worth (nz,), mode (of `MODES`), residuals.

    `ages` (nz,) are the times since the samples' frames [s], NaN where there is none.
    """

    number: int
    t_s: float
    z: FloatArray
    quality: Qualities
    mode: int
    residuals: Residuals
    ages: FloatArray

    @property
    def usable(self) -> Mask:
        """Return True for each sample that may be used (nz,)."""
        return are_good(self.quality)


@dataclass(frozen=True, slots=True)
class Ticks:
    """Ticks in a row: the `first` one's number, and what `Tick` has of each of the n, the ticks first."""

    first: int
    t_s: FloatArray
    z: FloatArray
    quality: Qualities
    modes: Indices
    residuals: Residuals
    ages: FloatArray

    def __len__(self) -> int:
        """Return how many they are."""
        return len(self.t_s)

    def __iter__(self) -> Iterator[Tick]:
        """Yield one after the other."""
        return map(self.at, range(len(self)))

    def at(self, k: int) -> Tick:
        """Return one of them."""
        residuals = self.residuals.at(k)
        return Tick(
            self.first + k, float(self.t_s[k]), self.z[k], self.quality[k], int(self.modes[k]), residuals, self.ages[k]
        )

    def part(self, begin: int, end: int) -> "Ticks":
        """Return some of them."""
        if begin == 0 and end >= len(self):
            return self
        row = slice(begin, end)
        return Ticks(
            self.first + begin,
            self.t_s[row],
            self.z[row],
            self.quality[row],
            self.modes[row],
            self.residuals.part(begin, end),
            self.ages[row],
        )


class Decoder(Protocol):
    """Interface of a decoder of frames."""

    def decode(
        self, can_id: int, is_extended: bool, data: bytes, t: float | None = None
    ) -> list[tuple[str, float, Quality]]:
        """Name, value and quality of every wanted signal in a frame that came at log time `t` [s]."""

    def of_bus(self, name: str) -> "Decoder":
        """Return the decoder of another bus."""


class Observer:
    """Frames and the clock in, ticks out. The clock is an argument."""

    def __init__(
        self,
        table: Decoder,
        sampler: Sampler,
        evaluator: Evaluator,
        period_s: float,
        start_within_s: float,
    ) -> None:
        self._table = table
        self._sampler = sampler
        self._evaluator = evaluator
        self._period = period_s
        self._start_within = start_within_s
        self._first: float | None = None  # log time of the first frame
        self._origin: float | None = None  # log time of tick 0
        self._now = -np.inf
        self._number = 0
        self._due = np.inf  # log time of the next tick

    def frame(self, t_s: float, can_id: int, is_extended: bool, data: bytes, bus: str = "") -> list[Ticks]:
        """Take a frame received at log time `t_s` [s] on a bus; return the ticks that lie before it.

        A time before an earlier one is taken as that earlier one.
        """
        t = max(t_s, self._now)
        ticks = self._run(t, including=False) if self._due < t else []
        self._now = t
        if self._first is None:
            self._first, self._due = t, t + self._start_within
        table = self._table.of_bus(bus) if bus else self._table
        for signal, value, quality in table.decode(can_id, is_extended, data, t):
            self._sampler.receive(signal, t, value, quality)
        if self._origin is None and self._sampler.complete:
            self._origin = self._due = t + PHASE_S
        return ticks

    def take(self, received: Received) -> Iterator[Ticks]:
        """Take a piece of a log; yield the ticks before its last frame, as `frame` does for each of its frames.

        A doubt is the sampler's before the tick at which the frame that raised it would have been taken: the first of
        a row.
        """
        samples = Samples(self._sampler.inputs, received)
        if self._first is None:
            self._first, self._due = received.first_s, received.first_s + self._start_within
        if self._origin is None and samples.complete_s is not None and not self._due < samples.complete_s:
            self._origin = self._due = samples.complete_s + PHASE_S
        doubts = deque(samples.doubts)
        while len(dues := self._dues(received.last_s)):
            for row in self._ticks(dues, *samples.at(dues), samples.ages(dues)):
                begin = 0
                while doubts and doubts[0].t <= row.t_s[-1]:
                    at = int(np.searchsorted(row.t_s, doubts[0].t))
                    if at > begin:
                        yield row.part(begin, at)
                        begin = at
                    self._sampler.note_doubt(*doubts.popleft()[1:])
                yield row.part(begin, len(row)) if begin else row
        for doubt in doubts:
            self._sampler.note_doubt(*doubt[1:])
        self._now = received.last_s

    def _dues(self, before: float) -> FloatArray:
        """Times of the next ticks (n,) [s] before this one, of so many at most as are computed at once."""
        if not self._due < before:
            return np.zeros(0)
        origin = self._due if self._origin is None else self._origin
        dues = origin + np.arange(self._number, self._number + BLOCK, dtype=np.float64) * self._period
        return np.asarray(dues[dues < before], dtype=np.float64)

    def advance(self, t_s: float) -> list[Ticks]:
        """Advance to time `t_s` [s]; return every tick up to and at it, frames or no frames."""
        self._now = max(self._now, t_s)
        return self._run(self._now, including=True)

    @property
    def now(self) -> float:
        """Latest log time that was given [s]."""
        return self._now

    @property
    def origin_s(self) -> float | None:
        """Log time of tick 0 [s]; None before it is known."""
        return self._origin

    @property
    def next_tick_s(self) -> float | None:
        """Log time of the next tick [s], None before the first frame."""
        return None if self._first is None else self._due

    def tick_at(self, t_s: float) -> int:
        """Return the first tick that has seen what came at log time `t_s` [s]."""
        return 0 if self._origin is None else max(0, ceil((t_s - self._origin) / self._period))

    def _run(self, t: float, including: bool) -> list[Ticks]:
        ticks: list[Ticks] = []
        while self._due < t or (including and self._due == t):
            z, quality = self._sampler.sample(self._due)
            ticks += self._ticks(np.array([self._due]), z[None], quality[None], self._sampler.ages(self._due)[None])
        return ticks

    def _ticks(self, dues: FloatArray, z: FloatArray, quality: Qualities, ages: FloatArray) -> Iterator[Ticks]:
        """The ticks at `dues` (n,) [s], of samples, qualities and ages (n, nz)."""
        if self._origin is None:
            self._origin = float(dues[0])
        begin = 0
        for modes, residuals in self._evaluator.evaluate(z, are_good(quality), ages):
            row = slice(begin, begin + len(modes))
            ticks = Ticks(self._number, dues[row], z[row], quality[row], modes, residuals, ages[row])
            begin = row.stop
            self._number += len(modes)
            self._due = self._origin + self._number * self._period
            yield ticks

"""What is seen at every tick: samples, operating mode, residuals; the front half of the monitor.

Tick k is at t_k = k Ts of log time after tick 0, which is `PHASE_S` after the first frame with which all signals are
known, or `start_within_s` after the first frame where a signal never appears. Calibration and tuning look through this
same object.
"""

from math import ceil
from typing import NamedTuple, Protocol

import numpy as np

from faultline.service.core.residuals.generators import Generators, Residuals
from faultline.service.core.signals.modes import ModeTracker
from faultline.service.core.signals.sampling import Sampler
from faultline.service.core.signals.values import FloatArray, Mask, Qualities, Quality

PHASE_S = 0.045
"""How far the ticks stay off the grid of the frame that starts them [s]: 5 ms from frames every 10 ms, 45 from those
every 100 ms. On the grid, a bus's jitter would decide at every tick whether its newest frame is seen."""


class Tick(NamedTuple):
    """One tick: number, log time [s], samples (nz,), what each is worth (nz,), mode (of `MODES`), residuals."""

    number: int
    t_s: float
    z: FloatArray
    quality: Qualities
    mode: int
    residuals: Residuals

    @property
    def usable(self) -> Mask:
        """Whether each sample may be used (nz,)."""
        return np.asarray(self.quality == Quality.GOOD)


class Decoder(Protocol):
    """What frames mean."""

    def decode(
        self, can_id: int, is_extended: bool, data: bytes, t: float | None = None
    ) -> list[tuple[str, float, Quality]]:
        """Name, value and quality of every wanted signal in a frame that came at log time `t` [s]."""


class Observer:
    """Frames and the clock in, ticks out. The clock is an argument."""

    def __init__(
        self,
        table: Decoder,
        sampler: Sampler,
        modes: ModeTracker,
        bank: Generators,
        period_s: float,
        start_within_s: float,
    ) -> None:
        self._table = table
        self._sampler = sampler
        self._modes = modes
        self._bank = bank
        self._period = period_s
        self._start_within = start_within_s
        self._first: float | None = None  # log time of the first frame
        self._origin: float | None = None  # log time of tick 0
        self._now = -np.inf
        self._number = 0

    def frame(self, t_s: float, can_id: int, is_extended: bool, data: bytes) -> list[Tick]:
        """Takes a frame received at log time `t_s` [s]; gives the ticks that lie before it.

        A time before an earlier one is taken as that earlier one.
        """
        t = max(t_s, self._now)
        ticks = self._run(t, including=False)
        self._now = t
        if self._first is None:
            self._first = t
        for signal, value, quality in self._table.decode(can_id, is_extended, data, t):
            self._sampler.receive(signal, t, value, quality)
        if self._origin is None and self._sampler.complete:
            self._origin = t + PHASE_S
        return ticks

    def advance(self, t_s: float) -> list[Tick]:
        """The clock says `t_s` [s]: gives every tick up to and at it, frames or no frames."""
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
        if self._first is None:
            return None
        if self._origin is None:
            return self._first + self._start_within
        return self._origin + self._number * self._period

    def tick_at(self, t_s: float) -> int:
        """Return the first tick that has seen what came at log time `t_s` [s]."""
        return 0 if self._origin is None else max(0, ceil((t_s - self._origin) / self._period))

    def _run(self, t: float, including: bool) -> list[Tick]:
        ticks: list[Tick] = []
        while (due := self.next_tick_s) is not None and (due < t or (including and due == t)):
            if self._origin is None:
                self._origin = due
            z, quality = self._sampler.sample(due)
            usable = quality == Quality.GOOD
            mode = self._modes.update(z, usable)
            ticks.append(Tick(self._number, due, z, quality, mode, self._bank.step(z, usable)))
            self._number += 1
        return ticks

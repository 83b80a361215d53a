"""The threshold test on the residual behind a first-order low-pass filter (thesis eq. 2.2).

    y <- y + (s - y) / tau        tau: time constant in ticks; alarm where |y| > J

The filtered residual is bounded by 2 J, so that a large fault that has ended is over as soon as a small one.
"""

from faultline.service.core.detectors.threshold import Threshold


class LowPass(Threshold):
    """A threshold test on the filtered residual."""

    def __init__(self, J: float, hold_ticks: int, time_ticks: float) -> None:
        super().__init__(J, hold_ticks)
        self._part = 1.0 / time_ticks
        self._bound = 2.0 * J
        self._filtered = 0.0

    def update(self, tick: int, s: float) -> None:
        """Takes the standardised residual of a tick."""
        filtered = self._filtered + (s - self._filtered) * self._part
        self._filtered = min(self._bound, max(-self._bound, filtered))
        super().update(tick, self._filtered)

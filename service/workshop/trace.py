"""Samples of the cycle for pictures: as many as can be drawn, however long it takes."""

from typing import NamedTuple

from faultline.service.protocol.live import LiveTick

MOST = 1200
"""Samples that are kept: more than a printed page has room for."""


class Sample(NamedTuple):
    """Sample at `t_s` [s] of the cycle: the mode, the signals and predictions in their units, and the sums.

    A prediction or sum is None where its test could not tell, a signal where its value could not be used. Of several
    ticks a sample has the last values and the largest sums.
    """

    t_s: float
    mode: str
    z: list[float | None]
    y_hat: list[float | None]
    sums: list[float | None]


class Trace:
    """Samples, each of `stride` ticks; once there are too many, pairs become one."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self._stride = 1
        self._waiting: list[Sample] = []

    def add(self, t_s: float, tick: LiveTick) -> None:
        """Add a tick at `t_s` [s] of the cycle."""
        self._waiting.append(
            Sample(
                t_s,
                tick.mode,
                [value if quality == "good" else None for value, quality in zip(tick.z, tick.quality, strict=True)],
                [value if usable else None for value, usable in zip(tick.y_hat, tick.usable, strict=True)],
                [value if usable else None for value, usable in zip(tick.sums, tick.usable, strict=True)],
            )
        )
        if len(self._waiting) < self._stride:
            return
        self.samples.append(_one(self._waiting))
        self._waiting = []
        if len(self.samples) > MOST:
            self.samples = [_one(self.samples[k : k + 2]) for k in range(0, len(self.samples), 2)]
            self._stride *= 2


def _one(samples: list[Sample]) -> Sample:
    columns = zip(*(each.sums for each in samples), strict=True)
    return samples[-1]._replace(sums=[_largest(column) for column in columns])


def _largest(values: tuple[float | None, ...]) -> float | None:
    return max((value for value in values if value is not None), key=abs, default=None)

"""Common interface of all detectors."""

from typing import Protocol


class Detector(Protocol):
    """One test on one generator's residual.

    It is updated only while its generator can tell: otherwise it is frozen and its alarm stands. It holds a few
    numbers whatever it has seen, and it ends its alarm within bounded time once the residual is as without a fault.
    """

    @property
    def alarm(self) -> bool:
        """Return True if it alarms."""

    @property
    def since(self) -> int | None:
        """The tick at which the evidence of what it sees now began; None where there is none."""

    @property
    def value(self) -> float:
        """Return the statistic in parts of its threshold, at most 2: from 1 on it alarms, and until later it may."""

    @property
    def sign(self) -> int:
        """+1 where the residual has been too large (or too loud), -1 where too small (too quiet), 0 where neither."""

    def update(self, tick: int, s: float) -> None:
        """Takes the standardised residual of a tick, a finite number."""

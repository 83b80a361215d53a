"""The CUSUM test, two-sided or of one side (thesis eq. 2.3; Page 1954), bounded so that it can also end.

    g+ <- min(C, max(0, g+ + s - nu))        s: standardised residual, nu: drift, J: threshold, C = 2 J
    g- <- min(C, max(0, g- - s - nu))

It alarms when the larger sum reaches J and stays so until that sum is back at zero. One side is one of the two sums.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from faultline.service.core.manifest import CusumDetector, Side
from faultline.service.core.signals.values import FloatArray, Indices, Mask


class Cusum:
    """One residual's CUSUM. State: two sums, whether it alarms, and since which tick the sums have been above zero.

    A residual that moves from 0 to 2 at tick 100 is detected after J / (2 - nu) ticks, and its onset is remembered:

    >>> cusum = Cusum(nu=0.5, J=12.0)
    >>> for tick in range(200):
    ...     cusum.update(tick, 0.0 if tick < 100 else 2.0)
    ...     if cusum.alarm:
    ...         break
    >>> tick, cusum.since
    (107, 100)
    """

    def __init__(self, nu: float, J: float, side: Side = "both") -> None:
        self._nu = nu
        self._J = J
        self._side = side
        self._above = 0.0
        self._below = 0.0
        self.alarm = False
        self.since: int | None = None

    @property
    def value(self) -> float:
        """The larger sum in parts of J; the test alarms from 1 on."""
        return max(self._above, self._below) / self._J

    @property
    def sign(self) -> int:
        """+1 where the residual has been too large, -1 where too small, 0 where neither sum stands."""
        return (self._above > self._below) - (self._below > self._above)

    def update(self, tick: int, s: float) -> None:
        """Takes the standardised residual of a tick; not called (sums frozen) while the test cannot tell."""
        ceiling, above, below = 2 * self._J, self._above, self._below
        if self._side != "below":
            above = above + s - self._nu
            above = min(above, ceiling) if above > 0.0 else 0.0
        if self._side != "above":
            below = below - s - self._nu
            below = min(below, ceiling) if below > 0.0 else 0.0
        self._above, self._below = above, below
        largest = max(above, below)
        if largest == 0.0:
            self.alarm = False
            self.since = None
            return
        if self.since is None:
            self.since = tick
        self.alarm = self.alarm or largest >= self._J


class Ahead(NamedTuple):
    """What D CUSUMs come to in n ticks: both sums (n, 2, D), where one is not zero, and where one alarms (n, D)."""

    sums: FloatArray
    stands: Mask
    alarm: Mask


class Cusums:
    """D residuals' CUSUMs. State as that of `Cusum`: both sums (2, D), whether each alarms, and since when (D,).

    `ahead` looks at ticks in a row and `go` advances by some of them, so that who has to act at the tick of an alarm
    can stop before it.
    """

    def __init__(self, settings: Sequence[CusumDetector]) -> None:
        D = len(settings)
        self._nu = np.array([each.nu for each in settings])
        self._J = np.array([each.J for each in settings])
        self._ceiling = 2 * self._J
        tested = [[each.side != side for each in settings] for side in ("below", "above")]
        self._tested = np.array(tested, dtype=np.bool_).reshape(2, D)
        self._all_tested = bool(self._tested.all())
        self._sums = np.zeros((2, D))
        self._since = np.full(D, -1)  # no tick
        self.alarm, self._some_alarm = np.zeros(D, dtype=np.bool_), False

    def ahead(self, s: FloatArray, counted: Mask) -> Ahead:
        """Return what n ticks with the standardised residuals (n, D) come to; a sum is frozen where one is not counted.

        The operations and their order are those of `Cusum`, so that the numbers are.
        """
        sums = self._sums_ahead(s, counted)
        largest = np.maximum(sums[:, 0], sums[:, 1])
        stands = largest > 0.0
        return Ahead(sums, stands, self._alarms(stands, largest >= self._J))

    def _sums_ahead(self, s: FloatArray, counted: Mask) -> FloatArray:
        all_move = self._all_tested and counted.all()
        stays = None if all_move else ~(counted[:, None] & self._tested)
        sums = np.empty((len(s), *self._sums.shape))
        sums[:, 0] = s if all_move else np.where(counted, s, 0.0)
        np.negative(sums[:, 0], out=sums[:, 1])
        before = self._sums
        for k, now in enumerate(sums):
            now += before
            now -= self._nu
            np.minimum(now, self._ceiling, out=now)
            np.maximum(now, 0.0, out=now)
            if stays is not None:
                np.copyto(now, before, where=stays[k])
            before = now
        return sums

    def _alarms(self, stands: Mask, reaches: Mask) -> Mask:
        """Return where there is an alarm (n, D): from where a sum `reaches` the threshold, as long as one `stands`."""
        if not self._some_alarm and not reaches.any():
            return reaches
        alarms, alarm = np.empty_like(reaches), self.alarm
        for k in range(len(alarms)):
            alarms[k] = alarm = (alarm | reaches[k]) & stands[k]
        return alarms

    def go(self, tick: int, ahead: Ahead, ticks: int) -> None:
        """Advance by so many of the ticks, of which the first is `tick`."""
        stands = ahead.stands[:ticks]
        began = np.where(self._since < 0, tick, self._since)
        if ticks > 1 and not stands.all():
            fallen = ticks - 1 - (~stands[::-1]).argmax(axis=0)  # the last tick without a sum
            began = np.where(stands.all(axis=0), began, tick + fallen + 1)
        self._since = np.where(stands[-1], began, -1)
        self._sums, self.alarm = ahead.sums[ticks - 1], ahead.alarm[ticks - 1]
        self._some_alarm = bool(self.alarm.any())

    @property
    def since(self) -> Indices:
        """Return since which tick each has had evidence (D,); -1 where it has none."""
        return self._since

    @property
    def signed(self) -> FloatArray:
        """Return the larger sum of each (D,) in parts of its threshold, with the sign of the residual."""
        above, below = self._sums
        return np.asarray(np.sign(above - below) * np.maximum(above, below) / self._J)

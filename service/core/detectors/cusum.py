"""The CUSUM test, two-sided or of one side (thesis eq. 2.3; Page 1954), bounded so that it can also end.

    g+ <- min(C, max(0, g+ + s - nu))        s: standardised residual, nu: drift, J: threshold, C = 2 J
    g- <- min(C, max(0, g- - s - nu))

It alarms when the larger sum reaches J and stays so until that sum is back at zero. One side is one of the two sums.
"""

from faultline.service.core.manifest import Side


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

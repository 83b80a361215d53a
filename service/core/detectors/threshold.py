"""The threshold test |s| > J on the residual of a tick (thesis eq. 2.1), held so that one alarm is one."""


class Threshold:
    """Alarms from |s| >= J on, until |s| has stayed below J for more than `hold_ticks` ticks.

    >>> threshold = Threshold(J=4.0, hold_ticks=2)
    >>> alarms = []
    >>> for tick, s in enumerate([0.0, -5.0, 0.0, 1.0, 0.0, 0.0]):
    ...     threshold.update(tick, s)
    ...     alarms.append(threshold.alarm)
    >>> alarms
    [False, True, True, True, False, False]
    """

    def __init__(self, J: float, hold_ticks: int) -> None:
        self._J = J
        self._hold = hold_ticks
        self._quiet = 0  # ticks below J in a row
        self.value = 0.0
        self.sign = 0
        self.alarm = False
        self.since: int | None = None

    def update(self, tick: int, s: float) -> None:
        """Takes the standardised residual of a tick; its evidence began where |s| last rose above J / 2."""
        self.value = min(abs(s) / self._J, 2.0)
        beyond = self.value >= 1.0
        self._quiet = 0 if beyond else self._quiet + 1
        self.alarm = beyond or (self.alarm and self._quiet <= self._hold)
        if beyond or not self.alarm:  # a held alarm keeps its sign
            self.sign = (s > 0) - (s < 0)
        if self.value > 0.5:
            self.since = tick if self.since is None else self.since
        elif not self.alarm:
            self.since = None

"""The debounce counter of one fault: how often it was seen, until that counts.

Source: AUTOSAR SWS Diagnostics R22-11, counter-based debouncing: SWS_DM_00018 (begins at 0), 00875 and 00876 (steps,
clamped), 00022 and 00023 (jumps to 0 where the direction changes), 00024 and 00025 (defective, healed), 00017 (the
fault detection counter as a linear map to -128..127), 00881 and 00882 (enable conditions freeze it, or reset it).
"""

from typing import Literal

Disabled = Literal["freeze", "reset"]
"""What becomes of the counter while the tests cannot tell."""


class Debounce:
    """Counts up to `failed` while the fault is seen, down to -`passed` while it is not; state: the counter.

    >>> counter = Debounce(failed=2, passed=1)
    >>> [counter.seen(True), counter.seen(True), counter.seen(False)]
    [None, 'failed', 'passed']
    """

    def __init__(self, failed: int, passed: int) -> None:
        self._failed, self._passed = failed, passed
        self.counter = 0

    def seen(self, is_there: bool) -> Literal["failed", "passed"] | None:
        """Takes one look; what is final with it."""
        if is_there:
            self.counter = min(max(self.counter, 0) + 1, self._failed)
            return "failed" if self.counter == self._failed else None
        self.counter = max(min(self.counter, 0) - 1, -self._passed)
        return "passed" if self.counter == -self._passed else None

    def disable(self, how: Disabled) -> None:
        """Handle a tick at which the tests cannot tell."""
        if how == "reset":
            self.counter = 0

    @property
    def fdc(self) -> int:
        """The fault detection counter: 127 is failed, -128 is passed."""
        if self.counter >= 0:
            return round(127 * self.counter / self._failed)
        return round(128 * self.counter / self._passed)

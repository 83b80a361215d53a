"""Progress of the steps: seconds in which tests could tell, counted by visits of a mode."""

from collections.abc import Sequence

from faultline.service.workshop.plan import Step

NEAR = 1e-6  # s, sums of tick lengths are not exact


class Progress:
    """Seconds of every step. State: the step that each mode fills, and the mode that is visited.

    A visit lasts until another mode is seen; an edge ends none. A visit fills one step at most: what is beyond is not
    the second look that the next one asks for. Short visits add up.
    """

    def __init__(self, steps: Sequence[Step]) -> None:
        self.steps = tuple(steps)
        self.seconds = [0.0] * len(self.steps)
        self._visited: str | None = None
        self._filling: int | None = None  # the step that this visit fills, or has filled

    def add(self, mode: str, seconds: float) -> bool:
        """Add time [s] that counts in `mode`, 0 if none does; return True if a step progressed."""
        if mode not in {step.mode for step in self.steps}:
            return False
        if mode != self._visited:
            self._visited, self._filling = mode, self._open_step(mode)
        if self._filling is None or self.is_done(self._filling) or seconds <= 0.0:
            return False
        self.seconds[self._filling] += min(seconds, self.left(self._filling))
        return True

    def is_done(self, k: int) -> bool:
        """Return True if step `k` was held for long enough."""
        return self.left(k) <= NEAR

    def left(self, k: int) -> float:
        """Return the seconds that step `k` still needs."""
        return self.steps[k].hold_s - self.seconds[k]

    @property
    def complete(self) -> bool:
        """Return True if all steps are done."""
        return all(self.is_done(k) for k in range(len(self.steps)))

    @property
    def next(self) -> int | None:
        """Return the step to ask for: the one under way, else the first that is not done; None if all are."""
        if self._filling is not None and not self.is_done(self._filling):
            return self._filling
        return next((k for k in range(len(self.steps)) if not self.is_done(k)), None)

    @property
    def must_leave(self) -> bool:
        """Return True if the step to ask for is a second visit of the present mode: another comes first."""
        k = self.next
        return k is not None and k != self._filling and self.steps[k].mode == self._visited

    def _open_step(self, mode: str) -> int | None:
        return next((k for k, step in enumerate(self.steps) if step.mode == mode and not self.is_done(k)), None)

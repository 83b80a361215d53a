"""Suspicion by the evidence: is what is seen unlike this day, or unlike any?

Some hypothesis may fit what has been seen of late better, on this day, than no fault does: something has changed,
though no detector's threshold is reached. Or one fits all that has been seen better than any day does: which is how a
fault tells that was there from the start, as far as no day looks like it.
"""

from collections.abc import Sequence

from service.core.day import Day
from service.core.detectors.bank import FROZEN_TICKS
from service.core.generators import Residuals
from service.core.hypotheses import Hypotheses
from service.core.manifest import Evidence
from service.core.signals import Vector
from service.core.straying import Level
from service.core.window import Window

CHANGED, SAME = 15.0, 10.0
"""How much better than none a fault must fit, on this day, what has been seen of late; and that it no longer does."""

UNLIKE = 30.0
"""And how much better than any day what has been seen since the start."""


class Unlike:
    """The day, and all that was seen at ticks at which nothing was suspected.

    Its alarm stands while what is seen of late is unlike this day; that of what is unlike any day stands until `rest`.
    Evidence that has been unable to tell for long says nothing of now: then the alarm ends by itself.
    """

    def __init__(self, evidence: Evidence, generators: Sequence[str], hypotheses: Hypotheses) -> None:
        self._rows = [generators.index(name) for name in evidence.generators]
        self._hypotheses = hypotheses
        self._day = Day(evidence)
        self._ever = Window(evidence, generators)
        self._unlike_any = False
        self._blind = 0  # ticks since any of the evidence could tell
        self.alarm = False

    @property
    def day(self) -> Level:
        """Where the day puts the means, as far as it is known."""
        return self._day.level

    def without_day(self, mode: int, residuals: Residuals) -> Vector:
        """The residuals (T,) of a tick as detectors of the level see them."""
        level = residuals.r.copy()
        level[self._rows] = self._day.taken_off(mode, residuals.r[self._rows])
        self._blind = 0 if residuals.usable[self._rows].any() else self._blind + 1
        if self._blind > FROZEN_TICKS:
            self.rest()
        return level

    def add(self, mode: int, residuals: Residuals, *, suspected: bool) -> None:
        """A tick, at which something is suspected already or not."""
        r, usable = residuals.r[self._rows], residuals.usable[self._rows]
        self._day.add(mode, r, usable, residuals.shift, suspected=suspected)
        if not suspected:
            self._ever.add(mode, residuals.r, residuals.usable, residuals.shift)

    def look(self) -> None:
        """Whether anything is unlike; asked now and then."""
        today = self._hypotheses.look(self._day.recent, self._day.level)
        ever = self._hypotheses.look(self._ever.means)
        self._unlike_any = self._unlike_any or (ever is not None and ever.gain > UNLIKE)
        gain = 0.0 if today is None else today.gain
        self.alarm = self._unlike_any or gain > CHANGED or (self.alarm and gain > SAME)

    def suspect(self) -> None:
        """Something is suspected: what was seen of late is not the day's; if it is the day that is, it is forgotten."""
        self._day.discard()
        if self._unlike_any:
            self._day.forget()

    def rest(self) -> None:
        """What was suspected is over, or was nothing."""
        self.alarm = self._unlike_any = False
        self._ever.clear()

"""Suspicion by the evidence: is what is seen unlike this day, or unlike any?

Some hypothesis may fit what has been seen of late better, on this day, than no fault does: something has changed,
though no detector's threshold is reached. Or one fits all that has been seen better than any day does: which is how a
fault tells that was there from the start, as far as no day looks like it.
"""

from collections.abc import Sequence

from faultline.service.core.decision.day import Day
from faultline.service.core.decision.hypotheses import Hypotheses
from faultline.service.core.decision.straying import Level, Means
from faultline.service.core.decision.window import Recent, Window
from faultline.service.core.detectors.bank import FROZEN
from faultline.service.core.manifest import Evidence
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.values import FloatArray
from faultline.service.core.time_scale import TimeScale

CHANGED, SAME = 15.0, 10.0
"""How much better than none a fault must fit, on this day, what has been seen of late; and that it no longer does."""

UNLIKE = 30.0
"""And how much better than any day what has been seen since the start."""


class Unlike:
    """The day, what was seen of late, and all that was seen while nothing was suspected.

    Its alarm stands while what is seen of late is unlike this day; that of what is unlike any day stands until `rest`.
    Evidence that has been unable to tell for long says nothing of now, nor is the day still known: all begins anew.
    """

    def __init__(self, evidence: Evidence, generators: Sequence[str], hypotheses: Hypotheses, time: TimeScale) -> None:
        self._frozen = time.ticks(FROZEN)
        self._rows = [generators.index(name) for name in evidence.generators]
        self._moved = [*self._rows, *(generators.index(f.generator) for f in evidence.followers)]
        self._hypotheses = hypotheses
        self._day = Day(evidence, time)
        self._recent, self._ever = Recent(evidence, generators, time), Window(evidence, generators, time)
        self._unlike_any = False
        self._blind = 0  # ticks since any of the evidence could tell
        self.alarm = False

    @property
    def day(self) -> Level:
        """Where the day puts the means, as far as it is known."""
        return self._day.level

    def without_day(self, mode: int, residuals: Residuals) -> FloatArray:
        """The residuals (T,) of a tick as detectors of the level see them; those of networks as they are."""
        level = residuals.r.copy()
        level[self._moved] = self._day.taken_off(mode, residuals.r[self._moved])
        return level

    def add(self, mode: int, residuals: Residuals, *, suspected: bool) -> None:
        """A tick, at which something is suspected already or not."""
        usable = residuals.usable[self._rows]
        self._recent.add(mode, residuals.r, residuals.usable, residuals.shift)
        if suspected or not usable.any():
            self._day.wait()
        else:
            self._day.add(mode, residuals.r[self._rows], usable)
            self._ever.add(mode, residuals.r, residuals.usable, residuals.shift)
        self._blind = 0 if usable.any() else self._blind + 1
        if self._blind == self._frozen:
            self._day.forget()
            self.rest()

    def look(self) -> None:
        """Whether anything is unlike; asked now and then."""
        ever = self._hypotheses.look(self._ever.means)
        if not self._unlike_any and ever is not None and ever.gain > UNLIKE:
            self._unlike_any = True
            self._day.forget()  # it is this day's usual that is suspected
        today = self._hypotheses.look(self._recent.means, self._day.level)
        gain = 0.0 if today is None else today.gain
        self.alarm = self._unlike_any or gain > CHANGED or (self.alarm and gain > SAME)

    def suspect(self) -> None:
        """Something is suspected: what was seen of late is not the day's."""
        self._day.discard()

    def accept(self, seen: Means) -> None:
        """What has been seen while something was suspected is the day's."""
        self._day.begin(seen)
        self.rest()

    def rest(self) -> None:
        """What was suspected is over, or was nothing."""
        self.alarm = self._unlike_any = False
        self._ever.clear()
        self._recent.clear()

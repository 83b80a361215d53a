"""What comes and goes, as a loose contact does: does the newest block show what was seen before?

Pooled, seconds with a fault and seconds without it look like another fault, as one mode happens to have more of them
than another. So where nothing is wrong in a block, and what was seen before would have shown in the same modes, the
fault has gone: blocks are left out until one shows something again. And where a block shows something in modes that
were healthy before, it has come: what is before is left out. Only the same modes are compared, because a fault that one
mode shows and another does not is told apart from others by just that.
"""

from faultline.service.core.decision.hypotheses import Hypotheses
from faultline.service.core.decision.look import Look
from faultline.service.core.decision.straying import Level
from faultline.service.core.decision.window import Blocks
from faultline.service.core.signals.values import Mask
from faultline.service.core.time_scale import Span

BLOCK = Span(periods=15)
"""Of which all ticks are left out or none: in short ones few are half with the fault and half without."""

CLEAR = 15.0
"""By how much a misfit must differ."""


class Intermittence:
    """Judges the blocks of a window. `gone` counts those in a row that were left out, 0 while the fault is there.

    `found`: it has gone once in this episode, though it is suspected still.
    """

    def __init__(self, hypotheses: Hypotheses) -> None:
        self._hypotheses = hypotheses
        self.rest()

    def rest(self) -> None:
        """Another episode."""
        self.gone, self.found = 0, False

    def judge(self, window: Blocks, level: Level) -> None:
        """Ends the window's block: it is kept, or left out, or what was before it is."""
        block = self._hypotheses.look(window.block, level)
        if self.gone:
            self.gone = self.gone + 1 if block is None or block.nothing <= block.limit else 0
            window.leave_out()  # the first that shows something again may be half without it
            return
        before = self._hypotheses.look(window.before, level)
        both = window.block.seen & window.before.seen
        if block is not None and before is not None and both.any():
            if _has_gone(block, before, both):
                self.gone, self.found = 1, True
                window.leave_out()
                return
            if _has_come(block, before, both):
                window.forget()
        window.keep()


def _has_gone(block: Look, before: Look, both: Mask) -> bool:
    """Whether nothing is wrong in the block, and what fits before would have shown in it, as it did in these modes."""
    if block.nothing > block.limit or before.nothing_in(both) < block.limit + CLEAR:
        return False
    return all(block.misfit_at(fitted) > block.nothing + CLEAR for fitted in before.fitting)


def _has_come(block: Look, before: Look, both: Mask) -> bool:
    """Whether the block shows something in modes that were healthy before."""
    return before.nothing_in(both) <= block.limit and block.nothing_in(both) > block.limit + CLEAR

"""The fresh window: the mean residual of every mode since a test began to alarm.

The window must be fresh: samples from before the onset, pooled with later ones, look like a dose-dependent fault. And
it forgets: of every mode it keeps the last `PART` to twice as much, so that a fault that has grown, or
another that has joined it hours later, is seen as it is now; a mode not visited since keeps what it showed.

What comes and goes is seen as it is when it is there: the newest seconds are a block, which can be left out.
"""

from collections.abc import Sequence

import numpy as np

from faultline.service.core.decision.straying import History, Means, Visit
from faultline.service.core.manifest import Evidence
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.signals.values import FloatArray
from faultline.service.core.time_scale import Span, TimeScale

FIRST = 6
"""The row of the sums at which those of the hypotheses begin."""

PART, RECENT = Span(settlings=7.5, periods=750), Span(settlings=1.5, periods=150)
_Waiting = tuple[int, int, Residuals]
"""Ticks in a row that are not added yet: the number of the first in the window, their mode and residuals."""

CHUNK, CHUNKS = 5, 64
"""Blocks that are joined once they are no more the last two, and so many of these; then the oldest two become one."""


class Window:
    """The residuals of the evidence generators since `clear`. A tick counts for those that can tell."""

    PARTS = 2
    """The older one first; ticks are added to the last."""

    def __init__(self, evidence: Evidence, generators: Sequence[str], time: TimeScale) -> None:
        self._columns = np.array([generators.index(name) for name in evidence.generators])
        self._hypotheses, self._modes = len(evidence.hypotheses), len(evidence.offset) - 1
        self._consequences = len(evidence.consequences)
        self._part, self._recent = time.ticks(PART), time.ticks(RECENT)
        self.clear()

    def clear(self) -> None:
        """Starts a fresh window."""
        K = len(self._columns)
        # Sums as in `Means`, those of hypotheses and of consequences behind the others.
        self._sums = np.zeros((self.PARTS, FIRST + self._hypotheses + self._consequences, self._modes, K))
        self._visit = Visit(K)
        self._tick = 0

    def add(self, mode: int, residuals: Residuals) -> None:
        """Takes the residuals of a tick; those at an edge say nothing."""
        self.extend(mode, residuals.in_a_row)

    def extend(self, mode: int, residuals: Residuals) -> None:
        """Take ticks in a row of one mode; what is forgotten is so before them."""
        self._forget(mode)
        self._take(self._sums[-1], self._tick + 1, mode, residuals)
        self._tick += len(residuals.r)

    def _take(self, sums: FloatArray, first: int, mode: int, residuals: Residuals) -> None:
        """Add ticks in a row to the sums, one after the other, so that rounding is that of one at a time."""
        self._visit.in_mode(mode)
        if mode == EDGE:
            return
        counted = residuals.counted[:, self._columns]
        n, behind = len(counted), FIRST + self._hypotheses
        parts = np.zeros((1 + n, *sums.shape[::2]))
        parts[0], values = sums[:, mode - 1], parts[1:]
        length = self._visit.length + counted.cumsum(axis=0)
        values[:, 0], values[:, 1] = 1.0, 2.0 * length - 1.0
        values[:, 4] = np.arange(first, first + n)[:, None]
        values[:, 2], values[:, 3] = residuals.r[:, self._columns], residuals.y_hat[:, self._columns]
        if residuals.excess.ndim:
            values[:, 5] = residuals.excess[:, self._columns]
        if self._hypotheses:
            values[:, FIRST:behind] = residuals.shift
        if self._consequences:
            values[:, behind:] = residuals.brought[..., None]
        if not counted.all():
            values.swapaxes(1, 2)[~counted] = 0.0
        sums[:, mode - 1] = parts.sum(axis=0)
        self._visit.length = length[-1]

    def _forget(self, mode: int) -> None:
        if mode != EDGE and self._sums[1, 0, mode - 1].max() >= self._part:
            self._sums[0, :, mode - 1], self._sums[1, :, mode - 1] = self._sums[1, :, mode - 1], 0.0

    @property
    def means(self) -> Means:
        """What was seen."""
        return self._means(self._sums.sum(axis=0))

    def _means(self, sums: FloatArray) -> Means:
        ticks, squares, total, predicted, _, excess = sums[:FIRST]
        squares = np.minimum(squares, ticks**2)  # the beginning of the longest visit may be forgotten
        shift, brought = np.split(sums[FIRST:], [self._hypotheses])
        return Means(ticks, squares, total, predicted, shift, brought, excess)


class Blocks(Window):
    """The same in blocks, of which the newest can be left out. Of every mode the last `PART` is kept.

    Blocks before the last two are joined to chunks of `CHUNK` blocks.
    """

    def clear(self) -> None:
        """Starts a fresh window."""
        super().clear()  # the last block, and the newest
        self._past: list[FloatArray] = []
        self._joined = 0  # blocks in the newest chunk

    def _forget(self, mode: int) -> None:
        """Ticks of a mode are forgotten where a chunk ends."""

    @property
    def means(self) -> Means:
        """What was seen."""
        return self._means(np.sum([*self._past, *self._sums], axis=0))

    @property
    def before(self) -> Means:
        """What was seen before both blocks."""
        return self._means(np.sum([np.zeros_like(self._sums[0]), *self._past], axis=0))

    @property
    def block(self) -> Means:
        """What the newest block shows."""
        return self._means(self._sums[-1])

    @property
    def history(self) -> History:
        """What was seen, one after the other."""
        parts = np.array([*self._past, *self._sums])
        ticks, when = parts[:, 0], parts[:, 4]
        age = (ticks * self._tick - when).sum(axis=(1, 2)) / np.maximum(ticks.sum(axis=(1, 2)), 1.0)
        return History(ticks, age, parts[:, FIRST : FIRST + self._hypotheses])

    def keep(self) -> None:
        """The block ends: it is the last one now."""
        if self._past and self._joined < CHUNK:
            self._past[-1] += self._sums[0]
            self._joined += 1
        else:
            self._past.append(self._sums[0].copy())
            self._joined = 1
            self._shorten()
        self._sums[0], self._sums[1] = self._sums[1], 0.0

    def _shorten(self) -> None:
        """Forgets of each mode what is older than its last `PART`."""
        ticks = np.array([chunk[0].max(axis=-1) for chunk in self._past])  # (chunks, C)
        later = ticks[::-1].cumsum(axis=0)[::-1] - ticks
        for chunk, modes in zip(self._past, later >= self._part, strict=True):
            chunk[:, modes] = 0.0
        self._past = [chunk for chunk in self._past[:-1] if chunk[0].any()] + self._past[-1:]
        if len(self._past) > CHUNKS:
            self._past[1] += self._past[0]
            del self._past[0]

    def leave_out(self) -> None:
        """The block ends and is left out, and so is the last one."""
        self._sums[:] = 0.0

    def forget(self) -> None:
        """Leaves out all but the block."""
        self._past.clear()
        self._sums[0] = 0.0


class Recent(Window):
    """The same of the last `RECENT` to twice as much alone: a mode not visited since is not seen.

    Ticks are added when the means are asked for: most are forgotten before.
    """

    def clear(self) -> None:
        """Starts anew."""
        super().clear()
        self._waiting: tuple[list[_Waiting], list[_Waiting]] = [], []  # of the older part and of the newer

    def extend(self, mode: int, residuals: Residuals) -> None:
        """Take ticks in a row of one mode."""
        first, end = self._tick + 1, self._tick + 1 + len(residuals.r)
        for at in range(-(-first // self._recent) * self._recent, end, self._recent):
            if at > first:
                self._waiting[1].append((first, mode, residuals.part(0, at - first)))
                residuals, first = residuals.part(at - first, end - first), at
            self._turn()
        self._waiting[1].append((first, mode, residuals))
        self._tick = end - 1

    def _turn(self) -> None:
        """The newer part becomes the older one."""
        older, newer = self._waiting
        for _, was, residuals in older:
            self._visit.in_mode(was)
            if was != EDGE:
                self._visit.length = self._visit.length + residuals.counted[:, self._columns].sum(axis=0)
        self._waiting = newer, []
        self._sums[0], self._sums[1] = self._sums[1], 0.0

    @property
    def means(self) -> Means:
        """What was seen."""
        for sums, waiting in zip(self._sums, self._waiting, strict=True):
            for each in waiting:
                self._take(sums, *each)
            waiting.clear()
        return super().means

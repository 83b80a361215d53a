"""Block means: some seconds of one visit to an operating mode are one observation.

A visit is an unbroken stay in a mode; edges between modes are left out. The mean, not the median: pulses of an actuator
that the sampling aliases have two or three levels, and a median jumps between them.
"""

from collections.abc import Iterator, Sequence
from math import inf
from typing import NamedTuple

import numpy as np

from faultline.service.core.manifest import Evidence
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.signals.values import FloatArray, Indices, Mask
from faultline.service.core.time_scale import Span, TimeScale

BLOCK = Span(settlings=0.15, periods=15)
"""The length of a block: shorter ones are not independent, as residuals remember what the system does."""

FEWEST = 1 / 3
"""A mean counts from so many of a block's ticks on."""


class Block(NamedTuple):
    """A block of B logs: when it ended (B,) [s], its mode (B,), and whether it begins a visit (B,).

    `ticks` (B, K) is the number of ticks of each generator in its `mean` (B, K), 0 where too few could tell. The noise
    of the means has `part` (B, K, K) of a tick's covariance: n_ij / (n_i n_j), with n_ij the ticks at which both could
    tell. `shift` (B, H, K) is the mean shift of the residuals by each hypothesis, `excess` (B, K) the mean of the
    variance of a network's error (`core.decision.model_error`).
    """

    end_s: FloatArray
    mode: Indices
    begins: Mask
    ticks: FloatArray
    mean: FloatArray
    part: FloatArray
    shift: FloatArray
    excess: FloatArray


class BlockMeans:
    """Cuts the ticks of one log into blocks. State: the ticks of the block that is open."""

    def __init__(self, evidence: Evidence, generators: Sequence[str], time: TimeScale) -> None:
        self._columns = np.array([generators.index(name) for name in evidence.generators])
        self._hypotheses = evidence.simple
        self._period_s, self._length = time.period_s, time.ticks(BLOCK)
        self._mode = EDGE
        self._begins = False
        self._rows: list[Residuals] = []
        self._open = 0  # ticks in them

    def room(self, mode: int) -> float:
        """Return how many more ticks in this mode the open block takes; the first of another mode closes it."""
        if mode == EDGE:
            return inf
        return self._length - self._open if mode == self._mode else 1

    def add(self, tick: int, mode: int, residuals: Residuals) -> Block | None:
        """Take a tick; return the block that it closes, or that the mode before it has closed."""
        return self.extend(tick, mode, residuals.in_a_row)

    def extend(self, tick: int, mode: int, residuals: Residuals) -> Block | None:
        """Take ticks in a row from this one on, no more than there is room for; else as `add`."""
        closed = None
        if mode != self._mode:
            closed = self._close(tick - 1)
            self._mode, self._begins = mode, True
        if mode == EDGE:
            return closed
        self._rows.append(residuals)
        self._open += len(residuals.r)
        if self._open == self._length:
            closed = self._close(tick + len(residuals.r) - 1)
        return closed

    def _close(self, tick: int) -> Block | None:
        """Return the open block, which ends with this tick, where it has enough ticks; then open another."""
        block = None
        if not self._rows:
            return block
        usable = np.concatenate([each.counted for each in self._rows])[:, self._columns]
        ticks = usable.sum(axis=0, dtype=np.float64)
        counts = ticks >= FEWEST * self._length
        if counts.any():
            most = np.maximum(ticks, 1.0)
            block = Block(
                end_s=np.array([tick * self._period_s]),
                mode=np.array([self._mode]),
                begins=np.array([self._begins]),
                ticks=np.where(counts, ticks, 0.0)[None],
                mean=(self._sum(usable, [each.r for each in self._rows]) / most)[None],
                part=_part(usable, most)[None],
                shift=(self._shift(usable) / most)[None],
                excess=(self._excess(usable) / most)[None],
            )
            self._begins = False
        self._rows, self._open = [], 0
        return block

    def _sum(self, usable: Mask, values: Sequence[FloatArray]) -> FloatArray:
        """The sums (K,) of the values (..., T) of all ticks, where these are `usable` (n, K)."""
        return np.asarray(np.where(usable, np.concatenate(values)[:, self._columns], 0.0).sum(axis=0))

    def _shift(self, usable: Mask) -> FloatArray:
        """The sums (H, K) of what the hypotheses do to the residuals."""
        if not self._hypotheses:
            return np.zeros((0, len(self._columns)))
        shift = np.concatenate([each.shift[:, : self._hypotheses] for each in self._rows])
        return np.asarray(np.where(usable[:, None], shift, 0.0).sum(axis=0))

    def _excess(self, usable: Mask) -> FloatArray:
        """The sums (K,) of the variances of networks' errors."""
        said = [each.excess for each in self._rows]
        return self._sum(usable, said) if said[0].ndim else np.zeros(len(self._columns))


def _part(usable: Mask, ticks: FloatArray) -> FloatArray:
    """The covariance (K, K) of means of white noise, in parts of a tick's, over the ticks that are `usable` (n, K)."""
    if usable.all():
        return np.full((len(ticks), len(ticks)), 1.0 / len(usable))
    counted = usable.astype(np.float64)
    return np.asarray((counted.T @ counted) / np.outer(ticks, ticks))


def side_by_side(logs: Sequence[Sequence[Block]]) -> Iterator[Block]:
    """Yield the k-th blocks of all logs as one; a log that has ended goes on with blocks in which nothing was seen."""
    for k in range(max(map(len, logs), default=0)):
        row = [blocks[k] if k < len(blocks) else _nothing(blocks[-1]) for blocks in logs]
        yield Block(*(np.concatenate(parts) for parts in zip(*row, strict=True)))


def _nothing(last: Block) -> Block:
    return last._replace(begins=np.zeros(1, dtype=np.bool_), ticks=np.zeros_like(last.ticks))

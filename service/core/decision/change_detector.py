"""The generalised likelihood ratio of Willsky and Jones: which fault, of which size, since when?

Beside the filter without a fault, each hypothesis h leaves a signature g in its whitened innovations e, once for every
onset tau that is kept. With A = sum g'g and c = sum g'e since tau, the log-likelihood ratio of h to no fault is

    LLR(tau, h) = c - A / 2        [nats]

Between two assumed sizes the signature is on the straight line between theirs; the ratio is that of the best size on
the polygon from none over the sizes of a sign. A fault that nobody has declared shifts the means by any constant: of
the K unit shifts' signatures Q = c' A^-1 c, and its ratio is the marginal one under Zellner's g-prior with the
likeliest g, (Q - K (1 + ln(Q / K))) / 2 (Liang et al. 2008).

Onsets are every block's beginning, thinned so that they lie the closer the younger they are: of a full table goes the
one whose neighbours lie closest together, in parts of its age. The first, the start of the drive, is never left out.
"""

from typing import NamedTuple

import numpy as np

from faultline.service.core.decision.baseline import BaselineFilter, BaselineModel, GaussianState, Innovation, signature
from faultline.service.core.decision.blocks import Block
from faultline.service.core.decision.look import Segments
from faultline.service.core.decision.odd_visits import OddVisits
from faultline.service.core.signals.values import FloatArray, Indices

ONSETS = 24
"""The number of onsets kept: the last are a block apart, those before some eighth of their age."""


class Change(NamedTuple):
    """The likeliest change of each log: its log-likelihood ratio (B,) [nats], its fault and onset as indices (B,).

    The last fault is the undeclared one.
    """

    log_ratio: FloatArray
    fault: Indices
    onset: Indices


class ChangeDetector:
    """The ratios of B logs. State: the filter, and for each onset the effects, A and c of all hypotheses."""

    of_filter: type[BaselineFilter] = BaselineFilter

    def __init__(self, model: BaselineModel, segments: Segments, hypotheses: int, logs: int = 1) -> None:
        self.filter, self._odd = self.of_filter(model, logs), OddVisits(model, logs, self.of_filter)
        self._segments = segments
        self.faults = list(dict.fromkeys(segments.faults))
        self._own = [np.flatnonzero([name == fault for name in segments.faults]) for fault in self.faults]
        K = model.offset.shape[1]
        self._unit, rows = np.eye(K), 1 + hypotheses + K  # row 0 is none
        self.onset_s = np.zeros((logs, 0))
        self.before = GaussianState(np.zeros((logs, 0, model.states)), np.zeros((logs, 0, model.states, model.states)))
        self._effect = np.zeros((logs, 0, rows, model.states))
        self._A, self._c = np.zeros((logs, 0, rows)), np.zeros((logs, 0, rows))
        self._along = np.zeros((logs, 0, len(segments.faults)))  # g'g of the two ends of a segment
        self._free = np.zeros((logs, 0, K, K))
        self._explained = np.zeros((logs, 0))  # by odd visits before the onset
        self._table = np.zeros((logs, 0, len(self.faults) + 1))  # the ratios of the last block

    def step(self, block: Block) -> Change:
        """Take a block; return the likeliest change."""
        self._odd.begin(block, self.filter.state, self.filter.end_s)
        self._add_onset(block)
        innovation = self.filter.step(block)
        self._odd.step(block, innovation.log_density)
        self._add(block, innovation)
        return self._likeliest()

    def _add(self, block: Block, innovation: Innovation) -> None:
        """Add a block to what each onset has."""
        B, T = self.onset_s.shape
        none = np.zeros((B, 1, block.shift.shape[-1]))
        shift = np.concatenate([none, block.shift, np.broadcast_to(self._unit, (B, *self._unit.shape))], axis=1)
        shift = np.broadcast_to(shift[:, None], (B, T, *shift.shape[1:]))
        self._effect, g = signature(self._effect, innovation, shift, (block.ticks > 0).astype(np.float64))
        self._A += (g**2).sum(axis=-1)
        self._c += np.einsum("btrk,bk->btr", g, innovation.white)
        self._along += (g[:, :, self._segments.begin] * g[:, :, self._segments.end]).sum(axis=-1)
        free = g[:, :, -len(self._unit) :]
        self._free += free @ free.swapaxes(2, 3)

    @property
    def ratios(self) -> FloatArray:
        """The log-likelihood ratios (B, T, segments) at the best size of each segment [nats]."""
        begin, end = self._segments.begin, self._segments.end
        A, c, X = self._A, self._c, self._along
        length = np.maximum(A[..., begin] - 2.0 * X + A[..., end], 1e-300)
        part = np.clip((c[..., end] - c[..., begin] - X + A[..., begin]) / length, 0.0, 1.0)
        mean = c[..., begin] + part * (c[..., end] - c[..., begin])
        square = (1 - part) ** 2 * A[..., begin] + 2 * part * (1 - part) * X + part**2 * A[..., end]
        return np.asarray(mean - square / 2.0)

    def since(self, t_s: float) -> float:
        """Return the largest ratio of the first log that a fault since the last onset until this time has [nats]."""
        last = max(int(np.searchsorted(self.onset_s[0], t_s, side="right")) - 1, 0)
        return float(self._table[0, last].max())

    def forget_onsets(self, state: GaussianState) -> None:
        """Look for changes from now on only, from this state of the filter."""
        self.filter.state = state
        self.onset_s, self._explained = self.onset_s[:, :0], self._explained[:, :0]
        self.before = GaussianState(*(each[:, :0] for each in self.before))
        self._effect, self._A, self._c, self._along, self._free = (each[:, :0] for each in self._sums)

    def _likeliest(self) -> Change:
        B, T = self.onset_s.shape
        self._table = self._of_faults() - (self._odd.explained[:, None] - self._explained)[..., None]
        table = self._table.reshape(B, -1)
        best = table.argmax(axis=1)
        onset, fault = np.divmod(best, table.shape[1] // T)
        return Change(np.take_along_axis(table, best[:, None], 1)[:, 0], fault, onset)

    def _of_faults(self) -> FloatArray:
        """The ratios (B, T, F + 1) of each declared fault, and of the undeclared one."""
        ratios = self.ratios
        return np.stack([*(ratios[..., own].max(axis=-1) for own in self._own), self._undeclared()], axis=-1)

    def _undeclared(self) -> FloatArray:
        """The ratios (B, T) of a shift by any constant."""
        K = len(self._unit)
        eigenvalues, vectors = np.linalg.eigh(self._free)
        seen = eigenvalues > 1e-15 * eigenvalues[..., -1:]  # what no block has shown explains nothing
        c = (self._c[..., None, -K:] @ vectors)[..., 0, :]
        Q = np.maximum((np.where(seen, c, 0.0) ** 2 / np.where(seen, eigenvalues, 1.0)).sum(axis=-1), K)
        return np.asarray((Q - K * (1.0 + np.log(Q / K))) / 2.0)

    def _add_onset(self, block: Block) -> None:
        """Add the beginning of the block to the onsets; where the table is full, leave one out."""
        B, T = self.onset_s.shape
        out = None
        if T == ONSETS:
            now = block.end_s[:, None]
            later = np.concatenate([self.onset_s[:, 2:], now], axis=1)
            gap = (later - self.onset_s[:, :-1]) / np.maximum(now - self.onset_s[:, 1:], 1e-9)
            out = 1 + gap.argmin(axis=1)
        began, state = self.filter.end_s, self.filter.state
        self.onset_s = _behind(self.onset_s, began, out)
        self._explained = _behind(self._explained, self._odd.before, out)
        self.before = GaussianState(*(_behind(each, new, out) for each, new in zip(self.before, state, strict=True)))
        self._effect, self._A, self._c, self._along, self._free = (
            _behind(each, np.zeros((B, *each.shape[2:])), out) for each in self._sums
        )

    @property
    def _sums(self) -> tuple[FloatArray, ...]:
        """Return the tables that are added up since each onset."""
        return self._effect, self._A, self._c, self._along, self._free


def _behind(table: FloatArray, new: FloatArray, out: Indices | None) -> FloatArray:
    """A table (B, T, ...) with a new entry (B, ...) behind, which takes the room of those that go `out` (B,)."""
    if out is None:
        return np.concatenate([table, new[:, None]], axis=1)
    for log, gone in zip(table, out.tolist(), strict=True):
        log[gone:-1] = log[gone + 1 :]
    table[:, -1] = new
    return table

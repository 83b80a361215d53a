"""Windows of the samples to train on, and what of them each member may look at."""

import copy
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from faultline.analysis.recordings.modes import time_of
from faultline.service.core.time_scale import Span
from faultline.training.layout import Layout
from faultline.training.recipe import Phase, Recipe
from faultline.training.reckoned import Example
from faultline.training.scaling import Scaling

Array = npt.NDArray[np.float64]

BLOCK = 50
"""Ticks that belong to one fold. With longer ones a member misses whole operating points."""

APART_S = 1e5
"""Between the clocks of two recordings, more where one is longer; a whole number of blocks."""


class Batch(NamedTuple):
    """Windows, scaled: the first states x (M, F, B), and what there is of every tick.

    Inputs u (L, M, 2 nz + 1, B), `known` states (L, M, F, B), predictions to be made y (L, M, T, B), and whether they
    count (L, M, B).
    """

    x: Tensor
    u: Tensor
    known: Tensor
    y: Tensor
    counts: Tensor


class Windows:
    """All examples one after the other, scaled: those that were measured, then those that were varied.

    Signals `z` (K, nz), inputs `u` = [signals; signals a tick before; 0] (K, 2 nz + 1), `known` states (K, F) and
    predictions to be made `y` (K, T); `starts` (K, F) are the states as the
    vehicle would start them, `fold` (K,) that of a tick, -1 without folds, `clock` (K,) its log time [s],
    and whether it is `natural` (K,), as it was recorded.
    `bounds` are where examples begin and end, `measured` those that were. After `run_up` ticks a state has forgotten
    where it began.
    """

    def __init__(
        self,
        layout: Layout,
        examples: Sequence[Example],
        varied: Sequence[Example],
        scaling: Scaling,
        folds: int,
        seed: int,
    ) -> None:
        every = [*examples, *varied]
        z, x, y = (np.concatenate([getattr(example, name) for example in every]) for name in ("z", "x", "y"))
        self.z = torch.tensor(scaling.z(z), dtype=torch.float32)
        before = np.concatenate([example.z[np.maximum(np.arange(len(example.z)) - 1, 0)] for example in every])
        nothing = torch.zeros(len(z), 1)
        self.u = torch.cat([self.z, torch.tensor(scaling.z(before), dtype=torch.float32), nothing], dim=1)
        self.known = torch.tensor(scaling.x(x), dtype=torch.float32)
        self.y = torch.tensor(scaling.y(y, layout.predicts), dtype=torch.float32)
        self.starts = torch.tensor(scaling.x(layout.started(z)), dtype=torch.float32)
        ends = np.cumsum([len(example.z) for example in every])
        self.bounds = [(int(end - len(example.z)), int(end)) for example, end in zip(every, ends, strict=True)]
        self.measured = self.bounds[: len(examples)]
        clock = _clock(every, layout.model.period_s)
        self.fold = torch.tensor(_folds(clock, BLOCK * layout.model.period_s, folds, seed))
        self.clock = torch.tensor(clock)
        self.natural = torch.tensor(np.concatenate([np.full(len(e.z), e.natural) for e in every]))
        self._folds = folds
        time, longest = time_of(layout.model), max(end - begin for begin, end in self.measured)
        self.run_up = min(time.ticks(Span(settlings=1.0)), longest // 2)

    def to(self, device: torch.device) -> "Windows":
        """The same, where networks are trained."""
        near = copy.copy(self)
        for name, value in vars(self).items():
            if isinstance(value, Tensor):
                setattr(near, name, value.to(device))
        return near

    def of(self, members: int) -> Tensor:
        """The fold (M,) that each member does not see."""
        return torch.arange(members, device=self.fold.device) % max(self._folds, 1)

    def batch(self, phase: Phase, recipe: Recipe, generator: torch.Generator) -> Batch:
        """Random windows for each member, of which its own fold does not count; all stretches where a phase says so."""
        members, length = recipe.members, phase.length
        if length is None:
            return self._whole(members)
        before = int(recipe.newest)  # the first step is the first tick's: from the states a tick before
        places = torch.cat(
            [
                torch.arange(begin + before, end - length + 1)
                for begin, end in self.bounds
                if end - begin >= length + before
            ]
        )
        chosen = places[torch.randint(len(places), (members, phase.batch), generator=generator)]  # (M, B)
        at = (chosen[None] + torch.arange(length)[:, None, None]).to(self.fold.device)  # (L, M, B)
        fold = self.of(members)[None, :, None]
        u, known, y = (part[at].transpose(2, 3).contiguous() for part in self._parts)
        return Batch(
            self.known[at[0] - before].transpose(1, 2).contiguous(),
            u,
            known,
            y,
            (self.fold[at] != fold).to(torch.float32),
        )

    def _whole(self, members: int) -> Batch:
        longest = max(end - begin for begin, end in self.bounds)
        u, known, y = (part.new_zeros(longest, members, part.shape[1], len(self.bounds)) for part in self._parts)
        counts = self.u.new_zeros(longest, members, len(self.bounds))
        for b, (begin, end) in enumerate(self.bounds):
            for to, part in zip((u, known, y), self._parts, strict=True):
                to[: end - begin, :, :, b] = part[begin:end, None, :]
            counts[: end - begin, :, b] = (self.fold[begin:end, None] != self.of(members)).to(torch.float32)
        x = torch.stack([self.starts[begin] for begin, _ in self.bounds], dim=1)
        return Batch(x[None].repeat(members, 1, 1), u, known, y, counts)

    @property
    def _parts(self) -> tuple[Tensor, Tensor, Tensor]:
        return self.u, self.known, self.y


def _clock(examples: Sequence[Example], period_s: float) -> npt.NDArray[np.float64]:
    """The log time [s] of every tick, recordings apart."""
    number = {name: k for k, name in enumerate(dict.fromkeys(e.recording for e in examples))}
    longest_s = max(e.begin_s + period_s * len(e.z) for e in examples)
    apart_s = BLOCK * period_s * np.ceil(max(APART_S, longest_s) / (BLOCK * period_s))
    return np.concatenate(
        [apart_s * number[e.recording] + e.begin_s + period_s * np.arange(len(e.z)) for e in examples]
    )


def _folds(clock: npt.NDArray[np.float64], block_s: float, folds: int, seed: int) -> npt.NDArray[np.int64]:
    """Blocks in a row have different folds, in another order every round: none follows the cycle's own rhythm.

    By log time: what is seen from several starts of the vehicle is in one fold each time.
    """
    if not folds:
        return np.full(len(clock), -1, dtype=np.int64)
    block = (clock / block_s).astype(np.int64)
    rounds = int(block.max()) // folds + 1
    rng = np.random.default_rng(seed)
    order = np.concatenate([rng.permutation(folds) for _ in range(rounds)])
    return np.asarray(order[block], dtype=np.int64)

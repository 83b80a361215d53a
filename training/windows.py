"""Windows of the samples to train on, and what of them each member may look at."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from analysis.graph.bank import PERIOD_S
from training.layout import Layout
from training.samples import Samples
from training.scaling import Scaling

Array = npt.NDArray[np.float64]

BLOCK_S = 10.0
"""Log time that belongs to one fold. With longer ones a member misses whole operating points."""

PART_S = 50.0
"""Log time of one part, for what is calibrated on some and judged on others: longer than a residual remembers."""

APART_S = 1e5
"""Between the clocks of two recordings; a whole number of parts and of blocks."""


class Batch(NamedTuple):
    """Windows, scaled: first states x (M, F, B), signals z (L, M, nz, B), and whether an output counts (L, M, B)."""

    x: Tensor
    z: Tensor
    counts: Tensor


class Windows:
    """The samples of all stretches one after the other, scaled.

    `fold` (K,) is that of a tick, -1 without folds, and `part` (K,) the number of its part; `reckoned` (K, F) and
    `starts` (K, F) are the states as they are reckoned, and as the vehicle would start them.
    """

    def __init__(
        self,
        layout: Layout,
        samples: Samples,
        states: Sequence[Array],
        scaling: Scaling,
        folds: int,
        seed: int,
    ) -> None:
        stretches = [stretch.z for stretch in samples.stretches]
        z = np.concatenate(stretches)
        self.z = torch.tensor(scaling.z(z), dtype=torch.float32)
        self.reckoned = torch.tensor(scaling.x(np.concatenate(states)), dtype=torch.float32)
        self.starts = torch.tensor(scaling.x(layout.started(z)), dtype=torch.float32)
        ends = np.cumsum([len(part) for part in stretches])
        self.bounds = [(int(end - len(part)), int(end)) for part, end in zip(stretches, ends, strict=True)]
        clock = _clock(samples)
        self.fold = torch.tensor(_folds(clock, folds, seed))
        self.part = torch.tensor((clock / PART_S).astype(np.int64))
        self._folds = folds

    def of(self, members: int) -> Tensor:
        """The fold (M,) that each member does not see."""
        return torch.arange(members) % max(self._folds, 1)

    def batch(self, length: int | None, count: int, members: int, generator: torch.Generator) -> Batch:
        """So many random windows for each member, of which its own fold does not count; all stretches for None."""
        if length is None:
            return self._whole(members)
        places = torch.cat(
            [torch.arange(begin, end - length + 1) for begin, end in self.bounds if end - begin >= length]
        )
        chosen = places[torch.randint(len(places), (members, count), generator=generator)]  # (M, B)
        at = chosen[None] + torch.arange(length)[:, None, None]  # (L, M, B)
        fold = self.of(members)[None, :, None]
        return Batch(
            self.reckoned[chosen].transpose(1, 2).contiguous(),
            self.z[at].transpose(2, 3).contiguous(),
            (self.fold[at] != fold).to(torch.float32),
        )

    def _whole(self, members: int) -> Batch:
        longest = max(end - begin for begin, end in self.bounds)
        z = torch.zeros(longest, members, self.z.shape[1], len(self.bounds))
        counts = torch.zeros(longest, members, len(self.bounds))
        for b, (begin, end) in enumerate(self.bounds):
            z[: end - begin, :, :, b] = self.z[begin:end, None, :]
            counts[: end - begin, :, b] = (self.fold[begin:end, None] != self.of(members)).to(torch.float32)
        x = torch.stack([self.starts[begin] for begin, _ in self.bounds], dim=1)
        return Batch(x[None].repeat(members, 1, 1), z, counts)


def _clock(samples: Samples) -> npt.NDArray[np.float64]:
    """The log time [s] of every tick; recordings lie `APART_S` apart."""
    number = {name: k for k, name in enumerate(dict.fromkeys(s.recording for s in samples.stretches))}
    return np.concatenate(
        [APART_S * number[s.recording] + s.begin_s + PERIOD_S * np.arange(len(s.z)) for s in samples.stretches]
    )


def _folds(clock: npt.NDArray[np.float64], folds: int, seed: int) -> npt.NDArray[np.int64]:
    """Blocks in a row have different folds, in another order every round: none follows the cycle's own rhythm.

    By log time: what is seen from several starts of the vehicle is in one fold each time.
    """
    if not folds:
        return np.full(len(clock), -1, dtype=np.int64)
    block = (clock / BLOCK_S).astype(np.int64)
    rounds = int(block.max()) // folds + 1
    rng = np.random.default_rng(seed)
    order = np.concatenate([rng.permutation(folds) for _ in range(rounds)])
    return np.asarray(order[block], dtype=np.int64)

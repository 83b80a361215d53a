"""The free run over whole recordings, fast: pieces side by side, each with a run-up that is thrown away."""

from typing import NamedTuple

import torch
from torch import Tensor

from faultline.training.network import Networks
from faultline.training.windows import Windows

PIECE = 100
"""Ticks that are run at once, behind a run-up in which the slowest state forgets where it began."""


class Course(NamedTuple):
    """Of every tick with a run-up, scaled: its number (K,), prediction (M, T, K), states of it and before (M, F, K).

    A network of the old input predicts with the states before: there they are the same.
    """

    at: Tensor
    y: Tensor
    x: Tensor
    before: Tensor


def free_run(networks: Networks, windows: Windows) -> Course:
    """The course over all that was measured; a stretch begins as the vehicle does, and counts once it has settled."""
    run_up = windows.run_up
    starts, first = [], []
    for begin, end in windows.measured:
        for k in range(begin, end, PIECE):
            start = max(begin, min(k - run_up, end - PIECE - run_up))
            starts.append(start)
            first.append(max(k, begin + run_up))
    at = torch.tensor(starts)[:, None] + torch.arange(PIECE + run_up)  # (P, L)
    last = torch.tensor([next(end for begin, end in windows.measured if begin <= s < end) for s in starts])
    inside = torch.minimum(at, last[:, None] - 1)
    near = windows.u.device
    u = windows.u[inside.to(near)].permute(1, 2, 0)[:, None].expand(-1, networks.members, -1, -1)  # (L, M, C, P)
    x = windows.starts[torch.tensor(starts, device=near)].T[None].expand(networks.members, -1, -1)
    with torch.no_grad():
        run = networks.run(x.contiguous(), u)
    told = torch.zeros(len(windows.z), dtype=torch.bool)
    numbers, places = [], []
    for p, (s, f) in enumerate(zip(starts, first, strict=True)):
        for k in range(max(f, s + run_up), min(s + PIECE + run_up, int(last[p]))):
            if not told[k]:
                told[k] = True
                numbers.append(k)
                places.append((k - s, p))
    step, piece = torch.tensor(places, device=near).T
    order = torch.tensor(numbers, device=near)
    y, states = run.y.permute(1, 2, 0, 3), run.x.permute(1, 2, 0, 3)
    earlier = step - 1 if networks.recipe.newest else step
    return Course(order, y[:, :, step, piece], states[:, :, step, piece], states[:, :, earlier, piece])

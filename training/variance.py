"""How large a residual is where nothing is wrong: a network of the operating point, from residuals nobody trained on.

A member's residuals where it was trained are too small. Those of each tick are taken from the member that did not see
it (cross-fit). What is learnt is the limit below which `COVERED` of them are, in parts of where a normal distribution
has it (the pinball loss of the logarithm, Koenker and Bassett 1978): ticks at which a dose changes are rare and large.
A factor on top brings as many below the limit in the half that was left out.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from scipy.special import ndtri
from torch import Tensor

from faultline.training.free_run import Course
from faultline.training.layout import Layout
from faultline.training.stack import Stack
from faultline.training.windows import Windows

Columns = npt.NDArray[np.intp]

HIDDEN, STEPS, RATE, DECAY = (16,), 100, 1e-2, 1.0
"""Few steps and a strong decay: of rare ticks more would be learnt by heart."""

ENOUGH = 12000
"""Ticks: of more, some are left out, as neighbours say the same."""

HALF = 50
"""Ticks in a row that are in the same half: with more, a half misses whole operating points."""

SMALLEST = 1e-2
"""Of an output's spread: a residual that is less was learnt by heart."""

COVERED = 0.99
NORMAL = float(ndtri(0.5 + COVERED / 2))
"""Deviations within which a normal residual has that share."""


class Variances(NamedTuple):
    """The network (one member, T functions of `columns` (T, D)), and the factor (T,)."""

    columns: Columns
    stack: Stack
    factor: Tensor


class Residuals(NamedTuple):
    """Of K ticks: `left` (T, K), what members say differently `among` (T, K), inputs (C, K), the `half` (K,).

    And whether a tick is `natural` (K,): what was moved between messages has less noise, and another age.
    """

    left: Tensor
    among: Tensor
    inputs: Tensor
    half: Tensor
    natural: Tensor

    def some(self, chosen: Tensor) -> "Residuals":
        """Of the chosen ticks."""
        return Residuals(*(part[..., chosen] for part in self))


def variances(layout: Layout, windows: Windows, course: Course, seed: int) -> Variances:
    """The network of all tests, from a free run over the recordings that the members were trained on."""
    torch.manual_seed(seed)
    residuals = cross_fit(windows, course, layout.model.period_s)
    every = -(-residuals.left.shape[1] // ENOUGH)
    residuals = residuals.some(torch.arange(0, residuals.left.shape[1], every))
    columns = variance_columns(layout)
    everything = torch.ones_like(residuals.half)
    factors = []
    for out in (0, 1):
        stack = _fitted(columns, residuals, (residuals.half != out).to(torch.float32))
        factors.append(_factor(stack, residuals, residuals.half == out))
    factor = torch.stack(factors).mean(dim=0)
    return Variances(columns, _fitted(columns, residuals, everything.to(torch.float32)), factor)


def variance_columns(layout: Layout) -> Columns:
    """For each test: its states and the signals it is driven by, now and a tick before.

    Of [new states; old states; signals; signals before; 0].

    The signal that it predicts is not among them: beside the state that predicts it, it would tell the residual, and a
    residual that makes its own sigma hides every fault.
    """
    size, rows = len(layout.states), []
    for t in range(len(layout.tests)):
        own = np.flatnonzero(layout.owner == t)
        driven = layout.driven(t)
        held = [signal for test, signal in layout.held if test == t]
        rows.append([*own, *(own + size), *(driven + 2 * size), *(2 * size + len(layout.signals) + s for s in held)])
    width = max([1, *map(len, rows)])
    padding = 2 * size + 2 * len(layout.signals)
    return np.array([[*row, *[padding] * (width - len(row))] for row in rows], dtype=np.intp)


def cross_fit(windows: Windows, course: Course, period_s: float) -> Residuals:
    """Of every tick that one member did not see, that member's residual; without folds, the mean's."""
    y = windows.y[course.at].T
    mean = course.y.mean(dim=0)
    members = len(course.y)
    among = ((course.y - mean) ** 2).sum(dim=0) / max(members - 1, 1)
    natural = windows.natural[course.at]
    fold, unseen = windows.fold[course.at], windows.of(members)
    inputs = torch.cat([course.x.mean(dim=0), course.before.mean(dim=0), windows.u[course.at].T])
    block = (windows.clock[course.at] / (HALF * period_s)).to(torch.int64)
    if bool((fold < 0).all()):
        return Residuals(y - mean, among, inputs, _alternating(block), natural)
    hidden = (unseen[:, None] == fold).to(torch.float32)  # (M, K)
    told = hidden.sum(dim=0) > 0
    one = (course.y * hidden[:, None]).sum(dim=0) / hidden.sum(dim=0).clamp(min=1.0)
    half = torch.zeros_like(block)
    half[told] = _alternating(block[told])  # of those that count: folds follow blocks too
    return Residuals(y - one, among, inputs, half, natural).some(told)


def _alternating(block: Tensor) -> Tensor:
    """Halves in turn (K,), of the blocks (K,) that are there."""
    at: Tensor = torch.unique(block, return_inverse=True)[1]
    return at % 2


def _fitted(columns: Columns, of: Residuals, weight: Tensor) -> Stack:
    stack = Stack(columns, 1, HIDDEN, 0.1, len(of.inputs) - 1)
    with torch.no_grad():
        whole = of.left[:, weight > 0].abs().quantile(COVERED, dim=1) / NORMAL
        stack.bias[:, 0, 0] = 2.0 * whole.clamp(min=SMALLEST).log()
    size = (of.left.abs() / NORMAL).clamp(min=1e-6).log()
    free = {id(p) for p in (stack.bias, *stack.biases)}  # a level that decays is won back by weights
    groups = [
        {"params": [p for p in stack.parameters() if (id(p) in free) is chosen], "weight_decay": decay}
        for chosen, decay in ((False, DECAY), (True, 0.0))
    ]
    optimizer = torch.optim.AdamW(groups, lr=RATE)
    for _ in range(STEPS):
        log_v = stack(of.inputs[None])[0]
        limit = 0.5 * (log_v.exp() + of.among + SMALLEST**2).log()
        beyond = size - limit
        loss = (torch.maximum(COVERED * beyond, (COVERED - 1.0) * beyond) * weight).sum() / weight.sum()
        optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        optimizer.step()
    return stack


def _factor(stack: Stack, of: Residuals, judged: Tensor) -> Tensor:
    with torch.no_grad():
        log_v: Tensor = stack(of.inputs[None])[0]
        standard = of.left.abs() / (log_v.exp() + of.among).sqrt()
    kinds = [standard[:, judged & kind] for kind in (of.natural, ~of.natural) if bool((judged & kind).any())]
    return torch.stack([kind.quantile(COVERED, dim=1) / NORMAL for kind in kinds]).amax(dim=0)

"""How large a residual is where nothing is wrong: a network of the operating point, from residuals nobody trained on.

A member's residuals where it was trained are too small. Those of each tick are taken from the member that did not see
it (cross-fit); log v is fitted to them by the likelihood of a normal distribution, and a factor on top brings the
`COVERED` quantile of the standardised residuals of the half that was left out to where a normal one has it.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from scipy.stats import norm
from torch import Tensor

from training.free_run import Course
from training.layout import Layout
from training.stack import Stack
from training.windows import Windows

Columns = npt.NDArray[np.intp]

HIDDEN, STEPS, RATE, DECAY = (16,), 400, 1e-2, 1e-3
SMALLEST = 1e-2
"""Of an output's spread: a residual that is less was learnt by heart."""

COVERED = 0.99


class Variances(NamedTuple):
    """The network (one member, T functions of `columns` (T, D)), and the factor (T,)."""

    columns: Columns
    stack: Stack
    factor: Tensor


class Residuals(NamedTuple):
    """Of K ticks: `left` (T, K), what members say differently `among` (T, K), inputs (C, K), and the `half` (K,)."""

    left: Tensor
    among: Tensor
    inputs: Tensor
    half: Tensor


def variances(layout: Layout, windows: Windows, course: Course, seed: int) -> Variances:
    """The network of all tests, from a free run over the recordings that the members were trained on."""
    torch.manual_seed(seed)
    residuals = cross_fit(windows, course)
    columns = variance_columns(layout)
    everything = torch.ones_like(residuals.half)
    factors = []
    for out in (0, 1):
        stack = _fitted(columns, residuals, (residuals.half != out).to(torch.float32))
        factors.append(_factor(stack, residuals, residuals.half == out))
    factor = torch.stack(factors).mean(dim=0)
    return Variances(columns, _fitted(columns, residuals, everything.to(torch.float32)), factor)


def variance_columns(layout: Layout) -> Columns:
    """For each test: its new states, its old states, and the signals it is driven by, of [new; old; signals; 0].

    The signal that it predicts is not among them: beside the state that predicts it, it would tell the residual, and a
    residual that makes its own sigma hides every fault.
    """
    size, rows = len(layout.states), []
    for t in range(len(layout.tests)):
        own = np.flatnonzero(layout.owner == t)
        rows.append([*own, *(own + size), *(layout.driven(t) + 2 * size)])
    width = max(len(row) for row in rows)
    padding = 2 * size + len(layout.signals)
    return np.array([[*row, *[padding] * (width - len(row))] for row in rows], dtype=np.intp)


def cross_fit(windows: Windows, course: Course) -> Residuals:
    """Of every tick that one member did not see, that member's residual; without folds, the mean's."""
    y = windows.y[course.at].T
    mean = course.y.mean(dim=0)
    members = len(course.y)
    among = ((course.y - mean) ** 2).sum(dim=0) / max(members - 1, 1)
    fold, unseen = windows.fold[course.at], windows.of(members)
    nothing = torch.zeros(1, len(course.at))
    inputs = torch.cat([course.x.mean(dim=0), course.before.mean(dim=0), windows.z[course.at].T, nothing])
    half = windows.part[course.at] % 2
    if bool((fold < 0).all()):
        return Residuals(y - mean, among, inputs, half)
    hidden = (unseen[:, None] == fold).to(torch.float32)  # (M, K)
    told = hidden.sum(dim=0) > 0
    one = (course.y * hidden[:, None]).sum(dim=0) / hidden.sum(dim=0).clamp(min=1.0)
    return Residuals((y - one)[:, told], among[:, told], inputs[:, told], half[told])


def _fitted(columns: Columns, of: Residuals, weight: Tensor) -> Stack:
    stack = Stack(columns.tolist(), 1, HIDDEN, 0.1, len(of.inputs) - 1)
    with torch.no_grad():
        stack.bias[:, 0, 0] = (of.left.pow(2) * weight).sum(dim=1).div(weight.sum()).clamp(min=SMALLEST**2).log()
    optimizer = torch.optim.AdamW(stack.parameters(), lr=RATE, weight_decay=DECAY)
    for _ in range(STEPS):
        log_v = stack(of.inputs[None])[0]
        v = log_v.exp() + of.among + SMALLEST**2
        loss = ((of.left.pow(2) / v + v.log()) * weight).sum() / weight.sum()
        optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        optimizer.step()
    return stack


def _factor(stack: Stack, of: Residuals, judged: Tensor) -> Tensor:
    with torch.no_grad():
        log_v: Tensor = stack(of.inputs[None])[0]
        standard = of.left.abs() / (log_v.exp() + of.among).sqrt()
        return standard[:, judged].quantile(COVERED, dim=1) / float(norm.ppf(0.5 + COVERED / 2))

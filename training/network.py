"""The networks of all tests and members as one recurrent network: a step, and a free run over windows."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from faultline.training.layout import Layout
from faultline.training.recipe import Recipe
from faultline.training.stack import Stack

Array = npt.NDArray[np.float64]

SPEED = 2.0
"""Where the relaxation of a state begins, as a logit: 0.88 of the way in a tick."""

SMALL = 0.1
"""Part of its usual size with which a last layer begins."""


class Run(NamedTuple):
    """A free run, scaled: predictions (L, M, T, B), and the states (L, M, F, B) that they were made with."""

    y: Tensor
    x: Tensor


class Networks(nn.Module):
    """M members of the networks of a layout, of a recipe's shape.

    All values are scaled: states x (M, F, B), inputs u = [signals; signals a tick before; 0] (M, 2 nz + 1, B).
    """

    def __init__(self, layout: Layout, recipe: Recipe, members: int) -> None:
        super().__init__()
        self.recipe, self.members = recipe, members
        self._period_s = layout.model.period_s
        self.columns = layout.since if recipe.both_ends else layout.rates
        self.rates = Stack(self.columns, members, recipe.hidden, SMALL, layout.padding)
        simple = all(layout.direct(t) is not None for t in range(len(layout.tests)))
        hidden = () if simple and not recipe.learns_h else recipe.hidden
        self.outputs = Stack(layout.outputs, members, hidden, SMALL, layout.padding)
        self.direct = [t for t in range(len(layout.tests)) if layout.direct(t) is not None and not recipe.learns_h]
        if hidden:  # beside functions that are learnt a state stays what it is
            with torch.no_grad():
                for last in (self.outputs.weights[-1], self.outputs.biases[-1]):
                    last.view(members, len(layout.tests), -1)[:, self.direct] = 0.0
        self.logit = nn.Parameter(torch.full((members, len(layout.states), 1), SPEED))
        self.lowest: Tensor
        self.highest: Tensor
        for name, value in (("lowest", -torch.inf), ("highest", torch.inf)):
            self.register_buffer(name, torch.full((members, len(layout.states), 1), value))

    def bound(self, lowest: Array, highest: Array) -> None:
        """Keep the states (F,) within these values: what runs away in one test would end the graph of all."""
        for buffer, value in ((self.lowest, lowest), (self.highest, highest)):
            buffer[:] = torch.as_tensor(value, dtype=buffer.dtype)[:, None]

    def advanced(self, x: Tensor, u: Tensor) -> Tensor:
        """The states after a tick with inputs u."""
        f: Tensor = self.rates(torch.cat([x, u], dim=1))
        if self.recipe.cell == "increment":
            after = x + self._period_s * f
        else:
            after = torch.lerp(x, f, torch.sigmoid(self.logit))
        return torch.clamp(after, self.lowest, self.highest)

    def predicted(self, x: Tensor, u: Tensor) -> Tensor:
        """What the tests predict (M, T, B)."""
        out: Tensor = self.outputs(torch.cat([x, u], dim=1))
        return out

    def step(self, x: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """Prediction and states after a tick, in the recipe's order."""
        if self.recipe.newest:
            x = self.advanced(x, u)
            return self.predicted(x, u), x
        return self.predicted(x, u), self.advanced(x, u)

    def run(self, x: Tensor, u: Tensor) -> Run:
        """From the states x over inputs u (L, M, 2 nz + 1, B), on the inputs alone."""
        ys, xs = [], []
        for now in u:
            y, after = self.step(x, now)
            ys.append(y)
            xs.append(after if self.recipe.newest else x)
            x = after
        return Run(torch.stack(ys), torch.stack(xs))

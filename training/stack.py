"""Small networks side by side: the same function of every member and every state, each with weights of its own.

Values are (M, C, B): members, columns, batch. A function takes D columns of C, and gives a linear part plus a network:

    out = lin a + w' relu(... relu(W1 a + b1) ...) + bias,     a (D, B)

so that M F functions are a few batched matrix products. The linear part is the first row of the first product.
"""

import itertools
from collections.abc import Sequence
from math import sqrt

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

Columns = npt.NDArray[np.intp]


class Stack(nn.Module):
    """F functions of D columns for M members, with hidden layers of these widths (none: linear).

    `small` is how small the last layer begins: a network then begins as its linear part.
    """

    def __init__(self, columns: Columns, members: int, hidden: Sequence[int], small: float, padding: int) -> None:
        super().__init__()
        index = torch.as_tensor(columns, dtype=torch.long)  # (F, D)
        self.index: Tensor
        self.register_buffer("index", index.reshape(-1), persistent=False)
        self.functions, self.arguments = index.shape
        self.members, self.hidden = members, tuple(hidden)
        used = (index != padding).to(torch.float32)  # what pads takes no part in how large weights begin
        count = used.sum(dim=1, keepdim=True).clamp(min=1.0).repeat(members, 1)  # (MF, 1)
        mask = used.repeat(members, 1)[:, None, :]
        size, rows = members * self.functions, 1 + (hidden[0] if hidden else 0)
        first = (torch.rand(size, rows, self.arguments) * 2 - 1) / count[:, None].sqrt() * mask
        first[:, 0] = 0.0
        self.first = nn.Parameter(first)
        self.bias = nn.Parameter(torch.zeros(size, rows, 1))
        self.weights, self.biases = nn.ParameterList(), nn.ParameterList()
        widths = [*hidden, 1]
        for before, after in itertools.pairwise(widths):
            last = after == 1 and len(self.weights) == len(hidden) - 1
            bound = (small if last else 1.0) / sqrt(before)
            self.weights.append(nn.Parameter((torch.rand(size, after, before) * 2 - 1) * bound))
            self.biases.append(nn.Parameter(torch.zeros(size, after, 1)))
        if hidden:
            with torch.no_grad():
                self.bias[:, 1:] = (torch.rand(size, rows - 1, 1) * 2 - 1) / count[:, None].sqrt()

    def forward(self, columns: Tensor) -> Tensor:
        """The functions' values (M, F, B) at columns (M, C, B)."""
        batch = columns.shape[2]
        if not self.functions:
            return columns.new_zeros(self.members, 0, batch)
        a = columns.index_select(1, self.index).reshape(-1, self.arguments, batch)
        both = torch.baddbmm(self.bias, self.first, a)
        out = both[:, :1]
        if self.hidden:
            h = both[:, 1:]
            for weight, bias in zip(self.weights, self.biases, strict=True):
                h = torch.baddbmm(bias, weight, torch.relu(h))
            out = out + h
        return out.reshape(self.members, self.functions, batch)

    def set_linear(self, lin: Tensor, bias: Tensor) -> None:
        """The linear parts (M, F, D) and what they add (M, F)."""
        with torch.no_grad():
            self.first[:, 0] = lin.reshape(len(self.first), self.arguments)
            self.bias[:, 0, 0] = bias.reshape(-1)

"""Networks for other scales: the same functions of the same values, exactly, as the first and last layers are affine.

A short recording covers a part of what a long one did. With the scales of the long one all of its values lie close
together, and a training on it goes badly: from 5 min of a truck t12 erred 1.9 and 2.6 times as much with a bench's
scales as with its own (two seeds, simulated).
"""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from faultline.training.layout import Layout
from faultline.training.network import Networks
from faultline.training.recipe import Recipe
from faultline.training.scaling import Scaling
from faultline.training.stack import Stack

Array = npt.NDArray[np.float64]

LEAST = 0.1
"""Of the scales before: a signal that hardly moves in a short recording has moved in others."""


def at_least(own: Scaling, before: Scaling) -> Scaling:
    """Return a recording's own scaling, with sizes of `LEAST` of those before at least."""
    z_size, x_size = np.maximum(own.z_size, LEAST * before.z_size), np.maximum(own.x_size, LEAST * before.x_size)
    return Scaling(own.z_offset, z_size, own.x_offset, x_size)


def rescaled(
    weights: Mapping[str, Tensor], layout: Layout, recipe: Recipe, before: Scaling, after: Scaling
) -> dict[str, Tensor]:
    """Return the weights of networks that compute with the scaling `after` what these do with the one `before`."""
    networks = Networks(layout, recipe, recipe.members)
    networks.load_state_dict(weights)
    networks.to(torch.float64)
    (size, offset), (old_size, old_offset) = _columns(after), _columns(before)
    factor, moved = size / old_size, (offset - old_offset) / old_size
    states = before.x_size / after.x_size, (before.x_offset - after.x_offset) / after.x_size
    predicts = layout.predicts
    z_size, z_offset = after.z_size[predicts], after.z_offset[predicts]
    outputs = before.z_size[predicts] / z_size, (before.z_offset[predicts] - z_offset) / z_size
    rates = (states[0], np.zeros_like(states[1])) if recipe.cell == "increment" else states
    with torch.no_grad():
        _rescale(networks.rates, factor, moved, *rates)
        _rescale(networks.outputs, factor, moved, *outputs)
        for bound in (networks.lowest, networks.highest):
            bound[:] = bound * torch.as_tensor(states[0])[:, None] + torch.as_tensor(states[1])[:, None]
    return {name: value.to(torch.float32) for name, value in networks.state_dict().items()}


def _columns(of: Scaling) -> tuple[Array, Array]:
    """Sizes and offsets of the columns [states; signals; signals before; 0]."""
    size = np.concatenate([of.x_size, of.z_size, of.z_size, [1.0]])
    return size, np.concatenate([of.x_offset, of.z_offset, of.z_offset, [0.0]])


def _rescale(stack: Stack, factor: Array, moved: Array, times: Array, plus: Array) -> None:
    """Arguments are `factor` times what they were, and moved; values (F,) are `times` what they were, `plus` that."""
    columns = stack.index.reshape(stack.functions, -1).numpy()
    first = stack.first.view(stack.members, stack.functions, -1, stack.arguments)
    bias = stack.bias.view(stack.members, stack.functions, -1, 1)
    bias += first @ torch.as_tensor(moved[columns])[:, :, None]
    first *= torch.as_tensor(factor[columns])[:, None, :]
    scale = torch.as_tensor(times)[:, None, None]
    for layer in (first[:, :, :1], bias[:, :, :1]):
        layer *= scale
    bias[:, :, :1] += torch.as_tensor(plus)[:, None, None]
    for last in [*stack.weights[-1:], *stack.biases[-1:]]:
        of_function = last.view(stack.members, stack.functions, *last.shape[1:])
        of_function *= scale

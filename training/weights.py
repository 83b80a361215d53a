"""From trained networks to the arrays that a graph is written from."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from analysis.graph.bank import PERIOD_S
from analysis.graph.cells import Cells, Functions, Novelty, Variance
from training.layout import Layout
from training.network import Networks
from training.scaling import Scaling
from training.stack import Stack
from training.variance import Variances

Array = npt.NDArray[np.float64]
Columns = npt.NDArray[np.intp]


def cells_of(layout: Layout, scaling: Scaling, networks: Networks, variances: Variances, novelty: Novelty) -> Cells:
    """The cells of trained networks."""
    relaxes = networks.recipe.cell == "relaxation"
    speed = torch.sigmoid(networks.logit[:, :, 0]) if relaxes else torch.full_like(networks.logit[:, :, 0], PERIOD_S)
    held = layout.held if networks.recipe.both_ends else ()
    return Cells(
        members=networks.members,
        z_offset=scaling.z_offset,
        z_size=scaling.z_size,
        x_offset=scaling.x_offset,
        x_size=scaling.x_size,
        owner=layout.owner,
        held=held,
        rates=_functions(networks.rates, _columns(layout, networks.columns, layout.owner, held)),
        outputs=_functions(networks.outputs, _columns(layout, layout.outputs, np.arange(len(layout.tests)), held)),
        speed=_array(speed),
        relaxes=relaxes,
        newest=networks.recipe.newest,
        predicts=layout.predicts,
        variance=_variance(variances),
        novelty=novelty,
    )


def _columns(layout: Layout, columns: Columns, owner: Columns, held: Sequence[tuple[int, int]]) -> Columns:
    """The columns as a graph has them: of what was a tick before, only what each test holds."""
    last = len(layout.states) + len(layout.signals)
    found = np.full(columns.shape, last + len(held), dtype=np.intp)
    for f, row in enumerate(columns):
        for k, column in enumerate(row[row != layout.padding]):
            found[f, k] = column if column < last else last + held.index((int(owner[f]), int(column) - last))
    return found


def _functions(stack: Stack, columns: Columns) -> Functions:
    layers = _layers(stack)
    return Functions(columns, _array(stack.first[:, 0]), _array(stack.bias[:, 0, 0]), layers)


def _layers(stack: Stack) -> tuple[tuple[Array, Array], ...]:
    if not stack.hidden:
        return ()
    first = (_array(stack.first[:, 1:]), _array(stack.bias[:, 1:, 0]))
    rest = zip(stack.weights, stack.biases, strict=True)
    return (first, *((_array(weight), _array(bias[:, :, 0])) for weight, bias in rest))


def _variance(of: Variances) -> Variance:
    """The linear part and the network as one: a linear part is a pair of ReLUs."""
    stack, layers = of.stack, list(_layers(of.stack))
    lin, bias = _array(stack.first[:, :1]), _array(stack.bias[:, :1, 0])
    weight, shift = layers[0]
    layers[0] = (np.concatenate([weight, lin, -lin], axis=1), np.concatenate([shift, bias, -bias], axis=1))
    after, constant = layers[1]
    ones = np.ones((*after.shape[:2], 1))
    layers[1] = (np.concatenate([after, ones, -ones], axis=2), constant)
    return Variance(of.columns, tuple(layers), _array(of.factor))


def _array(value: Tensor) -> Array:
    return np.asarray(value.detach().numpy(), dtype=np.float64)

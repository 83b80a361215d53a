"""From trained networks to the arrays that a graph is written from."""

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
    return Cells(
        members=networks.members,
        z_offset=scaling.z_offset,
        z_size=scaling.z_size,
        x_offset=scaling.x_offset,
        x_size=scaling.x_size,
        owner=layout.owner,
        held=layout.held,
        rates=_functions(networks.rates, _columns(layout, networks.columns, layout.owner, len(layout.states))),
        outputs=_functions(
            networks.outputs, _columns(layout, layout.outputs, np.arange(len(layout.tests)), len(layout.states))
        ),
        speed=_array(speed),
        relaxes=relaxes,
        newest=networks.recipe.newest,
        predicts=layout.predicts,
        variance=_variance(layout, variances),
        novelty=novelty,
    )


def _columns(layout: Layout, columns: Columns, owner: Columns, states: int) -> Columns:
    """Columns of [states; signals; signals before; 0] as a graph has them: before, only what each test holds."""
    last = states + len(layout.signals)
    found = np.full(columns.shape, last + len(layout.held), dtype=np.intp)
    for f, row in enumerate(columns):
        for k, column in enumerate(row[row != last + len(layout.signals)]):
            found[f, k] = column if column < last else last + layout.held.index((int(owner[f]), int(column) - last))
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


def _variance(layout: Layout, of: Variances) -> Variance:
    """The linear part and the network as one: a linear part is a pair of ReLUs."""
    stack, layers = of.stack, list(_layers(of.stack))
    lin, bias = _array(stack.first[:, :1]), _array(stack.bias[:, :1, 0])
    weight, shift = layers[0]
    layers[0] = (np.concatenate([weight, lin, -lin], axis=1), np.concatenate([shift, bias, -bias], axis=1))
    after, constant = layers[1]
    ones = np.ones((*after.shape[:2], 1))
    layers[1] = (np.concatenate([after, ones, -ones], axis=2), constant)
    columns = _columns(layout, of.columns, np.arange(len(layout.tests)), 2 * len(layout.states))
    return Variance(columns, tuple(layers), _array(of.factor))


def _array(value: Tensor) -> Array:
    return np.asarray(value.detach().numpy(), dtype=np.float64)

"""From trained networks to the arrays that a graph is written from."""

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from faultline.analysis.graph.cells import Cells, Functions, Variance
from faultline.training.layout import Layout
from faultline.training.network import Networks
from faultline.training.scaling import Scaling
from faultline.training.stack import Stack
from faultline.training.variance import Variances

Array = npt.NDArray[np.float64]
Columns = npt.NDArray[np.intp]


def cells_of(layout: Layout, scaling: Scaling, networks: Networks, variances: Variances) -> Cells:
    """The cells of trained networks."""
    period_s = layout.model.period_s
    relaxes = networks.recipe.cell == "relaxation"
    states, tests = len(layout.states), len(layout.tests)
    speed = torch.sigmoid(networks.logit[:, :, 0]) if relaxes else torch.full_like(networks.logit[:, :, 0], period_s)
    return Cells(
        members=networks.members,
        z_offset=scaling.z_offset,
        z_size=scaling.z_size,
        x_offset=scaling.x_offset,
        x_size=scaling.x_size,
        owner=layout.owner,
        held=layout.held,
        rates=Functions(_columns(layout, networks.columns, layout.owner, states), _layers(networks.rates)),
        outputs=Functions(_columns(layout, layout.outputs, np.arange(tests), states), _layers(networks.outputs)),
        speed=_array(speed),
        lowest=_array(networks.lowest[:, :, 0]),
        highest=_array(networks.highest[:, :, 0]),
        relaxes=relaxes,
        newest=networks.recipe.newest,
        predicts=layout.predicts,
        variance=_variance(layout, variances),
    )


def _columns(layout: Layout, columns: Columns, owner: Columns, states: int) -> Columns:
    """Columns of [states; signals; signals before; 0] as a graph has them: before, only what each test holds."""
    last = states + len(layout.signals)
    found = np.full(columns.shape, last + len(layout.held), dtype=np.intp)
    for f, row in enumerate(columns):
        for k, column in enumerate(row[row != last + len(layout.signals)]):
            found[f, k] = column if column < last else last + layout.held.index((int(owner[f]), int(column) - last))
    return found


def _layers(stack: Stack) -> tuple[tuple[Array, Array], ...]:
    """The linear part and the network as one: a linear part is a pair of ReLUs, handed on from layer to layer."""
    lin, bias = _array(stack.first[:, :1]), _array(stack.bias[:, :1, 0])
    if not stack.hidden:
        return ((lin, bias),)
    weight, shift = _array(stack.first[:, 1:]), _array(stack.bias[:, 1:, 0])
    layers = [(np.concatenate([weight, lin, -lin], axis=1), np.concatenate([shift, bias, -bias], axis=1))]
    for after, constant in zip(stack.weights, stack.biases, strict=True):
        layers.append(_beside(_array(after), _array(constant[:, :, 0]), last=after is stack.weights[-1]))
    return tuple(layers)


def _beside(weight: Array, bias: Array, last: bool) -> tuple[Array, Array]:
    """A layer (N, after, before) that hands on two inputs more as they are, or takes their difference at last."""
    count, after, before = weight.shape
    pair = np.array([[1.0, -1.0]]) if last else np.eye(2)
    rows = after if last else after + 2
    out = np.zeros((count, rows, before + 2))
    out[:, :after, :before] = weight
    out[:, -len(pair) :, before:] = pair
    return out, bias if last else np.concatenate([bias, np.zeros((count, 2))], axis=1)


def _variance(layout: Layout, of: Variances) -> Variance:
    columns = _columns(layout, of.columns, np.arange(len(layout.tests)), 2 * len(layout.states))
    return Variance(Functions(columns, _layers(of.stack)), _array(of.factor))


def _array(value: Tensor) -> Array:
    return np.asarray(value.detach().numpy(), dtype=np.float64)

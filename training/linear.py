"""Where a training begins: every function as the linear function that one-step least squares gives."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from faultline.training.layout import Layout
from faultline.training.reckoned import Example
from faultline.training.scaling import Scaling

Array = npt.NDArray[np.float64]
Columns = npt.NDArray[np.intp]

RIDGE = 1e-3
"""Of the squared size of the data: two signals that always moved together share their effect."""


class Linear(NamedTuple):
    """Linear parts (N, D) and constants (N,) of N functions, scaled."""

    lin: Array
    constant: Array


def linear_rates(
    layout: Layout, columns: Columns, examples: Sequence[Example], scaling: Scaling, share: float
) -> Linear:
    """Of the state functions of these columns: relaxations by `share` of the way a tick."""
    tables, targets = [], []
    for example in examples:
        x, z = scaling.x(example.x), scaling.z(example.z)
        tables.append(_table(x[:-1], z[1:], z[:-1]))
        targets.append(x[:-1] + (x[1:] - x[:-1]) / share)
    return _solved(columns, layout.padding, np.concatenate(tables), np.concatenate(targets))


def linear_outputs(layout: Layout, examples: Sequence[Example], scaling: Scaling) -> Linear:
    """Of the output functions; one that is a state is exactly that."""
    x = np.concatenate([scaling.x(example.x) for example in examples])
    z = np.concatenate([scaling.z(example.z) for example in examples])
    y = np.concatenate([scaling.y(example.y, layout.predicts) for example in examples])
    lin, constant = _solved(layout.outputs, layout.padding, _table(x, z, z), y)
    for t, column in enumerate(layout.predicts):
        state = layout.direct(t)
        if state is not None:
            lin[t] = 0.0
            lin[t, 0] = scaling.x_size[state] / scaling.z_size[column]
            constant[t] = (scaling.x_offset[state] - scaling.z_offset[column]) / scaling.z_size[column]
    return Linear(lin, constant)


def _table(x: Array, z: Array, before: Array) -> Array:
    return np.hstack([x, z, before, np.zeros((len(z), 1))])


def _solved(columns: Columns, padding: int, table: Array, targets: Array) -> Linear:
    """Ridge regression of targets (K, N) on the columns (N, D) of the table (K, C)."""
    lin, constant = np.zeros(columns.shape), np.zeros(len(columns))
    for f, used in enumerate(columns):
        a = np.hstack([table[:, used], np.ones((len(table), 1))])
        weight = RIDGE * len(a) * np.diag([*[1.0] * len(used), 1e-9])
        solved = np.linalg.solve(a.T @ a + weight, a.T @ targets[:, f])
        lin[f], constant[f] = solved[:-1], solved[-1]
    lin[columns == padding] = 0.0
    return Linear(lin, constant)

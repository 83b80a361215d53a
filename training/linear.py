"""Where a training begins: every function as the linear function that one-step least squares gives."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from training.layout import Layout
from training.samples import Samples
from training.scaling import Scaling

Array = npt.NDArray[np.float64]

RIDGE = 1e-3
"""Of the squared size of the data: two signals that always moved together share their effect."""


class Linear(NamedTuple):
    """Linear parts (N, D) and constants (N,) of N functions, scaled."""

    lin: Array
    constant: Array


def linear_rates(layout: Layout, samples: Samples, known: Sequence[Array], scaling: Scaling, share: float) -> Linear:
    """Of the state functions: relaxations by `share` of the way a tick.

    `known` are the states (K, F) of every stretch, as they are reckoned.
    """
    tables, targets = [], []
    for stretch, found in zip(samples.stretches, known, strict=True):
        x, z = scaling.x(found), scaling.z(stretch.z)
        tables.append(_table(x[:-1], z[1:]))
        targets.append(x[:-1] + (x[1:] - x[:-1]) / share)
    return _solved(layout.rates, layout.padding, np.concatenate(tables), np.concatenate(targets))


def linear_outputs(layout: Layout, samples: Samples, known: Sequence[Array], scaling: Scaling) -> Linear:
    """Of the output functions; one that is a state is exactly that."""
    x = np.concatenate([scaling.x(found) for found in known])
    z = np.concatenate([scaling.z(stretch.z) for stretch in samples.stretches])
    lin, constant = _solved(layout.outputs, layout.padding, _table(x, z), z[:, layout.predicts])
    for t, column in enumerate(layout.predicts):
        state = layout.direct(t)
        if state is not None:
            lin[t] = 0.0
            lin[t, 0] = scaling.x_size[state] / scaling.z_size[column]
            constant[t] = (scaling.x_offset[state] - scaling.z_offset[column]) / scaling.z_size[column]
    return Linear(lin, constant)


def _table(x: Array, z: Array) -> Array:
    return np.hstack([x, z, np.zeros((len(z), 1))])


def _solved(columns: npt.NDArray[np.intp], padding: int, table: Array, targets: Array) -> Linear:
    """Ridge regression of targets (K, N) on the columns (N, D) of the table (K, C)."""
    lin, constant = np.zeros(columns.shape), np.zeros(len(columns))
    for f, used in enumerate(columns):
        a = np.hstack([table[:, used], np.ones((len(table), 1))])
        weight = RIDGE * len(a) * np.diag([*[1.0] * len(used), 1e-9])
        solved = np.linalg.solve(a.T @ a + weight, a.T @ targets[:, f])
        lin[f], constant[f] = solved[:-1], solved[-1]
    lin[columns == padding] = 0.0
    return Linear(lin, constant)

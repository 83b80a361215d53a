"""What recordings leave open of a function of signals alone: there the members differ as much as they may.

Signals that always moved together tell what they do together, and not what each does. Regression towards a prior
w0 ~ N(0, 4) leaves p^2/(v + p^2) of it in a principal direction of the scaled inputs in which they moved by the
variance v: nothing where they moved, all of it where they did not. What follows from the stronger directions, straight
or bent, is no movement of its own, and neither is noise. Each member gets a draw of its own, so that sigma grows as
soon as the inputs leave what was recorded (randomised priors: Osband, Aslanides and Cassirer 2018); the members' mean
stays.
"""

import numpy as np
import numpy.typing as npt
import torch

from faultline.training.layout import Layout
from faultline.training.network import Networks
from faultline.training.windows import Windows

Array = npt.NDArray[np.float64]

UNSEEN = 0.1
"""Spread p of a direction of the inputs, scaled, that was half seen."""

EACH = 20
"""Ticks that each bent term must have."""

GAIN = 2.0
"""Standard deviation of the prior, scaled: a signal that moved little has a gain beyond one (chosen on a simulated loop
of a pump and a valve, where 1 left two of four signals unsaid that never moved alone)."""


def differ(networks: Networks, layout: Layout, windows: Windows, seed: int) -> None:
    """Add to the members' output functions of tests without states what the recordings leave open."""
    rng = np.random.default_rng([seed, networks.members])
    z = np.concatenate([windows.z[begin:end].numpy() for begin, end in windows.measured]).astype(np.float64)
    noise, first, stack = _noise(z), len(layout.states), networks.outputs
    lin = stack.first.view(stack.members, stack.functions, -1, stack.arguments)
    bias = stack.bias.view(stack.members, stack.functions, -1)
    for t, test in enumerate(layout.tests):
        used = np.flatnonzero(layout.outputs[t] != layout.padding)
        if test.states or not len(used):  # a sensor alone is predicted to be constant
            continue
        columns = layout.outputs[t][used] - first
        prior = GAIN * rng.normal(size=(networks.members, len(used)))
        prior = (prior - prior.mean(axis=0)) * np.sqrt(networks.members / max(networks.members - 1, 1))
        added = prior @ left_open(z[:, columns], noise[columns])
        with torch.no_grad():
            lin[:, t, 0, used] += torch.as_tensor(added, dtype=torch.float32)
            bias[:, t, 0] -= torch.as_tensor(added @ z[:, columns].mean(axis=0), dtype=torch.float32)


def left_open(inputs: Array, noise: Array) -> Array:
    """Return the part (D, D) of a prior that inputs (K, D) with noise (D,) leave, as a symmetric matrix."""
    centred = inputs - inputs.mean(axis=0)
    _, directions = np.linalg.eigh(np.atleast_2d(np.cov(inputs.T)))
    scores, moved = centred @ directions, np.zeros(len(noise))
    for k, score in enumerate(scores.T):
        stronger = scores[:, k + 1 :]
        pairs = [*zip(*np.triu_indices(stronger.shape[1]), strict=True)]
        few = len(pairs) * EACH > len(score)  # as many terms as ticks explain all
        bent = [] if few else [stronger[:, i] * stronger[:, j] for i, j in pairs]
        table = np.column_stack([np.ones(len(score)), stronger, *bent])
        own = score - table @ np.linalg.lstsq(table, score, rcond=None)[0]
        moved[k] = max(own.var() - (noise**2 @ directions[:, k] ** 2), 0.0)
    return np.asarray((directions * (UNSEEN**2 / (moved + UNSEEN**2))) @ directions.T)


def _noise(z: Array) -> Array:
    """Return the standard deviation (nz,) of white noise in signals (K, nz), from the median second difference."""
    return np.asarray(1.4826 / np.sqrt(6.0) * np.median(np.abs(np.diff(z, 2, axis=0)), axis=0))

"""The information that a drive has on faults, in nats: what the best detector of all could know.

Block means are linear and Gaussian (`core.decision.baseline`): a fault since block k0 shifts the whitened innovations
by g_k. So the log-likelihood ratio of this fault to none is Gaussian under the fault, of mean J and variance 2 J,

    J(n) = 1/2 sum_{k = k0 .. n} g_k' g_k        [nats],

the Kullback-Leibler information. With alarms that are T apart without a fault, no detector that sees a block each T_b
has a shorter mean delay than the time until J has reached ln(T / T_b), asymptotically (Lorden, Annals of Mathematical
Statistics 42, 1971; Lai, IEEE Trans. Information Theory 44, 1998). It knows onset, fault and size, and is none that can
be built: the fault has to be looked for. Two faults are told apart by the information on one against the other at its
best size (Eriksson, Frisk, Krysander, Automatica 49, 2013). What the drive's baseline and the visits do is in g: the
covariances are the bundle's.
"""

from collections.abc import Sequence

import numpy as np

from faultline.service.core.decision.baseline import BaselineFilter, BaselineModel, signature
from faultline.service.core.decision.blocks import Block
from faultline.service.core.decision.look import Segments
from faultline.service.core.signals.values import FloatArray, Indices, Mask


def signatures(blocks: Sequence[Block], model: BaselineModel, onsets: Indices) -> FloatArray:
    """Return g (O, N, H, K): the shift of the whitened innovations of N blocks of one log, by H hypotheses.

    `onsets` (O,) are the blocks with which the fault begins.
    """
    baseline, count = BaselineFilter(model), blocks[0].shift.shape[1]
    effect = np.zeros((1, len(onsets), count, model.states))
    found = np.zeros((len(onsets), len(blocks), count, model.offset.shape[1]))
    for k, block in enumerate(blocks):
        innovation = baseline.step(block)
        shift = block.shift[:, None] * (k >= onsets)[None, :, None, None]
        effect, g = signature(effect, innovation, shift, (block.ticks > 0).astype(np.float64))
        found[:, k] = g[0]
    return found


def information(g: FloatArray) -> FloatArray:
    """Return J (O, N, H) since each onset [nats]."""
    return np.asarray((g**2).sum(axis=-1).cumsum(axis=1) / 2.0)


def delays(J: FloatArray, since_s: FloatArray, nats: float) -> FloatArray:
    """Return how long it takes (O, H) [s] until J has reached `nats`; inf where it does not within the drive.

    `since_s` (O, N) is the time from the onset to the end of each block.
    """
    reached = np.greater_equal(J, nats)
    first = reached.argmax(axis=1)
    return np.where(reached.any(axis=1), np.take_along_axis(since_s, first, axis=1), np.inf)


def smallest(J: FloatArray, sizes: FloatArray, nats: float) -> FloatArray:
    """Return the smallest size (O,) of which J is `nats`; inf beyond the largest, as nothing is assumed there.

    `J` (O, S) is the information on the sizes (S,) of a chain, from the smallest on. Between two it is a power of the
    size, and below the first its square.

    >>> smallest(np.array([[4.0, 16.0], [16.0, 64.0], [1.0, 2.0]]), np.array([1.0, 2.0]), 9.0)
    array([1.5 , 0.75,  inf])
    """
    found = np.full(len(J), np.inf)
    for row, each in enumerate(J):
        above = np.flatnonzero(each >= nats)
        if len(above) and above[0] == 0:
            found[row] = sizes[0] * np.sqrt(nats / each[0])
        elif len(above):
            k = above[0]
            below = max(each[k - 1], 1e-300)
            part = np.log(nats / below) / np.log(each[k] / below)
            found[row] = sizes[k - 1] * (sizes[k] / sizes[k - 1]) ** part
    return found


def against(g: FloatArray, segments: Segments) -> FloatArray:
    """Return the information (H, S) on each hypothesis against each segment of sizes, at its best size [nats].

    `g` (N, H, K) is of one onset.
    """
    H = g.shape[1]
    X = np.concatenate([np.zeros((1, g.shape[0] * g.shape[2])), g.swapaxes(0, 1).reshape(H, -1)])
    gram = X @ X.T
    begin, end = segments.begin, segments.end
    own = np.arange(1, H + 1)
    square = gram.diagonal()
    way = np.maximum(square[end] - 2.0 * gram[begin, end] + square[begin], 1e-300)  # (S,)
    along = gram[own][:, end] - gram[own][:, begin] - (gram[begin, end] - square[begin])
    far = square[own][:, None] - 2.0 * gram[own][:, begin] + square[begin]
    part = np.clip(along / way, 0.0, 1.0)
    return np.asarray(np.maximum(far - 2.0 * part * along + part**2 * way, 0.0) / 2.0)


def rates(J: FloatArray, blocks: Sequence[Block], since_s: FloatArray, within_s: float, modes: int) -> FloatArray:
    """Return the information a second (modes, H) that the first `within_s` after an onset bring, mode by mode [nats/s].

    Row 0, the edge, is zero; NaN where a mode was not seen.
    """
    gained = np.diff(J, axis=1, prepend=0.0)  # (O, N, H)
    end_s = np.array([float(block.end_s[0]) for block in blocks])
    length = np.diff(end_s, prepend=end_s[0])
    mode = np.array([int(block.mode[0]) for block in blocks])
    length = np.minimum(length, float(np.median(length)))  # an edge before a block is none of its time
    late: Mask = (since_s > 0.0) & (since_s <= within_s)
    found = np.full((modes, J.shape[2]), np.nan)
    found[0] = 0.0
    for each in range(1, modes):
        inside = late & (mode == each)
        seconds = float((inside * length).sum())
        if seconds > 0.0:
            found[each] = (gained * inside[..., None]).sum(axis=(0, 1)) / seconds
    return found

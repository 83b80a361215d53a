"""A recording does not excite an input where it does not show what that does alone.

Where a controller drives the plant, its inputs move with its outputs, and a network cannot learn which of them does
what (Forssell and Ljung, Closed-loop identification revisited, Automatica 35, 1999). It shows where one input is moved
by itself: the members, which agree on what was recorded, come apart there, and sigma grows.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from faultline.analysis.graph.bank import started
from faultline.analysis.graph.networks import Networks
from faultline.service.core.residuals.generators import Graph
from faultline.training.layout import Layout
from faultline.training.samples import Samples
from faultline.training.varied import slow_noise

MOVED = 0.3
"""A signal is moved alone by this part of its spread."""

GROWN = 1.2
"""Times by which sigma grows where a signal is not excited: 1.2 to 1.7 in recordings of a loop, at most 1.12 in those
of random set points (simulated; chosen on these recordings of one bench)."""


class Unexcited(NamedTuple):
    """A signal whose effect alone a test's networks have not seen, and how much larger sigma is where it moves."""

    test: str
    signal: str
    times: float


def unexcited(layout: Layout, samples: Samples, networks: Networks) -> list[Unexcited]:
    """Return what the longest stretch does not excite, by the tests that take it, the worst first."""
    stretch = max((each for each in samples.stretches if each.natural), key=lambda each: len(each.z))
    z, signals = stretch.z, layout.signals
    noise = slow_noise(len(z), len(signals), layout.model, np.random.default_rng(0))
    alone = np.eye(len(signals))[:, None] * MOVED * z.std(axis=0) * noise  # (nz, K, nz)
    over = np.stack([z, *(z + each for each in alone)], axis=1)
    sigma = _sigma(networks, over, signals)[len(z) // 3 :]  # states have forgotten their start
    times = np.median(sigma[:, 1:], axis=0) / np.median(sigma[:, :1], axis=0)  # (nz, T)
    found = [
        Unexcited(generator.test, signals[column], float(times[column, row]))
        for row, generator in enumerate(networks.description.generators)
        for column in layout.driven(row)
        if times[column, row] > GROWN
    ]
    return sorted(found, key=lambda each: -each.times)


def _sigma(
    networks: Networks, z: np.ndarray[tuple[int, int, int], np.dtype[np.float64]], signals: Sequence[str]
) -> np.ndarray[tuple[int, int, int], np.dtype[np.float64]]:
    """The networks' sigma (K, B, T) over samples (K, B, nz)."""
    graph = Graph(networks.graph)
    x = np.stack([started(networks.description.generators, signals, first) for first in z[0]])
    sigma = np.empty((*z.shape[:2], len(networks.description.generators)))
    for k, sample in enumerate(z):
        _, _, sigma[k], x = graph(z=np.ascontiguousarray(sample), x=x)
    return sigma

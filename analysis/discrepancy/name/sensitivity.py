"""What the recordings could show, whatever they do show: visible sizes, effects that look alike, and the law of chance.

Around the baseline every effect has a direction: what a unit of its strength does to the whitened data. What remains
of it when everything else that is unknown may move is what can be seen. From the directions alone follow the smallest
size of each effect that evidence would speak for, which effects do the same, and how much evidence the best of them
gets where nothing is missing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

ALIKE = 0.98
"""Cosine between two directions, in the metric of what remains: effects that look the same in these recordings."""

DRAWS = 2000
QUANTILE = 0.99


@dataclass(frozen=True)
class Direction:
    """Of one effect: `does` (M, S) is what its strengths do, at their spreads, and `visible` (M, S) what remains of it.

    `power` (S,) is the product of the two: the precision of a strength by the data alone, in spreads. `lower` and
    `upper` (S,) are the strengths' bounds, in spreads from null; `spreads` (S,) are in their units.
    """

    effect: str
    does: Array
    visible: Array
    lower: Array
    upper: Array
    spreads: Array

    @property
    def power(self) -> Array:
        """Of each strength."""
        return np.asarray(np.sum(self.does * self.visible, axis=0))


def remaining(direction: Array, others: Array) -> Array:
    """What is left (M, S) of a direction when x, N(0, 1) beforehand, may do what it does in `others` (M, n).

    It is the direction divided by the covariance of the data, 1 + others others'.
    """
    H = others.T @ others + np.eye(others.shape[1])
    return np.asarray(direction - others @ np.linalg.solve(H, others.T @ direction))


def smallest(direction: Direction, threshold: float) -> float:
    """The strength, in its unit, from which an effect's evidence is above the threshold [nats] without any noise.

    With noise it is about as often above as below. Infinite where that is beyond its bounds: these recordings cannot
    show the effect.
    """
    power = max(float(direction.power[0]), 1e-150)
    needed = np.sqrt(2.0 * (threshold + 0.5 * np.log1p(power)) * (1.0 + power)) / power
    reach = max(direction.upper[0], -direction.lower[0])
    return float(needed * direction.spreads[0]) if needed <= reach else np.inf


def alike(directions: Sequence[Direction]) -> dict[str, tuple[str, ...]]:
    """For every effect those that look the same in these recordings."""
    root = [np.sqrt(np.maximum(d.power, 1e-300)) for d in directions]
    unit = [(d.does / r, d.visible / r) for d, r in zip(directions, root, strict=True)]
    found = {}
    for d, (a, _) in zip(directions, unit, strict=True):
        cosines = {other.effect: float(np.abs(a.T @ b).max()) for other, (_, b) in zip(directions, unit, strict=True)}
        found[d.effect] = tuple(name for name, c in cosines.items() if name != d.effect and c > ALIKE)
    return found


def chance(directions: Sequence[Direction], left: Array, block: npt.NDArray[np.int64], seed: int = 1) -> float:
    """The evidence [nats] that the best effect stays below, in 99 of 100 cases, where nothing is missing.

    `left` (M,) is what a model that describes the data leaves of them, in blocks (M,) of some seconds. The blocks
    change signs at random (wild bootstrap, Wu 1986): the law has the noise that there is, not what is assumed of it.
    """
    rng = np.random.default_rng(seed)
    signs = rng.choice([-1.0, 1.0], (DRAWS, int(block.max()) + 1))
    best = np.zeros(DRAWS)
    for d in directions:
        pulled = np.zeros((int(block.max()) + 1, d.visible.shape[1]))
        np.add.at(pulled, block, d.visible * left[:, None])
        best = np.maximum(best, _evidence(d, signs @ pulled))
    return float(np.quantile(best, QUANTILE))


def _evidence(d: Direction, g: Array) -> Array:
    """Of the effect (draws,) for gradients (draws, S): one strength at a time, within its bounds."""
    found = np.zeros(len(g))
    for s in range(d.visible.shape[1]):
        power = float(d.power[s]) + 1.0
        size = np.clip(g[:, s] / power, d.lower[s], d.upper[s])
        gain = g[:, s] * size - 0.5 * power * size**2 - 0.5 * np.log(power)
        found = np.maximum(found, np.where(size != 0.0, gain, 0.0))
    return found


def smallest_sizes(directions: Sequence[Direction], threshold: float) -> Mapping[str, float]:
    """`smallest` of every effect."""
    return {d.effect: smallest(d, threshold) for d in directions}

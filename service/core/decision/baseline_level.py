"""The level of the residuals by a drive's baseline, and the residuals without it.

A network's level is that of its twin among the equations, but for how far the two stray apart from drive to drive: both
predict one signal from the same samples.
"""

from collections.abc import Sequence

import numpy as np

from faultline.service.core.decision.baseline import BaselineModel, GaussianState
from faultline.service.core.decision.straying import Apparent, Level, Straying
from faultline.service.core.manifest import Evidence, Follower, Twin
from faultline.service.core.residuals.generators import NO_EXCESS
from faultline.service.core.signals.values import FloatArray

WIDENED = 3.0
"""Detectors see residuals in parts of their spread and of so many standard deviations of what is unknown of the
baseline."""


class BaselineLevel:
    """The level of the generators of the evidence, of their followers and of networks, by a state of the filter."""

    def __init__(self, evidence: Evidence, generators: Sequence[str], model: BaselineModel) -> None:
        followers, networks = evidence.followers, evidence.networks
        names = [*evidence.generators, *(each.generator for each in followers)]
        self._moved = [generators.index(name) for name in (*names, *(each.generator for each in networks))]
        self._twins = [*range(len(names)), *(names.index(each.twin) for each in networks)]
        self._apart = np.zeros((len(evidence.offset) - 1, len(self._twins)))
        for column, network in enumerate(networks, start=len(names)):
            self._apart[:, column] = np.square(network.allowance[1:])
        self._model, self._straying = model, Straying(evidence)
        beside: list[Follower | Twin] = [*followers, *networks]
        self._offset = np.column_stack([evidence.offset, *(each.offset for each in beside)])  # (modes, K + F + N)
        self._spread = np.column_stack([evidence.spread, *(each.spread for each in beside)])
        self.follow(model.prior(1))

    def follow(self, state: GaussianState) -> None:
        """Take the baseline of this state of one log."""
        self.state = state
        mean, covariance = self._model.levels(state)
        self.level = Level(mean[0].reshape(self._straying.offset.shape), covariance[0], self._apparent())
        mean, variance = (each[:, self._twins] for each in self._straying.everywhere(self.level))
        mean, variance = (np.vstack([each.mean(axis=0), each]) for each in (mean, variance + self._apart))
        self._mean, self._wider = mean, np.sqrt(1.0 + WIDENED**2 * variance / self._spread**2)

    def _apparent(self) -> Apparent:
        """Return the distribution of the log's apparent faults."""
        model, P = self._model, self.state.covariance[0]
        columns, H = model.apparent, model.usual
        return Apparent(
            mean=self.state.mean[0, columns],
            covariance=P[columns, columns],
            cross=H @ P[:, columns],
            usual=H[:, columns].T,
            rows=model.apparent_rows,
            part=model.apparent_part,
        )

    def taken_off(self, mode: int, residuals: FloatArray, excess: FloatArray = NO_EXCESS) -> FloatArray:
        """Return the residuals (..., T) of ticks without the baseline; those of networks without a twin as they are.

        The less is known of the baseline, and the larger the `excess` (T,) of a network's variance, the nearer they are
        to the offset: a detector's threshold then is the spread of drives, and not that within one. At an edge the
        baseline is the mean of those of all modes.
        """
        level = residuals.copy()
        offset, moved, wider = self._offset[mode], self._moved, self._wider[mode]
        if excess.ndim:
            wider = np.sqrt(wider**2 + excess[..., moved] / self._spread[mode] ** 2)
        level[..., moved] = offset + (residuals[..., moved] - offset - self._mean[mode]) / wider
        return level

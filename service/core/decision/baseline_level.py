"""The level of the residuals by a drive's baseline, and the residuals without it."""

from collections.abc import Sequence

import numpy as np

from faultline.service.core.decision.baseline import BaselineModel, GaussianState
from faultline.service.core.decision.straying import Apparent, Level, Straying
from faultline.service.core.manifest import Evidence
from faultline.service.core.signals.values import FloatArray

WIDENED = 3.0
"""Detectors see residuals in parts of their spread and of so many standard deviations of what is unknown of the
baseline."""


class BaselineLevel:
    """The level of the generators of the evidence, and of those that follow them, by a state of the filter."""

    def __init__(self, evidence: Evidence, generators: Sequence[str], model: BaselineModel) -> None:
        followers = evidence.followers
        self._moved = [generators.index(name) for name in evidence.generators]
        self._moved += [generators.index(each.generator) for each in followers]
        self._model, self._straying = model, Straying(evidence)
        self._offset = np.column_stack([evidence.offset, *(f.offset for f in followers)])  # (modes, K + F)
        self._spread = np.column_stack([evidence.spread, *(f.spread for f in followers)])
        self.follow(model.prior(1))

    def follow(self, state: GaussianState) -> None:
        """Take the baseline of this state of one log."""
        self.state = state
        mean, covariance = self._model.levels(state)
        self.level = Level(mean[0].reshape(self._straying.offset.shape), covariance[0], self._apparent())
        mean, variance = (np.vstack([each.mean(axis=0), each]) for each in self._straying.everywhere(self.level))
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

    def taken_off(self, mode: int, residuals: FloatArray) -> FloatArray:
        """Return the residuals (T,) of a tick without the baseline; those of networks as they are.

        The less is known of the baseline, the nearer they are to the offset: a detector's threshold then is the spread
        of drives, and not that within one. At an edge the baseline is the mean of those of all modes.
        """
        level = residuals.copy()
        offset, moved = self._offset[mode], self._moved
        level[moved] = offset + (residuals[moved] - offset - self._mean[mode]) / self._wider[mode]
        return level

"""Odd visits: the effect of a visit has heavy tails, and a single visit that is odd is no fault.

Beside the baseline's filter runs a second one in which the effect of the present visit has `ODD` times its usual
standard deviation. How much better that explains the visit's means y, less what it costs to be rare,

    G = max(0, ln p(y | odd) - ln p(y | usual) + ln P(odd))        [nats]

is taken off the log-likelihood ratio of every fault that was there in the visit: a fault has to explain what one odd
visit cannot, and usually does so with the next visit.
"""

from copy import copy

import numpy as np

from faultline.service.core.decision.baseline import BaselineFilter, BaselineModel, GaussianState
from faultline.service.core.decision.blocks import Block
from faultline.service.core.signals.values import FloatArray

ODD, PROBABILITY = 4.0, 0.02
"""How much larger an odd visit's effect is, and how often a visit is odd."""


class OddVisits:
    """G of the visits of B logs. State: the second filter, G of the present visit without its cost, and the sum."""

    def __init__(self, model: BaselineModel, logs: int = 1, of_filter: type[BaselineFilter] = BaselineFilter) -> None:
        odd = copy(model)
        odd.stationary = model.stationary.copy()
        odd.stationary[:, model.visit, model.visit] *= ODD**2
        self._filter = of_filter(odd, logs)
        self._present, self._before = np.zeros(logs), np.zeros(logs)

    def begin(self, block: Block, state: GaussianState, end_s: FloatArray) -> None:
        """Take the usual filter's state before a block, where the block begins a visit."""
        begins = block.begins
        self._before = self._before + np.where(begins, self._of_present(), 0.0)
        self._present = np.where(begins, 0.0, self._present)
        old = self._filter.state
        self._filter.state = GaussianState(
            np.where(begins[:, None], state.mean, old.mean),
            np.where(begins[:, None, None], state.covariance, old.covariance),
        )
        self._filter.end_s = end_s

    def step(self, block: Block, usual: FloatArray) -> None:
        """Take a block, whose log density is `usual` (B,) in the usual filter."""
        self._present = self._present + self._filter.step(block).log_density - usual

    @property
    def before(self) -> FloatArray:
        """The sum of G over the visits before the present one (B,)."""
        return self._before

    @property
    def explained(self) -> FloatArray:
        """The sum of G over all visits (B,)."""
        return self._before + self._of_present()

    def _of_present(self) -> FloatArray:
        return np.asarray(np.maximum(self._present + np.log(PROBABILITY), 0.0))

"""The model error adds to the variance of a network's residual where the operation is not as in training.

A network says how large its own error is, by what it has learnt of it and by how far its members are apart. In usual
operation that is in the spread and the noise of the evidence. Beyond it the variance of the error is

    c^2 max(0, sigma^2 - sigma_m^2)        [Pa^2]

with the largest usual sigma_m of the mode, and c as members that learnt from the same recordings err alike. It is no
noise: it lasts as long as the operation does, so that a mean over more ticks is no surer.
"""

from collections.abc import Sequence

import numpy as np

from faultline.service.core.manifest import Evidence
from faultline.service.core.residuals.generators import Residuals

ALIKE = 3.0
"""The members' common error is so many times what they are apart. Chosen on a bench (0 to 4 tried) and on
two trucks of development (1 and 3)."""

MOST = 10.0
"""A generator whose sigma is larger than the usual one by more cannot tell: what it would say weighs nothing."""


class ModelError:
    """The errors of the generators that say how large theirs are; those of the others have no excess."""

    def __init__(self, evidence: Evidence, generators: Sequence[str]) -> None:
        usual = [evidence.sigma.get(name) for name in generators]
        self._is_said = any(each is not None for each in usual)
        modes = len(evidence.offset)
        self._usual = np.array([np.full(modes, np.inf) if each is None else each for each in usual]).T  # (modes, T)

    def beside(self, mode: int, residuals: Residuals) -> Residuals:
        """Return the residuals of a tick with the `excess` (T,) of their variance; who knows nothing cannot tell."""
        if not self._is_said:
            return residuals
        usual = self._usual[mode]
        excess = ALIKE**2 * np.maximum(residuals.sigma**2 - usual**2, 0.0)
        return residuals._replace(excess=excess, usable=residuals.usable & (residuals.sigma <= MOST * usual))

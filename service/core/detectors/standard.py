"""Standardising: what a tick's residuals are to each detector, in parts of the spread expected there.

    s = (r' - offset_m) / (scale_m * sigma / usual_m)       adaptive
    s = (r - offset_m) / scale_m                            spread
    s = (r' - offset_m) / scale_m                           all others

r is the residual, r' the one without the drive's baseline (`core.decision.baseline_level`), m the operating mode, sigma
what the generator itself says of this tick's spread: a network knows where it is less sure. `usual_m` is the sigma that
tuning saw in the mode, so that scale keeps the unit of the residual.
"""

from collections.abc import Sequence

import numpy as np

from faultline.service.core.manifest import AdaptiveDetector, Detector, SpreadDetector
from faultline.service.core.residuals.generators import Residuals
from faultline.service.core.signals.values import FloatArray


class Standard:
    """The standardisation of D detectors; `rows` (D,) are the generators that they look at."""

    def __init__(self, detectors: Sequence[Detector], rows: Sequence[int]) -> None:
        modes = len(detectors[0].offset) if detectors else 0
        shape = len(detectors), modes
        self._rows = np.array(rows, dtype=np.intp)
        self._offset = np.array([detector.offset for detector in detectors]).reshape(shape).T.copy()
        self._scale = np.array([detector.scale for detector in detectors]).reshape(shape).T.copy()
        adaptive = [isinstance(detector, AdaptiveDetector) for detector in detectors]
        self._adaptive = np.array(adaptive, dtype=np.bool_) if any(adaptive) else None
        spread = [isinstance(detector, SpreadDetector) for detector in detectors]
        self._spread = np.array(spread, dtype=np.bool_) if any(spread) else None
        ones = [1.0] * modes
        self._usual = (
            np.array([d.usual if isinstance(d, AdaptiveDetector) else ones for d in detectors]).reshape(shape).T
        )

    def __call__(self, mode: int, residuals: Residuals) -> FloatArray:
        """The standardised residuals (..., D) of ticks for each detector; whatever they are where it cannot tell."""
        if not len(self._rows):
            return np.zeros((*residuals.r.shape[:-1], 0))
        scale = self._scale[mode]
        if self._adaptive is not None:
            scale = scale * np.where(self._adaptive, residuals.sigma[..., self._rows], 1.0) / self._usual[mode]
        level = (residuals.r if residuals.level is None else residuals.level)[..., self._rows]
        if self._spread is not None:
            level = np.where(self._spread, residuals.r[..., self._rows], level)
        return np.asarray((level - self._offset[mode]) / scale)

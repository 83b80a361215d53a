"""The offsets of a vehicle's residuals without a fault, moved: those of its detectors and of its evidence."""

from collections.abc import Sequence
from typing import TypeVar

import msgspec
import numpy as np

from faultline.service.core.manifest import Detector, Evidence, Follower, Manifest, Twin
from faultline.service.core.signals.values import FloatArray

_Beside = TypeVar("_Beside", Follower, Twin)


def shifted(manifest: Manifest, by: FloatArray) -> Manifest:
    """The manifest for a vehicle whose offsets lie further by (T, modes)."""
    names = [generator.name for generator in manifest.generators]
    return msgspec.structs.replace(
        manifest,
        detectors=[shifted_detector(d, by[names.index(d.generator)]) for d in manifest.detectors],
        evidence=shifted_evidence(manifest.evidence, names, by),
    )


def shifted_detector(detector: Detector, by: FloatArray) -> Detector:
    """The detector with its offsets moved by (modes,)."""
    return msgspec.structs.replace(detector, offset=(np.array(detector.offset) + by).tolist())


def shifted_evidence(evidence: Evidence, names: Sequence[str], by: FloatArray) -> Evidence:
    """The evidence with all its offsets moved by (T, modes) of the generators `names`."""

    def moved(each: _Beside) -> _Beside:
        return msgspec.structs.replace(each, offset=(np.array(each.offset) + by[names.index(each.generator)]).tolist())

    own = by[[names.index(name) for name in evidence.generators]]
    return msgspec.structs.replace(
        evidence,
        offset=(np.array(evidence.offset) + own.T).tolist(),
        followers=[moved(each) for each in evidence.followers],
        networks=[moved(each) for each in evidence.networks],
    )

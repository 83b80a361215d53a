"""Fault-free recordings as detectors will see them: without the drive's baseline, as the vehicle takes it off."""

from collections.abc import Sequence
from dataclasses import replace

import msgspec
import numpy as np

from faultline.analysis.tuning.thresholds import Seen
from faultline.service.core.decision.baseline import BaselineFilter, BaselineModel
from faultline.service.core.decision.baseline_level import BaselineLevel
from faultline.service.core.decision.blocks import BlockMeans
from faultline.service.core.manifest import Evidence
from faultline.service.core.residuals.generators import Residuals


def without_baseline(s: Seen, evidence: Evidence, generators: Sequence[str]) -> Seen:
    """The recording without its baseline, as that is known at the end: until it is known, detectors are deafer.

    Residuals of networks stay as they are.
    """
    evidence = msgspec.structs.replace(evidence, graph=None, hypotheses=[])
    model = BaselineModel(evidence, s.time)
    baseline, blocks = BaselineFilter(model), BlockMeans(evidence, generators, s.time)
    for tick, mode, r, usable in zip(s.ticks.tolist(), s.mode.tolist(), s.r, s.usable, strict=True):
        block = blocks.add(tick, mode, Residuals(r, r, r, usable))
        if block is not None:
            baseline.step(block)
    known = BaselineLevel(evidence, generators, model)
    known.follow(baseline.state)
    return replace(s, level=np.array([known.taken_off(mode, r) for mode, r in zip(s.mode.tolist(), s.r, strict=True)]))

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
    done, edges = 0, np.flatnonzero((np.diff(s.mode) != 0) | (np.diff(s.ticks) != 1)) + 1
    for end in (*edges.tolist(), len(s.mode)):
        while done < end:
            mode = int(s.mode[done])
            row = slice(done, int(min(end, done + blocks.room(mode))))
            r = s.r[row]
            block = blocks.extend(int(s.ticks[done]), mode, Residuals(r, r, r, s.usable[row]))
            if block is not None:
                baseline.step(block)
            done = row.stop
    known = BaselineLevel(evidence, generators, model)
    known.follow(baseline.state)
    level = np.empty_like(s.r)
    for mode in np.unique(s.mode).tolist():
        level[s.mode == mode] = known.taken_off(mode, s.r[s.mode == mode])
    return replace(s, level=level)

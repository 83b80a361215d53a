"""What any decision could find of the judged faults on a vehicle (`faultline.analysis.limit`), on its own drives."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from faultline.analysis.limit.drive import blocks_from
from faultline.analysis.limit.information import against, delays, information, signatures
from faultline.analysis.limit.limits import APART, FIRST, LAST, ONSETS
from faultline.service.bundle.load import Bundle
from faultline.service.core.decision.baseline import BaselineModel
from faultline.service.core.decision.blocks import BLOCK, Block
from faultline.service.core.decision.hypotheses import Hypotheses
from faultline.service.core.signals.values import FloatArray
from faultline.testbench.sizes import frozen
from faultline.testbench.traffic import Frame
from faultline.testbench.units import ML

EVERY_H = 500.0
"""Hours from alarm to alarm that the limit is for."""
WITHIN_S = 300.0
"""After the onset: what is not known by then is not told apart."""
LABELS = ("small", "large")
OF_MODEL: dict[str, tuple[str, str | None, float]] = {
    "leak_ap": ("fq_leak", None, ML),
    "fq_pump": ("fq_pump", "eps_p", -1.0),
}
"""Faults of the rig that the model names otherwise: name, form, and the model's unit in the rig's."""


def limit_of(bundle: Bundle, drives: Iterable[Iterable[Frame]]) -> dict[str, Any]:
    """Of each fault and its two sizes: median of the limit's delay [s], share of onsets within `WITHIN_S`, others.

    Nothing where there are no drives. *others* are the faults that this one cannot be told from, after `WITHIN_S` in
    the median.
    """
    manifest = bundle.manifest
    model, segments = BaselineModel(manifest.evidence, manifest.time), Hypotheses(manifest.evidence).segments
    nats = float(np.log(3600.0 * EVERY_H / (manifest.time.ticks(BLOCK) * manifest.time.period_s)))
    names = list(dict.fromkeys(segments.faults))
    asked = [(fault, label, size) for fault, both in frozen().items() for label, size in zip(LABELS, both, strict=True)]
    delayed, close = [], []
    for drive in drives:
        blocks = blocks_of(bundle, drive)
        onsets = np.unique(np.linspace(FIRST * len(blocks), LAST * len(blocks), ONSETS).astype(np.intp))
        g = signatures(blocks, model, onsets)
        g = np.concatenate([g, np.stack([shift(bundle, g, fault, size) for fault, _, size in asked], axis=2)], axis=2)
        end_s = np.array([float(block.end_s[0]) for block in blocks])
        since_s = end_s - np.concatenate([[0.0], end_s])[onsets][:, None]
        delayed.append(delays(information(g), since_s, nats)[:, -len(asked) :])
        for k, onset in enumerate(onsets.tolist()):
            table = against(g[k, onset:][since_s[k, onset:] <= WITHIN_S], segments)[-len(asked) :]
            columns = [[name == of for of in segments.faults] for name in names]
            close.append(np.stack([table[:, np.flatnonzero(own)].min(axis=1) for own in columns], axis=1))
    if not delayed:
        return {}
    delay, information_on = np.concatenate(delayed), np.median(np.array(close), axis=0)
    return _table(asked, names, delay, information_on)


def blocks_of(bundle: Bundle, drive: Iterable[Frame]) -> list[Block]:
    """The block means of a drive, with the shifts of all hypotheses."""
    sent = ((f.t, f.frame_id, True, f.data) for f in drive)
    return blocks_from(bundle, "limit", lambda monitor: monitor.log(sent))


def shift(bundle: Bundle, g: FloatArray, fault: str, size: float) -> FloatArray:
    """The shift (O, N, K) by a size of a fault, on the straight line between the assumed ones that it is between."""
    name, form, unit = OF_MODEL.get(fault, (fault, None, 1.0 if fault.startswith("fy_") else -1.0))
    evidence = bundle.manifest.evidence
    assumed = [
        (each.size / unit, row)
        for row, each in enumerate(evidence.hypotheses[: evidence.simple])
        if (each.fault, each.share_of) == (name, form) and each.size / unit > 0.0
    ]
    sizes, rows = zip(*sorted(assumed), strict=True)
    k = min(int(np.searchsorted(sizes, size)), len(sizes) - 1)
    low, below = (0.0, np.zeros_like(g[:, :, 0])) if k == 0 else (sizes[k - 1], g[:, :, rows[k - 1]])
    part = (size - low) / (sizes[k] - low)
    return np.asarray(below + part * (g[:, :, rows[k]] - below))


def _table(
    asked: Sequence[tuple[str, str, float]], names: Sequence[str], delay: FloatArray, information_on: FloatArray
) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for row, (fault, label, _) in enumerate(asked):
        own = OF_MODEL.get(fault, (fault,))[0]
        median = float(np.median(delay[:, row]))
        found.setdefault(fault, {})[label] = {
            "delay_s": round(median, 1) if np.isfinite(median) else None,
            "within": round(float((delay[:, row] <= WITHIN_S).mean()), 3),
            "others": [name for k, name in enumerate(names) if name != own and information_on[row, k] < APART],
        }
    return found

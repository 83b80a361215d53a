"""What ranks the faults: predicted shifts of the residuals, and how far fault-free means stray.

A hypothesis (fault and size) is the model with that fault. Fed with the samples of a fault-free recording, it predicts
another output than the fault-free model; under the fault the residual shifts by that difference. No fault recording is
needed.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from analysis.graph.bank import Bank
from analysis.graph.independence import independent
from analysis.tuning.thresholds import OWN, Seen
from service.core.manifest import MODES, Detector, Evidence, Hypothesis
from service.core.modes import EDGE

Array = npt.NDArray[np.float64]

BLOCK_TICKS = 25
ALLOWANCE = 0.3  # of the mode's spread: calibration error and drive-to-drive spread that a few recordings cannot show


def gather(
    bank: Bank, detectors: Sequence[Detector], recordings: Sequence[Seen], stand_ins: Sequence[int] = OWN
) -> Evidence:
    """The evidence of a bundle; mode m is described by the ticks of mode `stand_ins[m]`, as in `tune_detectors`."""
    standard = [_standard(s, detectors) for s in recordings]
    rows = independent(np.concatenate(standard))
    offset = np.array([detectors[row].offset for row in rows]).T  # (C, K)
    scale = np.array([detectors[row].scale for row in rows]).T
    noise = np.zeros((len(MODES), len(rows), len(rows)))
    stray = np.zeros_like(offset)
    for mode in set(stand_ins):
        blocks = np.concatenate([_block_means(s, mode, rows) for s in recordings]) - offset[mode]
        noise[mode] = BLOCK_TICKS * np.atleast_2d(np.cov(blocks.T)) if len(blocks) > len(rows) else 0.0
        noise[mode] += np.diag(scale[mode] ** 2)
        means = np.array([_mean(s, mode, rows, offset[mode]) for s in recordings]) - offset[mode]
        stray[mode] = np.abs(means).max(axis=0)
    return Evidence(
        generators=[detectors[row].generator for row in rows],
        offset=offset.tolist(),
        noise=noise[list(stand_ins)].tolist(),
        allowance=np.hypot(stray, ALLOWANCE * scale)[list(stand_ins)].tolist(),
        hypotheses=_hypotheses(bank.only(rows), recordings, stand_ins),
    )


def _standard(s: Seen, detectors: Sequence[Detector]) -> Array:
    """Residuals (K, T) of the steady ticks in parts of their mode's spread."""
    steady = s.usable.all(axis=1) & (s.mode != EDGE)
    offset = np.array([detector.offset for detector in detectors]).T  # (modes, T)
    scale = np.array([detector.scale for detector in detectors]).T
    mode = s.mode[steady]
    standard: Array = (s.r[steady] - offset[mode]) / scale[mode]
    return standard


def _block_means(s: Seen, mode: int, rows: list[int]) -> Array:
    """Means over runs of 25 ticks in one mode, (blocks, rows)."""
    inside = s.usable.all(axis=1) & (s.mode == mode)
    starts = range(0, len(inside) - BLOCK_TICKS + 1, BLOCK_TICKS)
    means = [s.r[k : k + BLOCK_TICKS][:, rows].mean(axis=0) for k in starts if inside[k : k + BLOCK_TICKS].all()]
    return np.array(means).reshape(len(means), len(rows))


def _mean(s: Seen, mode: int, rows: list[int], otherwise: Array) -> Array:
    inside = s.usable.all(axis=1) & (s.mode == mode)
    return s.r[inside][:, rows].mean(axis=0) if inside.any() else otherwise


def _hypotheses(bank: Bank, recordings: Sequence[Seen], stand_ins: Sequence[int]) -> list[Hypothesis]:
    named = [(fault, size) for fault in bank.model.faults.values() for size in fault.sizes]
    trials = [{}, *({fault.name: fault.absolute(size, bank.model)} for fault, size in named)]
    total = np.zeros((len(MODES), len(named), len(bank.tests)))
    count = np.zeros(len(MODES))
    for s in recordings:
        r = bank.simulate(trials, s.z, bank.start(s.z[0]))  # (K, 1 + H, rows)
        shift = r[:, :1] - r[:, 1:]  # y_hat with the fault - y_hat without: what r = y - y_hat moves by
        usable = s.usable.all(axis=1)
        for mode in set(stand_ins):
            inside = usable & (s.mode == mode)
            total[mode] += shift[inside].sum(axis=0)
            count[mode] += inside.sum()
    mean = total[list(stand_ins)] / count[list(stand_ins), None, None]
    return [Hypothesis(fault=f.name, size=size, shift=mean[:, k].tolist()) for k, (f, size) in enumerate(named)]

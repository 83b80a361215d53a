"""What confirms and ranks faults: the hypotheses, and how far fault-free means stray.

A hypothesis (fault and size) is the model with that fault. Fed with the samples of the moment, it predicts another
output than the fault-free model; under the fault the residual shifts by that difference. No fault recording is needed.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from analysis.graph.bank import FAULTS, Bank, Trial
from analysis.graph.independence import independent
from analysis.model import Model
from analysis.tuning.thresholds import OWN, Seen
from service.core.hypotheses import MINIMUM_TICKS
from service.core.manifest import MODES, Detector, Evidence, Hypothesis
from service.core.modes import EDGE

Array = npt.NDArray[np.float64]

BLOCK_TICKS = 25
ALLOWANCE = 0.3  # of the mode's spread: what a few recordings cannot show
ENOUGH = 8
"""Recordings from which the way in which all means stray together from drive to drive is seen, and not assumed."""
SEEN_PART = 0.9  # of that straying, in spreads: by a few directions, the rest is each mean's own
PER_DIRECTION = 3  # recordings, at least


def gather(
    bank: Bank,
    detectors: Sequence[Detector],
    recordings: Sequence[Seen],
    stand_ins: Sequence[int] = OWN,
    apart: Sequence[Seen] | None = None,
) -> Evidence:
    """The evidence of a bundle; mode m is described by the ticks of mode `stand_ins[m]`, as in `tune_detectors`.

    `apart` are the same recordings, each centred by the others of its vehicle: how far a drive strays is seen in them,
    as a drive that has been centred by itself too strays less.
    """
    standard = [_standard(s, detectors) for s in recordings]
    rows = independent(np.concatenate(standard))
    offset = np.array([detectors[row].offset for row in rows]).T  # (C, K)
    scale = np.array([detectors[row].scale for row in rows]).T
    noise = np.zeros((len(MODES), len(rows), len(rows)))
    visit = np.zeros_like(noise)
    for mode in set(stand_ins):
        noise[mode] = _within(recordings, mode, rows) + np.diag(scale[mode] ** 2)
        visit[mode] = _between(recordings, mode, rows, offset[mode], noise[mode])
    stray = np.abs(_strays(recordings, rows, offset)).max(axis=0)
    drifts = _drifts(bank.only(rows), recordings, stand_ins)
    if len(recordings) >= ENOUGH:
        stray, seen = _directions(_strays(apart or recordings, rows, offset)[:, list(stand_ins)], scale)
        drifts += seen
    return Evidence(
        generators=[detectors[row].generator for row in rows],
        offset=offset.tolist(),
        noise=noise[list(stand_ins)].tolist(),
        visit=visit[list(stand_ins)].tolist(),
        allowance=np.hypot(stray, ALLOWANCE * scale)[list(stand_ins)].tolist(),
        drifts=[drift.tolist() for drift in drifts],
        graph=FAULTS if (hypotheses := _hypotheses(bank.model)) else None,
        hypotheses=hypotheses,
    )


def _standard(s: Seen, detectors: Sequence[Detector]) -> Array:
    """Residuals (K, T) of the steady ticks in parts of their mode's spread."""
    steady = s.usable.all(axis=1) & (s.mode != EDGE)
    offset = np.array([detector.offset for detector in detectors]).T  # (modes, T)
    scale = np.array([detector.scale for detector in detectors]).T
    mode = s.mode[steady]
    standard: Array = (s.r[steady] - offset[mode]) / scale[mode]
    return standard


def _visits(recordings: Sequence[Seen], mode: int, rows: list[int]) -> Iterator[Array]:
    """The residuals (n, rows) of every stay in a mode."""
    for s in recordings:
        inside = s.usable.all(axis=1) & (s.mode == mode)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            yield s.r[begin:end][:, rows]


def _within(recordings: Sequence[Seen], mode: int, rows: list[int]) -> Array:
    """The long-run covariance per tick (rows, rows) around each visit's mean, from means over 25 ticks."""
    total, freedom = np.zeros((len(rows), len(rows))), 0
    for r in _visits(recordings, mode, rows):
        blocks = len(r) // BLOCK_TICKS
        if blocks > 1:
            means = r[: blocks * BLOCK_TICKS].reshape(blocks, BLOCK_TICKS, -1).mean(axis=1)
            away = means - means.mean(axis=0)
            total += away.T @ away
            freedom += blocks - 1
    return BLOCK_TICKS * total / max(freedom, 1)


def _between(recordings: Sequence[Seen], mode: int, rows: list[int], offset: Array, noise: Array) -> Array:
    """How far the mean of a visit to the mode strays (rows, rows), besides what its ticks' noise makes."""
    total, count = np.zeros_like(noise), 0
    for r in _visits(recordings, mode, rows):
        if len(r) >= MINIMUM_TICKS:
            away = r.mean(axis=0) - offset
            total += np.outer(away, away) - noise / len(r)
            count += 1
    size, direction = np.linalg.eigh(total / max(count, 1))
    return np.asarray((direction * np.maximum(size, 0.0)) @ direction.T)


def _strays(recordings: Sequence[Seen], rows: list[int], offset: Array) -> Array:
    """How far the mean of every recording lies from the offset (R, modes, rows).

    One that hardly shows a mode says nothing of it: the others' deviations are that much larger, so that the mean
    square over all R is the one over those that do.
    """
    modes = range(len(MODES))
    means = np.array([[_mean(s, mode, rows) for mode in modes] for s in recordings]) - offset
    shown = np.isfinite(means)
    return np.asarray(np.where(shown, means, 0.0) * np.sqrt(len(means) / np.maximum(shown.sum(axis=0), 1)))


def _mean(s: Seen, mode: int, rows: list[int]) -> Array:
    inside = s.usable.all(axis=1) & (s.mode == mode)
    return s.r[inside][:, rows].mean(axis=0) if inside.sum() >= MINIMUM_TICKS else np.full(len(rows), np.nan)


def _directions(means: Array, scale: Array) -> tuple[Array, list[Array]]:
    """How drives stray: each mean by itself (modes, rows), and the directions (modes, rows) in which all do together.

    `means` (R, modes, rows) are deviations of R drives; the edge, which is no evidence, is left as it is.
    """
    R, shape = len(means), means.shape[1:]
    standard = (means / scale)[:, :EDGE].reshape(R, -1)
    u, size, direction = np.linalg.svd(standard, full_matrices=False)
    told = np.cumsum(size**2) / max(float((size**2).sum()), 1e-300)
    kept = min(int(np.searchsorted(told, SEEN_PART)) + 1, R // PER_DIRECTION)
    left = standard - (u[:, :kept] * size[:kept]) @ direction[:kept]
    own, drifts = np.zeros(shape), np.zeros((kept, *shape))
    own[:EDGE] = np.sqrt((left**2).mean(axis=0)).reshape(EDGE, -1)
    drifts[:, :EDGE] = (size[:kept, None] * direction[:kept] / np.sqrt(R)).reshape(kept, EDGE, -1)
    own[EDGE] = np.abs(means[:, EDGE]).max(axis=0) / scale[EDGE]
    return own * scale, list(drifts * scale)


def _hypotheses(model: Model) -> list[Hypothesis]:
    return [Hypothesis(fault=fault.name, size=size) for fault in model.faults.values() for size in fault.sizes]


def _drifts(bank: Bank, recordings: Sequence[Seen], stand_ins: Sequence[int]) -> list[Array]:
    """The shift (modes, rows) that a standard deviation of every drift of the model makes."""
    model = bank.model
    changed = [{name: p.value * (1.0 + p.drift)} for name, p in model.parameters.items() if p.drift]
    found = [*_shifts(bank, recordings, changed, stand_ins)] if changed else []
    for column, known in enumerate(model.known.values()):
        if known.drift:
            found += _shifts(bank, recordings, [{}], stand_ins, known.drift * np.eye(len(model.known))[column])
    return found


def _shifts(
    bank: Bank, recordings: Sequence[Seen], trials: Sequence[Trial], stand_ins: Sequence[int], step: Array | None = None
) -> list[Array]:
    """How far the mean residuals (modes, rows) move with each trial, over samples that are a `step` (nz,) further."""
    total = np.zeros((len(MODES), len(trials), len(bank.tests)))
    count = np.zeros(len(MODES))
    for s in recordings:
        usual = bank.simulate([{}], s.z, bank.start(s.z[0]))
        z = s.z if step is None else s.z + step
        moved = bank.simulate(trials, z, bank.start(z[0])) - usual  # (K, trials, rows)
        usable = s.usable.all(axis=1)
        for mode in set(stand_ins):
            inside = usable & (s.mode == mode)
            total[mode] += moved[inside].sum(axis=0)
            count[mode] += inside.sum()
    mean = total[list(stand_ins)] / count[list(stand_ins), None, None]
    return [mean[:, k] for k in range(len(trials))]

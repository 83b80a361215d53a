"""The limits of a bundle on drives: delay, smallest size and separation of every assumed fault."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np

from faultline.analysis.limit.information import against, delays, information, rates, signatures, smallest
from faultline.service.core.decision.baseline import BaselineModel
from faultline.service.core.decision.blocks import BLOCK, Block
from faultline.service.core.decision.hypotheses import Hypotheses
from faultline.service.core.decision.look import Segments
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Hypothesis, Manifest
from faultline.service.core.signals.values import FloatArray

ONSETS, FIRST, LAST = 12, 0.15, 0.6
"""Onsets in each drive, evenly over this part of it: what is there before one tells the drive's baseline."""
APART = 4.5
"""Information [nats] from which one explanation is ranked behind the other (half of the decision's `TIE`)."""
TIMES_S = (10.0, 20.0, 30.0, 60.0, 120.0, 300.0)
"""Times after the onset at which it is asked which faults can be told apart."""


class Limit(msgspec.Struct, frozen=True):
    """Limits of one fault, form and size. `delay_s` has the quantiles 0.1, 0.5 and 0.9 over onsets, null for never.

    `rate` is the information a second by mode [nats/s], null where a mode was not seen. `apart_s` is the first of
    `TIMES_S` from which the fault can be told from each other one in the median, null where it cannot.
    """

    fault: str
    size: float
    share_of: str | None
    delay_s: list[float | None]
    rate: dict[str, float | None]
    apart_s: dict[str, float | None]


class Smallest(msgspec.Struct, frozen=True):
    """The smallest size of one fault, form and sign that is found within each of the times, by the same quantiles."""

    fault: str
    share_of: str | None
    size: list[list[float | None]]


class Limits(msgspec.Struct, frozen=True):
    """All of them, with what they rest on: `nats` for an alarm, of one in `every_h` [h] without a fault.

    `times_s` are those of the smallest sizes; the last is the one asked for. Each counts the `onsets` with as much
    drive behind them, separation those of the last.
    """

    bundle: str
    drives: list[str]
    every_h: float
    times_s: list[float]
    block_s: float
    nats: float
    onsets: list[int]
    limits: list[Limit]
    smallest: list[Smallest]


class DriveLimits(NamedTuple):
    """Limits at the onsets of a drive: `delay` (O, H) [s], `rate` (modes, H) [nats/s], `reached` (O, times, H) [nats].

    `apart` (A, H, faults) [s] is of those A onsets that have the longest of the times behind them.
    """

    delay: FloatArray
    rate: FloatArray
    reached: FloatArray
    apart: FloatArray


def of_drive(manifest: Manifest, blocks: Sequence[Block], every_h: float, within_s: float) -> DriveLimits:
    """Return what a fault-free drive's onsets show of all hypotheses."""
    model, segments = BaselineModel(manifest.evidence, manifest.time), Hypotheses(manifest.evidence).segments
    times_s = _times(within_s)
    onsets = np.unique(np.linspace(FIRST * len(blocks), LAST * len(blocks), ONSETS).astype(np.intp))
    g = signatures(blocks, model, onsets)
    J, end_s = information(g), np.array([float(block.end_s[0]) for block in blocks])
    since_s = end_s - np.concatenate([[0.0], end_s])[onsets][:, None]
    reached, apart = [], []
    for k, onset in enumerate(onsets.tolist()):
        if since_s[k, -1] >= within_s:
            apart.append(_apart(g[k, onset:], since_s[k, onset:], segments, times_s))
        ends = [int(np.flatnonzero(since_s[k] <= time_s)[-1]) for time_s in times_s]
        seen = since_s[k, -1] >= np.array(times_s)  # J is not known beyond the drive's end
        reached.append(np.where(seen[:, None], J[k, ends], np.nan))
    return DriveLimits(
        delays(J, since_s, _nats(manifest, every_h)),
        rates(J, blocks, since_s, within_s, len(manifest.modes.names)),
        np.array(reached),
        np.array(apart).reshape(len(apart), J.shape[2], len(dict.fromkeys(segments.faults))),
    )


def limits_of(
    manifest: Manifest, bundle_id: str, drives: Mapping[str, DriveLimits], every_h: float, within_s: float
) -> Limits:
    """Return the limits over all onsets of all drives.

    Raises:
        InputError: no onset has `within_s` of drive behind it.
    """
    evidence, segments = manifest.evidence, Hypotheses(manifest.evidence).segments
    apart = np.concatenate([drive.apart for drive in drives.values()])
    if not len(apart):
        raise InputError(
            f"{', '.join(drives)}: no onset has {within_s:g} s of drive behind it; give a longer drive or --within"
        )
    delay = np.concatenate([drive.delay for drive in drives.values()])
    reached = np.concatenate([drive.reached for drive in drives.values()])
    rate = _mean(np.array([drive.rate for drive in drives.values()]))
    separate = np.median(apart, axis=0)  # (H, faults)
    nats, faults = _nats(manifest, every_h), list(dict.fromkeys(segments.faults))
    simple = evidence.hypotheses[: evidence.simple]
    return Limits(
        bundle=bundle_id,
        drives=[*drives],
        every_h=every_h,
        times_s=_times(within_s),
        block_s=_block_s(manifest),
        nats=nats,
        onsets=np.isfinite(reached[..., 0]).sum(axis=0).tolist(),
        limits=[
            Limit(
                fault=each.fault,
                size=each.size,
                share_of=each.share_of,
                delay_s=_quantiles(delay[:, row]),
                rate={name: _known(rate[mode, row]) for mode, name in enumerate(manifest.modes.names) if mode > 0},
                apart_s={
                    fault: _known(separate[row, column]) for column, fault in enumerate(faults) if fault != each.fault
                },
            )
            for row, each in enumerate(simple)
        ],
        smallest=_smallest(simple, segments, reached, nats),
    )


def _times(within_s: float) -> list[float]:
    return [*(time_s for time_s in TIMES_S if time_s < within_s), within_s]


def _block_s(manifest: Manifest) -> float:
    return manifest.time.ticks(BLOCK) * manifest.time.period_s


def _nats(manifest: Manifest, every_h: float) -> float:
    return float(np.log(3600.0 * every_h / _block_s(manifest)))


def _apart(g: FloatArray, since_s: FloatArray, segments: Segments, times_s: Sequence[float]) -> FloatArray:
    """Return when each hypothesis can be told from each fault (H, faults) [s], of one onset; inf where it cannot."""
    faults = list(dict.fromkeys(segments.faults))
    own = [np.flatnonzero([name == fault for name in segments.faults]) for fault in faults]
    found = np.full((g.shape[1], len(faults)), np.inf)
    for time_s in reversed(times_s):
        table = against(g[since_s <= time_s], segments)
        told = np.stack([table[:, columns].min(axis=1) for columns in own], axis=1) >= APART
        found[told] = time_s
    return found


def _smallest(simple: Sequence[Hypothesis], segments: Segments, J: FloatArray, nats: float) -> list[Smallest]:
    """Return the smallest sizes of all chains, by the information J (O, times, H); NaN where a drive had ended."""
    found = []
    for number in range(int(segments.chain.max()) + 1):
        chain = np.flatnonzero(segments.chain == number)
        rows = segments.end[chain] - 1
        sizes = np.array([simple[row].size for row in rows.tolist()])
        sign = float(np.sign(sizes[0]))
        by_time = [
            [None if each is None else sign * each for each in _quantiles(smallest(of, np.abs(sizes), nats))]
            for k in range(J.shape[1])
            if len(of := J[np.isfinite(J[:, k, 0]), k][:, rows])
        ]
        found.append(Smallest(segments.faults[chain[0]], segments.shares[chain[0]], by_time))
    return found


def _quantiles(of: FloatArray) -> list[float | None]:
    """Quantiles 0.1, 0.5 and 0.9, of values as they are; inf counts as large."""
    ordered = np.sort(of)
    return [_known(ordered[round(part * (len(ordered) - 1))]) for part in (0.1, 0.5, 0.9)]


def _known(value: float) -> float | None:
    return float(f"{value:.4g}") if np.isfinite(value) else None


def _mean(rate: FloatArray) -> FloatArray:
    """The mean over drives (D, modes, H) of those that show a mode; NaN where none does."""
    seen = np.isfinite(rate)
    return np.where(seen.any(axis=0), np.where(seen, rate, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1), np.nan)

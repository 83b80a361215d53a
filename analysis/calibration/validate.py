"""A calibrated model's free run beside measurements: how far apart, in each operating mode, and how far noise alone is.

The *noise floor* of a channel is how it flickers by itself, sensor and valve's ripple together, whatever the model: the
standard deviation around straight lines of `BLOCK`, by the median of them, as some bend. The *expected* error adds
what the inputs' own errors make of a free run, even of a right model's (see `noise`): the speed's noise, which the run
integrates, a command's imprecision, and what is left of steps whose time is not known better than a sample. It differs
from sample to sample: after a jump of the speed it is ten times that of a quiet minute. So each error is also taken in
parts of its own expected one (`normalised`), and a few jumps excuse nothing that is wrong between them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.noise import commands_of, disturbances, stacked
from faultline.analysis.calibration.problem import Nuisance, runs
from faultline.analysis.calibration.sections import Section
from faultline.analysis.simulation import System, Trajectory
from faultline.service.core.signals.modes import EDGE

Array = npt.NDArray[np.float64]

BLOCK = 0.25
"""Settling times."""

LEAST = 5
"""Samples in a block."""

STEADY = "steady"
"""All modes but edges."""


@dataclass(frozen=True)
class Agreement:
    """In one mode of one output, all in the output's unit: RMS and mean of the error, noise floor, expected error.

    `normalised` is the RMS of the errors, each over its sample's own expected one: 1 for a right model. Where no block
    is long enough for a floor, it, what is expected and `normalised` are NaN. `worst_s` is where in the log [s] the
    settling time begins in which that is largest.
    """

    samples: int
    rms: float
    bias: float
    floor: float
    expected: float
    normalised: float
    worst_s: float = np.nan


@dataclass(frozen=True)
class Validation:
    """The runs over the sections, and `agreement` by output and mode; modes without samples are left out."""

    sections: tuple[Section, ...]
    trajectories: tuple[Trajectory, ...]
    agreement: dict[str, dict[str, Agreement]]


def validate(
    system: System,
    sections: Sequence[Section],
    values: Mapping[str, float],
    nuisances: Sequence[Nuisance],
) -> Validation:
    """Runs the model with calibrated `values` over the sections, with what else was found of each of their logs.

    Raises:
        InputError: the model cannot be run with them.
    """
    log = np.cumsum([section.number == 0 for section in sections]) - 1
    drifted = [{**values, **nuisances[k].drifted} for k in log]
    trajectories = runs(system, sections, drifted, nuisances[0].delay)
    commands = commands_of(system, sections)
    gathered: dict[str, list[tuple[npt.NDArray[np.int64], *tuple[Array, ...]]]] = {name: [] for name in system.outputs}
    for section, trajectory, k in zip(sections, trajectories, log, strict=True):
        nuisance = nuisances[k]
        B = disturbances(section, trajectory, commands)
        predicted = stacked(section, trajectory.outputs(), nuisance.lag)
        ends = np.cumsum([len(s.t) for s in section.samples.values()])[:-1]
        block_s = BLOCK * section.time.settling_s
        parts = zip(np.split(predicted, ends), np.split((B**2).sum(axis=1), ends), strict=True)
        for (name, s), (y, disturbed) in zip(section.samples.items(), parts, strict=True):
            error = s.value - nuisance.zero.get(name, 0.0) - y
            blocks = _blocks(s.t / block_s, s.value, s.mode)
            gathered[name].append((s.mode, error, blocks, disturbed, section.start_s + s.t))
    agreement = {}
    for name, found in gathered.items():
        mode, error, blocks, disturbed, t = (np.concatenate(column) for column in zip(*found, strict=True))
        flicker = _typical(blocks, mode)
        by_mode = {name: mode == k for k, name in system.model.modes.listed} | {STEADY: mode != EDGE}
        agreement[name] = {
            title: _agreement(error[there], flicker[there], disturbed[there], t[there], sections[0].time.settling_s)
            for title, there in by_mode.items()
            if there.any()
        }
    return Validation(tuple(sections), tuple(trajectories), agreement)


def _agreement(error: Array, flicker: Array, disturbed: Array, t: Array, part_s: float) -> Agreement:
    told = flicker[np.isfinite(flicker)]
    floor = float(np.sqrt(np.mean(told))) if len(told) else np.nan
    square = error**2 / (floor**2 + disturbed)
    part, number = np.unique(np.floor(t / part_s), return_inverse=True)
    worst_s = part_s * float(part[np.argmax(np.bincount(number, square) / np.bincount(number))])
    return Agreement(
        samples=len(error),
        rms=float(np.sqrt(np.mean(error**2))),
        bias=float(np.mean(error)),
        floor=floor,
        expected=float(np.sqrt(floor**2 + np.mean(disturbed))),
        normalised=float(np.sqrt(np.mean(square))),
        worst_s=worst_s,
    )


def _blocks(t: Array, value: Array, mode: npt.NDArray[np.int64]) -> Array:
    """For every sample at times in blocks the variance around its block's line; NaN in blocks too short for one."""
    found = np.full(len(t), np.nan)
    block = np.cumsum((np.diff(mode, prepend=mode[:1]) != 0) | (np.diff(t // 1.0, prepend=-1.0) != 0))
    for k in np.unique(block):
        there = np.flatnonzero(block == k)
        if len(there) > LEAST:
            A = np.column_stack([np.ones(len(there)), t[there] - t[there[0]]])
            rest = value[there] - A @ np.linalg.lstsq(A, value[there], rcond=None)[0]
            found[there] = np.sum(rest**2) / (len(there) - 2)
    return found


def _typical(variance: Array, mode: npt.NDArray[np.int64]) -> Array:
    """For every sample the median variance of its mode."""
    found = np.full(len(variance), np.nan)
    for k in np.unique(mode):
        told = variance[(mode == k) & np.isfinite(variance)]
        found[mode == k] = np.median(told) if len(told) else np.nan
    return found

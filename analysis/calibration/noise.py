"""What makes a right model differ from a measurement, and the weights that follow from it.

    e = v + B w,    v ~ N(0, R) independent,    w ~ N(0, 1)

v is the sensors' own noise and, by operating mode, what else changes from sample to sample (the valve's ripple). w are
errors of the *inputs*, which the free run integrates: the speed's noise, as a mean over every `CELL`; its mean over
every interval between samples in which it jumps; what a pulsed valve makes of a commanded level, which stays with the
level; and the time of each step, which is known to no better than a sample and a period of the valve. B is the run's
exact derivative. Without w, minutes of one and the same wandering would count as thousands of independent
samples, and an uncertain dose step as evidence for a softer hose.

The weights are Sigma^(-1/2) for Sigma = R + B B', by way of the eigenvectors of B'R^(-1)B.
"""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.sections import Section, is_command
from faultline.analysis.model import Model
from faultline.analysis.simulation import System, Trajectory
from faultline.service.core.time_scale import TimeScale

Array = npt.NDArray[np.float64]
Spread = Callable[[Array], float]
Weigh = Callable[[Array], Array]
"""From a section's differences (N, ...) to unit independent noise (M, ...)."""

Levels = Mapping[str, Array]
"""Standard deviation of v by output and mode (modes,), in the output's unit."""

CELL = 0.1
"""Settling times. Shorter than any time constant that integrates."""

STEP_TIME = 0.6
"""Periods. Standard deviation of the time of an input's step: half a sample either way, and an actuator's period."""

FAINT = 0.05
"""A direction whose disturbance is this part of the samples' noise has no weight to lose."""

SLOW = 0.15
"""Settling times. What changes more slowly than this is no sample's noise."""

LEAST_RUN = 5
"""Samples in one mode on end, from which a level can be had."""


class Whitening:
    """Turns differences (N,) whose v has standard deviations `level` (N,) into unit independent noise; B is (N, D)."""

    def __init__(self, level: Array, disturbed: Array) -> None:
        self._weight = 1.0 / level
        C = disturbed * self._weight[:, None]
        power, V = np.linalg.eigh(C.T @ C)
        seen = power > FAINT**2
        self._U = C @ (V[:, seen] / np.sqrt(power[seen]))
        self._less = 1.0 - 1.0 / np.sqrt(1.0 + power[seen])

    def __call__(self, e: Array) -> Array:
        """The differences (N, ...) whitened."""
        weighted = (e.T * self._weight).T
        lessened = self._U @ ((self._U.T @ weighted).T * self._less).T
        return np.asarray(weighted - lessened)


def level_of(section: Section, levels: Levels) -> Array:
    """The standard deviation of v of every sample of a section, all outputs one after the other (N,)."""
    return np.concatenate([levels[name][s.mode] for name, s in section.samples.items()])


def stacked(section: Section, by_output: Mapping[str, Array], lag: Mapping[str, float] = MappingProxyType({})) -> Array:
    """Values (K, ...) on the grid at the samples' times less the `lag` [s], one output after the other (N, ...)."""
    return np.concatenate(
        [_at(section, s.t - lag.get(name, 0.0), by_output[name]) for name, s in section.samples.items()]
    )


def _at(section: Section, t: Array, values: Array) -> Array:
    """Between the grid's instants on straight lines."""
    place = t / section.drive.step_s
    k = np.clip(place.astype(int), 0, len(values) - 2)
    share = (place - k).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray((1.0 - share) * values[k] + share * values[k + 1])


def commands_of(system: System, sections: Sequence[Section]) -> tuple[str, ...]:
    """The inputs that are commands."""
    inputs = np.concatenate([section.drive.inputs for section in sections])
    return tuple(name for name, value in zip(system.inputs, inputs.T, strict=True) if is_command(value))


def disturbances(section: Section, trajectory: Trajectory, commands: Sequence[str]) -> Array:
    """B (N, D) at the trajectory."""
    columns = []
    for k, name in enumerate(trajectory.system.inputs):
        u, h, noise = trajectory.drive.inputs[:, k], trajectory.drive.step_s, section.noise[:, k]
        errors = _of_command(u, h, noise, section.time) if name in commands else _of_sensor(h, noise, section.time)
        errors = np.hstack([errors, _of_jumps(section.jumps[name], section.t)]) if name in section.jumps else errors
        columns.append(stacked(section, trajectory.by_input(name, errors)))
    return np.concatenate(columns, axis=1)


def _of_sensor(step_s: float, noise: Array, time: TimeScale) -> Array:
    """The errors (K, D) of a measured input: the mean of its samples' noise over every `CELL`."""
    cell_s = CELL * time.settling_s
    cell = (np.arange(len(noise)) * step_s / cell_s).astype(int)
    return np.asarray(np.sqrt(time.period_s / cell_s) * noise[:, None] * _marks(cell, cell[-1] + 1))


def _of_jumps(jumps: Array, t: Array) -> Array:
    """The errors (K, J) of an input's mean over intervals in which it jumps, on the part of a step that is theirs."""
    begin, end, deviation = jumps.T
    half = (t[1] - t[0]) / 2.0
    inside = np.minimum(t[:, None] + half, end) - np.maximum(t[:, None] - half, begin)
    return np.asarray(deviation * np.maximum(inside, 0.0) / (2.0 * half))


def _of_command(u: Array, step_s: float, noise: Array, time: TimeScale) -> Array:
    """The errors (K, D) of a command: one of each level, and for each step what so much delay takes away."""
    slope = np.gradient(u, step_s)
    moves = slope != 0.0
    begins = np.diff(moves, prepend=False) & moves
    step = np.cumsum(begins)
    levels = noise[:, None] * _marks(step, step[-1] + 1)
    steps = STEP_TIME * time.period_s * _marks(step * moves, step[-1] + 1)[:, 1:] * slope[:, None]
    return np.concatenate([levels, steps], axis=1)


def _marks(number: npt.NDArray[np.int64], count: int) -> Array:
    """A column of ones and zeros for every number from 0 on, (K, count)."""
    return np.asarray(number[:, None] == np.arange(count), dtype=np.float64)


def levels_of(model: Model, sections: Sequence[Section], left: Sequence[Array], spread: Spread) -> Levels:
    """The levels that the differences `left` (N,) of each section show, at least the sensors' noise."""
    fast: dict[str, list[list[Array]]] = {name: [[] for _ in model.modes.names] for name in sections[0].samples}
    for section, e in zip(sections, left, strict=True):
        ends = np.cumsum([len(s.t) for s in section.samples.values()])
        for (name, s), part in zip(section.samples.items(), np.split(e, ends[:-1]), strict=True):
            for run in np.split(np.arange(len(part)), np.flatnonzero(np.diff(s.mode)) + 1):
                if len(run) >= LEAST_RUN:
                    fast[name][s.mode[run[0]]].append(
                        _fast(part[run], SLOW * model.settling_s / float(np.median(np.diff(s.t[run]))))
                    )
    return {
        name: np.array([max(model.known[name].noise, spread(np.concatenate([*parts, [0.0]]))) for parts in by_mode])
        for name, by_mode in fast.items()
    }


def _fast(e: Array, slow: float) -> Array:
    """What changes faster than so many samples, made as large as it is in white noise."""
    width = min(max(3, round(slow)), len(e))
    kernel = np.ones(width)
    smooth = np.convolve(e, kernel, "same") / np.convolve(np.ones_like(e), kernel, "same")
    return np.asarray((e - smooth) / np.sqrt(1.0 - 1.0 / width))


def by_square(e: Array) -> float:
    """The standard deviation of (N,) zero-mean noise."""
    return float(np.sqrt(np.mean(e**2)))

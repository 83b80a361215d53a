"""What makes a right model differ from a measurement, and the weights that follow from it.

    e = v + B w,    v ~ N(0, R) independent,    w ~ N(0, 1)

v is the sensors' own noise and, by operating mode, what else changes quickly (`likelihood` finds its level). w are
errors of the *inputs*, which the free run integrates: the speed's noise, as a mean over every `CELL`; its mean over
every interval that its samples leave uncertain (`inputs`); what a pulsed valve makes of a commanded level, which stays
with the level; and the time of each step, which is known to no better than a sample and a period of the valve. B is the
run's exact derivative. Without w, minutes of one and the same wandering would count as thousands of independent
samples, and an uncertain dose step as evidence for a softer hose.

The weights are Sigma^(-1/2) for Sigma = R + B B', by way of the eigenvectors of B'R^(-1)B.
"""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.sections import Section
from faultline.analysis.simulation import System, Trajectory
from faultline.service.core.time_scale import TimeScale

Array = npt.NDArray[np.float64]
Weigh = Callable[[Array], Array]
"""From a section's differences (N, ...) to unit independent noise (M, ...)."""

CELL = 0.05
"""Settling times. Shorter than any time constant that integrates."""

STEP_TIME = 0.6
"""Periods. Standard deviation of the time of an input's step: half a sample either way, and an actuator's period."""

FAINT = 0.05
"""A direction whose disturbance is this part of the samples' noise has no weight to lose."""


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
    """The inputs that are commands in all sections."""
    return tuple(name for name in system.inputs if all(name in section.commands for section in sections))


def errors_of(section: Section, trajectory: Trajectory, commands: Sequence[str]) -> dict[str, Array]:
    """What the errors of each input may do to it at the run's instants: (K, D) for as many unit normal w."""
    found = {}
    for k, name in enumerate(trajectory.system.inputs):
        u, h, noise = trajectory.drive.inputs[:, k], trajectory.drive.step_s, section.noise[:, k]
        errors = _of_command(u, h, noise, section.time) if name in commands else _of_sensor(h, noise, section.time)
        if name in section.uncertain:
            errors = np.hstack([errors, _of_intervals(section.uncertain[name], section.t)])
        found[name] = errors
    return found


def disturbances(section: Section, trajectory: Trajectory, commands: Sequence[str]) -> Array:
    """B (N, D) at the trajectory."""
    errors = errors_of(section, trajectory, commands)
    columns = [stacked(section, trajectory.by_input(name, error)) for name, error in errors.items()]
    return np.hstack([*columns, *(_of_output(section, name) for name in section.samples if name in section.uncertain)])


def _of_output(section: Section, name: str) -> Array:
    """The errors (N, D) of an output's own readings over its intervals."""
    begin, end, deviation, group = section.uncertain[name].T
    parts = []
    for other, s in section.samples.items():
        inside = (s.t[:, None] >= begin) & (s.t[:, None] < end) & (other == name)
        parts.append((inside * deviation) @ (group[:, None] == np.arange(int(group.max(initial=-1.0)) + 1)))
    return np.concatenate(parts)


def _of_sensor(step_s: float, noise: Array, time: TimeScale) -> Array:
    """The errors (K, D) of a measured input: the mean of its samples' noise over every `CELL`."""
    cell_s = CELL * time.settling_s
    cell = (np.arange(len(noise)) * step_s / cell_s).astype(int)
    return np.asarray(np.sqrt(time.period_s / cell_s) * noise[:, None] * _marks(cell, cell[-1] + 1))


def _of_intervals(intervals: Array, t: Array) -> Array:
    """The errors (K, D) of an input's mean over intervals (J, 4), on the part of a step that is theirs."""
    begin, end, deviation, group = intervals.T
    half = (t[1] - t[0]) / 2.0
    found = np.zeros((len(t), int(group.max(initial=-1.0)) + 1))
    for number, column in enumerate(found.T):
        own = group == number
        inside = np.minimum(t[:, None] + half, end[own]) - np.maximum(t[:, None] - half, begin[own])
        column += np.maximum(inside, 0.0) @ deviation[own] / (2.0 * half)
    return found


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

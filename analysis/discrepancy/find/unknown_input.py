"""An unknown input of an equation: its cells, and what is expected of it beforehand.

It is constant in cells of some seconds, which also end where a command steps: many effects switch with a command. Three
priors cover what missing effects do: one that drifts, one with a level of its own in each operating mode, and one that
forgets within seconds (what follows pressure's own changes).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from faultline.analysis.calibration.sections import Section
from faultline.analysis.discrepancy.find.disturbed import DisturbedRuns
from faultline.analysis.discrepancy.find.quantities import mode_of

Array = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

CELL = 0.2
"""Settling times. As long as the slowest time constant: what is faster shows as its mean."""

MOST_CELLS = 400
"""More, and the cells become longer instead: time grows with their square."""

DRIFT, QUICK = 2.0, 0.4
"""Settling times. How long the slow prior and the quick one remember (Matern 3/2)."""

PRIORS = ("drifting", "switching", "quick")
SWITCHING = {"level": 0.1, "mode": 1.0, "stretch": 0.1, "drift": 0.1}
"""Variances of the switching prior: mostly a level by mode, somewhat another each time, somewhat a drift."""


@dataclass(frozen=True)
class Cells:
    """`number` (K,) is each instant's cell by section, `settling_s` the model's settling time [s].

    Of each cell: `t` [s] its middle, the number of its recording or `log`, its section, stretch and mode.
    """

    settling_s: float
    number: tuple[Ints, ...]
    t: Array
    log: Ints
    section: Ints
    stretch: Ints
    mode: Ints

    @property
    def marks(self) -> list[Array]:
        """A column of ones and zeros for every cell, (K, cells) by section."""
        return [np.asarray(number[:, None] == np.arange(number[-1] + 1), dtype=np.float64) for number in self.number]

    def means(self, value: Array) -> Array:
        """The means (cells, ...) of a course (K, ...), all sections one after the other."""
        by_section = np.split(value, np.cumsum([len(number) for number in self.number])[:-1])
        sums = [mark.T @ part for mark, part in zip(self.marks, by_section, strict=True)]
        counts = np.concatenate([np.bincount(number) for number in self.number])
        return np.asarray((np.concatenate(sums).T / counts).T)

    @property
    def roots(self) -> dict[str, Array]:
        """A root of each prior's covariance, by its name in `PRIORS`; its variance is one to two."""
        same = self.section[:, None] == self.section
        drift = same * _matern(self.t, DRIFT * self.settling_s)
        parts = {
            "level": np.ones_like(drift),
            "mode": self.mode[:, None] == self.mode,
            "stretch": same & (self.stretch[:, None] == self.stretch),
            "drift": drift,
        }
        switching = sum(variance * parts[name] for name, variance in SWITCHING.items())
        covariances = (1.0 + drift, switching, same * _matern(self.t, QUICK * self.settling_s))
        return {name: _root(np.asarray(K)) for name, K in zip(PRIORS, covariances, strict=True)}


def cells_of(runs: DisturbedRuns) -> Cells:
    """The cells of all sections."""
    span = sum(float(section.t[-1]) for section in runs.sections)
    length = max(CELL * runs.system.model.settling_s, span / MOST_CELLS)
    number, t, mode, place, stretches, log = [], [], [], [], [], []
    beginnings = np.cumsum([section.number == 0 for section in runs.sections]) - 1
    for k, section in enumerate(runs.sections):
        stretch = _stretches(section, [runs.system.inputs.index(name) for name in runs.commands])
        cell = _cut(stretch, round(length / section.drive.step_s))
        first = np.flatnonzero(np.diff(cell, prepend=-1))
        middle = (first + np.append(first[1:], len(cell))) // 2
        number.append(cell)
        t.append(section.start_s + section.t[middle])
        mode.append(mode_of(runs.system.model, runs.system, section)[middle])
        stretches.append(stretch[middle])
        place.append(np.full(len(middle), k))
        log.append(np.full(len(middle), beginnings[k]))
    whole = [np.concatenate(part) for part in (t, log, place, stretches, mode)]
    return Cells(runs.system.model.settling_s, tuple(number), *whole)


def _stretches(section: Section, columns: Sequence[int]) -> Ints:
    """The number of each instant's stretch between steps of the inputs in these columns."""
    moves = np.diff(section.drive.inputs[:, columns], axis=0, prepend=section.drive.inputs[:1, columns]).any(axis=1)
    return np.asarray(np.cumsum(moves & ~np.roll(moves, 1)), dtype=np.int64)


def _cut(stretch: Ints, length: int) -> Ints:
    """Numbers cells of at most so many instants that lie within a stretch."""
    first = np.flatnonzero(np.diff(stretch, prepend=-1))
    size = np.diff(np.append(first, len(stretch)))
    count = -(-size // length)
    inside = np.arange(len(stretch)) - np.repeat(first, size)
    before = np.repeat(np.cumsum(count) - count, size)
    return np.asarray(before + inside * np.repeat(count, size) // np.repeat(size, size), dtype=np.int64)


def _matern(t: Array, length_s: float) -> Array:
    r = np.sqrt(3.0) * np.abs(t[:, None] - t) / length_s
    return np.asarray((1.0 + r) * np.exp(-r))


def _root(covariance: Array) -> Array:
    power, V = np.linalg.eigh(covariance)
    return np.asarray(V * np.sqrt(np.maximum(power, 0.0)))

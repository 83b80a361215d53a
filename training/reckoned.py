"""The states over the recordings, as well as can be known before anything is learnt.

What a sensor measures is that sensor's. All others the model's own equations compute, with the parameters of the model
file: a datasheet's will do, as a training only begins there. Where no formulas are known they are the sensor that is
nearest in the test's structure.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from faultline.analysis.graph.bank import Bank, bank_of
from faultline.service.core.errors import InputError
from faultline.service.core.residuals.generators import Graph
from faultline.training.layout import Layout
from faultline.training.samples import Samples

Array = npt.NDArray[np.float64]


class Example(NamedTuple):
    """K ticks in a row to learn from: signals `z` (K, nz), states `x` (K, F), and predictions `y` (K, T) to be made.

    `begin_s` is the log time of the first. It is `natural` where nothing is but as it was recorded.
    """

    recording: str
    begin_s: float
    natural: bool
    z: Array
    x: Array
    y: Array


class Equations:
    """The tests' own equations, run freely over signals."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._bank: Bank = bank_of(layout.model, layout.tests)

    @cached_property
    def _graph(self) -> Graph:
        return Graph(self._bank.graph())

    def courses(self, over: Sequence[Array]) -> list[tuple[Array, Array]]:
        """States (K, F) and predictions (K, T) over each signals (K, nz), whose first tick puts the states."""
        longest = max(len(z) for z in over)
        padded = np.stack([np.pad(z, ((0, longest - len(z)), (0, 0)), mode="edge") for z in over], axis=1)
        x = np.stack([self._bank.start(z[0]) for z in over])
        states = np.empty((longest, len(over), len(self._layout.states)))
        predictions = np.empty((longest, len(over), len(self._layout.tests)))
        for k, now in enumerate(padded):
            _, predictions[k], _, x = self._graph(z=now, x=x)
            states[k] = x
        return [(states[: len(z), b], predictions[: len(z), b]) for b, z in enumerate(over)]


def reckoned(layout: Layout, samples: Samples, equations: Equations | None) -> list[Example]:
    """Every stretch; `equations` where formulas are known.

    Raises:
        InputError: the model's equations cannot be solved, or run away.
    """
    column = [None if name is None else layout.signals.index(name) for name in layout.sensed]
    found = []
    over = [stretch.z for stretch in samples.stretches]
    courses = map(layout.started, over) if equations is None else (x for x, _ in equations.courses(over))
    for stretch, states in zip(samples.stretches, courses, strict=True):
        for f, measured in enumerate(column):
            if measured is not None:
                states[:, f] = stretch.z[:, measured]
        _check(layout, states, stretch.recording)
        found.append(
            Example(
                stretch.recording,
                stretch.begin_s,
                stretch.natural,
                stretch.z,
                states,
                stretch.z[:, layout.predicts],
            )
        )
    return found


def _check(layout: Layout, states: Array, recording: str) -> None:
    lost: Sequence[str] = [name for f, name in enumerate(layout.states) if not np.isfinite(states[:, f]).all()]
    if lost:
        raise InputError(
            f"{recording}: the equations of {layout.model.name} run away in {lost[0]}; "
            "give the model's parameters values of this system"
        )

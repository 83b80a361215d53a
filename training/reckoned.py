"""The states over the recordings, as well as can be known before anything is learnt.

What a sensor measures is that sensor's. All others the model's own equations compute, with the parameters of the model
file: a datasheet's will do, as a training only begins there.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from analysis.graph.bank import bank_of
from service.core.errors import InputError
from service.core.generators import Graph
from training.layout import Layout
from training.samples import Samples

Array = npt.NDArray[np.float64]


def reckoned(layout: Layout, samples: Samples) -> list[Array]:
    """The states (K, F) of every stretch.

    Raises:
        InputError: the model's equations cannot be solved, or run away.
    """
    bank = bank_of(layout.model, layout.tests)
    graph = Graph(bank.graph())
    column = [None if name is None else layout.signals.index(name) for name in layout.sensed]
    found = []
    for stretch in samples.stretches:
        x = bank.start(stretch.z[0])[None]
        states = np.empty((len(stretch.z), len(layout.states)))
        for k, z in enumerate(stretch.z):
            *_, x = graph(z=z[None], x=x)
            states[k] = x[0]
        for f, measured in enumerate(column):
            if measured is not None:
                states[:, f] = stretch.z[:, measured]
        _check(layout, states, stretch.recording)
        found.append(states)
    return found


def _check(layout: Layout, states: Array, recording: str) -> None:
    lost: Sequence[str] = [name for f, name in enumerate(layout.states) if not np.isfinite(states[:, f]).all()]
    if lost:
        raise InputError(
            f"{recording}: the equations of {layout.model.name} run away in {lost[0]}; "
            "give the model's parameters values of this system"
        )

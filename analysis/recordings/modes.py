"""The operating modes and the time scale of a model as the vehicle has them."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from faultline.analysis.model import Model
from faultline.analysis.recordings.track import Track
from faultline.service.core.manifest import Bounds, Input, Mode, Modes
from faultline.service.core.signals.modes import EDGE, ModeTracker
from faultline.service.core.signals.values import FloatArray
from faultline.service.core.time_scale import TimeScale


def modes_of(model: Model) -> Modes:
    """The modes as a manifest holds them."""
    steady = [
        Mode(
            name=mode.name,
            where=where_of(mode.where),
            description=mode.description,
            instruction=mode.instruction,
        )
        for mode in model.modes.steady
    ]
    return Modes(steady=steady, edges=dict(model.modes.edges), settle_s=model.modes.settle_s)


def where_of(bounds: Mapping[str, tuple[float | None, float | None]]) -> dict[str, Bounds]:
    """The bounds of signals as a manifest holds them."""
    return {name: Bounds(above=above, below=below) for name, (above, below) in bounds.items()}


def time_of(model: Model) -> TimeScale:
    """The period and the settling time."""
    return TimeScale(model.period_s, model.settling_s)


def stand_ins(model: Model) -> tuple[int, ...]:
    """For every mode, in the order of `Modes.names`, the mode whose fault-free data describe it.

    That is itself: how residuals look in a mode cannot be guessed. For the edge of a system that has none, and is in it
    only where nothing is known, it is the mode without bounds.
    """
    steady = range(EDGE + 1, EDGE + 1 + len(model.modes.steady))
    rest = next(k for k, mode in zip(steady, model.modes.steady, strict=True) if not mode.where)
    return (EDGE if model.modes.edges else rest, *steady)


def modes_at(model: Model, tracks: Mapping[str, Track], ticks: FloatArray) -> npt.NDArray[np.int64]:
    """The modes' indices in `Modes.names` at ticks (N,) [s], a period apart, from the last samples as on the vehicle.

    Values between two samples would halve a step where a tick lies between them. Only what steps from one tick to the
    next is an edge: a model is fitted to ramps as well.
    """
    inputs = [
        Input(signal=name, unit=k.unit, maximum_age_s=model.maximum_age_s(name), lower=k.min, upper=k.max)
        for name, k in model.known.items()
        if name in tracks
    ]
    tracker = ModeTracker(modes_of(model), inputs, model.period_s, part=0.0)
    z = np.column_stack([tracks[each.signal].held(ticks) for each in inputs])
    told = np.ones(len(inputs), dtype=np.bool_)
    return np.array([tracker.update(row, told) for row in z], dtype=np.int64)

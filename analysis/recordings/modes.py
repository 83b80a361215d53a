"""The operating modes and the time scale of a model as the vehicle has them."""

from faultline.analysis.model import Model
from faultline.service.core.manifest import Bounds, Mode, Modes
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.time_scale import TimeScale


def modes_of(model: Model) -> Modes:
    """The modes as a manifest holds them."""
    steady = [
        Mode(
            name=mode.name,
            where={name: Bounds(above=above, below=below) for name, (above, below) in mode.where.items()},
            description=mode.description,
            instruction=mode.instruction,
        )
        for mode in model.modes.steady
    ]
    return Modes(steady=steady, edges=dict(model.modes.edges), settle_s=model.modes.settle_s)


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

"""The operating modes of a model as the vehicle follows them, and what stands for a mode that the system has not."""

from faultline.analysis.graph.bank import PERIOD_S
from faultline.analysis.model import Model, OperatingModes
from faultline.service.core.manifest import Modes
from faultline.service.core.signals.modes import EDGE, IDLE, MAXIMUM, PARTIAL


def modes_of(model: Model) -> Modes:
    """The modes as a manifest holds them.

    It needs both limits: one that the model has not is put a whole operating range outside the signal's own, where no
    test that uses the signal can tell.
    """
    rule = _rule(model)
    known = model.known[rule.signal]
    width = known.max - known.min
    return Modes(
        signal=rule.signal,
        idle_below=known.min - width if rule.idle_below is None else rule.idle_below,
        maximum_above=known.max + width if rule.maximum_above is None else rule.maximum_above,
        edges=dict(rule.edges),
        settle_ticks=round(rule.settle_s / PERIOD_S),
    )


def stand_ins(model: Model) -> tuple[int, ...]:
    """For every mode, in the order of `MODES`, the mode whose fault-free data describe it: partial for what is not.

    A mode that the model has is described by its own data only: how its residuals look cannot be guessed.
    """
    rule = _rule(model)
    there = {
        IDLE: rule.idle_below is not None,
        PARTIAL: True,
        MAXIMUM: rule.maximum_above is not None,
        EDGE: bool(rule.edges),
    }
    return tuple(mode if there[mode] else PARTIAL for mode in sorted(there))


def _rule(model: Model) -> OperatingModes:
    """The model's own rule; without one, any signal will do: nothing is asked of it."""
    if model.modes is not None:
        return model.modes
    return OperatingModes(signal=next(iter(model.known)), idle_below=None, maximum_above=None, edges={}, settle_s=0.0)

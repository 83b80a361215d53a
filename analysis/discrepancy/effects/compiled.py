"""A model with effects as a system, made once in a process: that takes longer than to run it over ten minutes."""

from collections.abc import Sequence

from faultline.analysis.discrepancy.effects.effect import Effect
from faultline.analysis.discrepancy.effects.rewrite import rewritten
from faultline.analysis.model import Model, dump_model
from faultline.analysis.simulation import System, system_of

MOST = 256
"""Systems that are remembered: some for every entry of a library."""

_systems: dict[tuple[str, ...], System] = {}


def model_with(model: Model, effects: Sequence[Effect]) -> Model:
    """The model with effects in it, at their null values.

    Raises:
        ModelError: an effect has no place in the model.
    """
    for effect in effects:
        model = rewritten(model, effect)
    return model


def system_with(model: Model, effects: Sequence[Effect]) -> System:
    """The system of that, with all parameters that vary as symbols.

    Raises:
        ModelError: an effect has no place in the model.
    """
    key = (dump_model(model), *map(repr, effects))
    if key not in _systems:
        if len(_systems) == MOST:
            _systems.clear()
        changed = model_with(model, effects)
        _systems[key] = system_of(changed, changed.varying)
    return _systems[key]

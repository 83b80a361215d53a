"""Small studies of made runs: a vehicle that is the model with effects of the library in it, at known sizes."""

import dataclasses
from collections.abc import Mapping
from concurrent.futures import Executor, Future
from typing import Any

from made_runs import dosing

from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.discrepancy.effects.rewrite import rewritten
from faultline.analysis.discrepancy.name.attempt import Study
from faultline.analysis.model import Model, load_model
from faultline.analysis.model.file import SYSTEMS

LIBRARY = load_library(SYSTEMS / "uds")
UDS1 = load_model("uds/production")


class Inline(Executor):
    """Here and now."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> "Future[Any]":
        """What `fn` returns, as a future that is done."""
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


def with_effects(model: Model, sizes: Mapping[str, float]) -> Model:
    """The model with effects in it, each at a size of its first strength."""
    for name, size in sizes.items():
        model = rewritten(model, LIBRARY[name])
        strength = next(iter(LIBRARY[name].strengths))
        parameter = dataclasses.replace(model.parameters[strength], value=size)
        model = dataclasses.replace(model, parameters={**model.parameters, strength: parameter})
    return model


def study(entries: tuple[str, ...], sizes: Mapping[str, float], seed: int = 1, model: Model = UDS1) -> Study:
    """A study with `entries` in its library, of a vehicle with the effects in `sizes`."""
    training, held = (
        tuple(dosing(model, {}, seed + k, with_effects(model, sizes) if sizes else None).sections) for k in range(2)
    )
    return Study(f"made-{seed}-{sizes}", model, {name: LIBRARY[name] for name in entries}, training, held)

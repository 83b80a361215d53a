"""Weights beside the graph, so that networks that were trained on a bench can be adapted to a truck (thesis 8.2.5)."""

import hashlib
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from faultline.analysis.graph.networks import GRAPH, Description
from faultline.service.core.errors import InputError
from faultline.training.checkpoint import UNREADABLE, encoded, reason
from faultline.training.layout import Layout
from faultline.training.loop import Training
from faultline.training.network import Networks
from faultline.training.recipe import RECIPES, Phase, Recipe
from faultline.training.scaling import Scaling

FILE = "weights.pt"

PHASES = (Phase(16, 6, 48, 100), Phase(40, 10, 32, 150), Phase(100, 20, 24, 50))
RATE = 5e-3
"""Of an adaptation: what was learnt is nearly right, and the recording is short."""


@dataclass(frozen=True)
class Saved:
    """Weights, the scaling that they are for, and the recipe and recordings that they were trained with."""

    weights: dict[str, Tensor]
    scaling: Scaling
    recipe: Recipe
    recordings: tuple[str, ...]

    def adapting(self) -> Recipe:
        """The recipe that goes on from here."""
        return replace(self.recipe, phases=PHASES, rate=RATE)


def weights_of(training: Training, description: Description) -> bytes:
    """Content of the file of weights, of a training that is over and of which networks were made."""
    recipe, layout = training.recipe, training.layout
    return encoded(
        {
            "weights": {name: value.cpu() for name, value in training.best.items()},
            "scaling": {name: torch.tensor(value) for name, value in asdict(training.scaling).items()},
            "recipe": recipe.name,
            "hidden": list(recipe.hidden),
            "members": recipe.members,
            "functions": _functions(layout),
            "recordings": list(description.recordings),
            "graph_sha256": description.graph_sha256,
        }
    )


def load_weights(folder: Path, layout: Layout) -> Saved:
    """The weights in a folder, for this layout.

    Raises:
        InputError: there are none, they are damaged, or of other functions.
    """
    path = folder / FILE
    if not path.is_file():
        raise InputError(f"{path}: not found; give the folder that `faultline train` wrote")
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        recipe = replace(RECIPES[state["recipe"]], hidden=tuple(state["hidden"]), members=state["members"])
        scaling = Scaling(**{name: np.asarray(value.numpy()) for name, value in state["scaling"].items()})
        functions, weights, recordings = state["functions"], state["weights"], tuple(state["recordings"])
        fresh = hashlib.sha256((folder / GRAPH).read_bytes()).hexdigest() == state["graph_sha256"]
        if functions == _functions(layout):
            Networks(layout, recipe, recipe.members).load_state_dict(weights)
    except UNREADABLE as error:
        raise InputError(f"{path}: cannot be read, {reason(error)}; train the networks anew") from error
    if not fresh:
        raise InputError(f"{path}: is not of the graph beside it; copy the whole folder, or train anew")
    if len(functions) != len(_functions(layout)):
        raise InputError(f"{path}: was written by another version; train the networks anew")
    if functions != _functions(layout):
        raise InputError(f"{path}: is of other tests or of another model; give the same --tests and model as then")
    return Saved(weights, scaling, recipe, recordings)


def _functions(layout: Layout) -> list[Any]:
    columns = [np.where(of == layout.padding, -1, of).tolist() for of in (layout.since, layout.rates, layout.outputs)]
    return [[*layout.signals], [*layout.states], *columns]

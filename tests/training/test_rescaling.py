"""Networks that are put on other scales compute the same."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
import torch

from faultline.analysis.model import load_model
from faultline.training.layout import Layout, layout_of
from faultline.training.network import Networks
from faultline.training.recipe import RECIPES, Recipe
from faultline.training.rescaling import LEAST, at_least, rescaled
from faultline.training.scaling import Scaling

Array = npt.NDArray[np.float64]

SEED, MEMBERS, TICKS = 31, 2, 20


def scaling(rng: np.random.Generator, layout: Layout) -> Scaling:
    nz, F = len(layout.signals), len(layout.states)
    return Scaling(rng.normal(size=nz), rng.uniform(0.5, 3.0, nz), rng.normal(size=F), rng.uniform(0.5, 3.0, F))


def predicted(
    layout: Layout, recipe: Recipe, weights: dict[str, torch.Tensor], of: Scaling, x: Array, z: Array
) -> Array:
    """What the networks of these weights make of signals (L, nz), from states (F,), in the signals' own units."""
    networks = Networks(layout, recipe, recipe.members)
    networks.load_state_dict(weights)
    networks.to(torch.float64)
    u = np.concatenate([of.z(z[1:]), of.z(z[:-1]), np.zeros((len(z) - 1, 1))], axis=1)
    start = torch.as_tensor(of.x(x)).expand(recipe.members, -1)[:, :, None]
    run = networks.run(start, torch.as_tensor(u)[:, None, :, None].expand(-1, recipe.members, -1, -1))
    y = run.y.detach().numpy()[..., 0]
    return np.asarray(y * of.z_size[layout.predicts] + of.z_offset[layout.predicts])


@pytest.mark.parametrize("name", ["default", "thesis"])
def test_other_scales_give_the_same_predictions(name: str) -> None:
    torch.manual_seed(SEED)
    rng, layout = np.random.default_rng(SEED), layout_of(load_model("uds"))
    recipe = replace(RECIPES[name], members=MEMBERS, hidden=(4, 4))
    networks = Networks(layout, recipe, MEMBERS)
    for parameter in networks.parameters():
        torch.nn.init.normal_(parameter, std=0.4)
    networks.bound(np.full(len(layout.states), -1.5), np.full(len(layout.states), 1.5))
    before, after = scaling(rng, layout), scaling(rng, layout)
    x, z = rng.normal(size=len(layout.states)), rng.normal(size=(TICKS + 1, len(layout.signals)))
    weights = networks.state_dict()
    moved = rescaled(weights, layout, recipe, before, after)
    one = predicted(layout, recipe, weights, before, x, z)
    other = predicted(layout, recipe, moved, after, x, z)
    assert one.std(axis=0).min() > 1e-3, "predictions that move"
    np.testing.assert_allclose(other, one, atol=1e-5)


def test_a_signal_that_hardly_moves_keeps_a_tenth_of_its_scale() -> None:
    before = Scaling(np.zeros(2), np.ones(2), np.zeros(1), np.ones(1))
    own = Scaling(np.ones(2), np.array([0.0, 0.5]), np.ones(1), np.array([1e-9]))
    found = at_least(own, before)
    assert found.z_size.tolist() == [LEAST, 0.5]
    assert found.x_size.tolist() == [LEAST]
    assert found.z_offset.tolist() == [1.0, 1.0]

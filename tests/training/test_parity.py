"""The graph computes what torch does, over whole recordings with carried states, for every shape of network."""

import dataclasses

import numpy as np
import numpy.typing as npt
import pytest
import torch
from made_samples import circuit, dosing, rc

from faultline.analysis.graph.cells import cell_graph
from faultline.analysis.graph.networks import GRAPH
from faultline.analysis.model import load_model
from faultline.service.core.residuals.generators import Graph
from faultline.training.bank import generator_of
from faultline.training.free_run import free_run
from faultline.training.layout import Layout, layout_of
from faultline.training.loop import Training
from faultline.training.network import Networks, Run
from faultline.training.recipe import DEFAULT, THESIS, Phase, Recipe
from faultline.training.reckoned import Equations, reckoned
from faultline.training.samples import Samples
from faultline.training.scaling import scaling_of
from faultline.training.variance import Variances, variances
from faultline.training.weights import cells_of
from faultline.training.windows import Windows

PARITY = 1e-5
"""Of the largest |y|: what the project promises."""


@pytest.mark.parametrize("bounded", [False, True])
@pytest.mark.parametrize(
    ("layout", "samples", "recipe"),
    [
        (layout_of(load_model("uds")), dosing(1), dataclasses.replace(DEFAULT, members=3, folds=3)),
        (layout_of(load_model("uds"), ["t02", "t13"]), dosing(2), dataclasses.replace(THESIS, hidden=(16, 16, 16))),
        (rc(), circuit(1), dataclasses.replace(DEFAULT, members=2, folds=2)),
    ],
    ids=["default", "thesis", "rc"],
)
def test_the_graph_is_the_networks(layout: Layout, samples: Samples, recipe: Recipe, bounded: bool) -> None:
    torch.manual_seed(7)
    examples = reckoned(layout, samples, Equations(layout))
    scaling = scaling_of(examples, recipe.scale)
    networks = Networks(layout, recipe, recipe.members)
    with torch.no_grad():
        for parameter in networks.parameters():  # nothing may be zero by chance of how it begins
            parameter.add_(0.05 * torch.randn_like(parameter))
    if bounded:
        narrow = np.full(len(layout.states), 0.1)
        networks.bound(-narrow, narrow)
    windows = Windows(layout, examples, [], scaling, recipe.folds, 0)
    course = free_run(networks, windows)
    spread = variances(layout, windows, course, 0)
    graph = Graph(cell_graph(cells_of(layout, scaling, networks, spread)))
    z = samples.stretches[0].z
    generators = [generator_of(layout, t, recipe.members) for t in range(len(layout.tests))]
    start = [
        s.offset + sum(g * z[0, layout.signals.index(n)] for n, g in s.gain.items())
        for o in generators
        for s in o.states
    ]
    x = np.array(start)[None]
    r, sigma = (np.empty((len(z), len(layout.tests))) for _ in range(2))
    for k, sample in enumerate(z):
        r[k : k + 1], _, sigma[k : k + 1], x = graph(z=sample[None], x=x)
    x0 = windows.starts[0][None, :, None].expand(recipe.members, -1, -1)
    with torch.no_grad():
        run = networks.run(x0, windows.u[:, None, :, None].expand(-1, recipe.members, -1, -1))
    assert (float(run.x[1:].abs().max()) <= 0.1 + 1e-6) == bounded
    size, offset = scaling.z_size[layout.predicts], scaling.z_offset[layout.predicts]
    y = run.y[:, :, :, 0].mean(dim=1).numpy() * size + offset
    assert np.abs(z[:, layout.predicts] - r - y).max() < PARITY * np.abs(y).max()
    assert sigma == pytest.approx(sigma_of(spread, windows, run, recipe.newest) * size, rel=1e-3)
    assert all(generator.graph == GRAPH for generator in generators)


def sigma_of(spread: Variances, windows: Windows, run: Run, newest: bool) -> npt.NDArray[np.float64]:
    """Sigma (K, T), scaled, as `training.variance` has it, from states now and a tick before."""
    y = run.y[..., 0]  # (K, M, T)
    among = ((y - y.mean(dim=1, keepdim=True)) ** 2).sum(dim=1) / max(y.shape[1] - 1, 1)
    states = run.x[..., 0].mean(dim=1).T  # (F, K)
    before = torch.cat([windows.starts[:1].T, states[:, :-1]], dim=1)
    old = before if newest else states
    with torch.no_grad():
        log_v = spread.stack(torch.cat([states, old, windows.u.T])[None])[0].T
        found = spread.factor * (log_v.exp() + among).sqrt()
    return np.asarray(found.numpy(), dtype=np.float64)


def test_recordings_side_by_side_are_each_by_itself() -> None:
    layout, samples = layout_of(load_model("uds"), ["t06", "t21"]), dosing(3)
    examples = reckoned(layout, samples, Equations(layout))
    scaling = scaling_of(examples, "spread")
    networks = Networks(layout, dataclasses.replace(DEFAULT, folds=2), 2)
    windows = Windows(layout, examples, [], scaling, 2, 0)
    course = free_run(networks, windows)
    spread = variances(layout, windows, course, 0)
    graph = Graph(cell_graph(cells_of(layout, scaling, networks, spread)))
    z = samples.stretches[0].z[[0, 30, 77]]
    x = np.random.default_rng(0).uniform(5e5, 1e6, (3, 2 * len(layout.states) + len(layout.held)))
    together = graph(z=z, x=x)
    for row in range(3):
        for found, alone in zip(together, graph(z=z[row : row + 1], x=x[row : row + 1]), strict=True):
            assert found[row] == pytest.approx(alone[0], rel=1e-6)


def test_a_network_that_runs_away_has_a_sigma_that_is_a_number() -> None:
    """Else float32 ends, and a bundle with it is refused."""
    layout, samples = layout_of(load_model("uds"), ["t06"]), dosing(3)
    examples = reckoned(layout, samples, Equations(layout))
    networks = Networks(layout, dataclasses.replace(DEFAULT, folds=2), 2)
    windows = Windows(layout, examples, [], scaling_of(examples, "spread"), 2, 0)
    spread = variances(layout, windows, free_run(networks, windows), 0)
    graph = Graph(cell_graph(cells_of(layout, scaling_of(examples, "spread"), networks, spread)))
    far = np.full((1, 2 * len(layout.states) + len(layout.held)), 1e12)
    _, _, sigma, _ = graph(z=samples.stretches[0].z[:1], x=far)
    assert np.isfinite(sigma).all()
    assert (sigma > 1e6).all()


def test_training_bounds_the_states_by_what_it_has_seen() -> None:
    """A state that runs away would end the graph of all tests: infinity times zero is no number."""
    layout, samples = layout_of(load_model("uds"), ["t06"]), dosing(3)
    recipe = dataclasses.replace(DEFAULT, members=2, folds=2, phases=(Phase(4, 0, 8, 1),))
    training = Training(layout, samples, recipe, 0)
    networks, x = training.networks, training.windows.starts.T
    assert bool((networks.lowest[0, :, 0] < x.min(dim=1).values).all())
    assert bool((networks.highest[0, :, 0] > x.max(dim=1).values).all())
    with torch.no_grad():
        networks.rates.bias[:] = 1e9
    run = networks.run(x[None, :, :1].expand(2, -1, -1), training.windows.u[:9, None, :, None].expand(-1, 2, -1, -1))
    assert bool(torch.isfinite(run.y).all())
    torch.testing.assert_close(run.x[-1], networks.highest)

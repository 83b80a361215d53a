"""From a finished training to a folder's content: variance, the graph and what a manifest says of it."""

import hashlib

import numpy as np
import torch

from faultline.analysis.graph.cells import cell_graph
from faultline.analysis.graph.networks import GRAPH, SCHEMA, Description, Networks
from faultline.service.core.manifest import Generator, State
from faultline.training.free_run import free_run
from faultline.training.layout import Layout
from faultline.training.loop import Training
from faultline.training.samples import Samples
from faultline.training.unseen import differ
from faultline.training.variance import cross_fit, variances
from faultline.training.weights import cells_of

HELD = ".before"
"""Behind the name of a signal: its value a tick before, as a state."""


def networks_of(training: Training, samples: Samples, seed: int) -> Networks:
    """The networks of a training that is over."""
    layout, scaling, trained = training.layout, training.scaling, training.finish()
    differ(trained, layout, training.windows, seed)
    course = free_run(trained, training.windows)
    spread = variances(layout, training.windows, course, seed)
    cells = cells_of(layout, scaling, trained, spread)
    graph = cell_graph(cells)
    left = cross_fit(training.windows, course, layout.model.period_s).left
    error = left.pow(2).mean(dim=1).sqrt().to(torch.float64).numpy() * scaling.z_size[layout.predicts]
    members = training.recipe.members
    description = Description(
        schema=SCHEMA,
        model=layout.model.name,
        signals=[*layout.signals],
        period_s=layout.model.period_s,
        recipe=training.recipe.name,
        members=members,
        seed=seed,
        recordings=[*samples.digests],
        vehicle=samples.vehicle,
        graph_sha256=hashlib.sha256(graph).hexdigest(),
        generators=[generator_of(layout, t, members) for t in range(len(layout.tests))],
        error=error.tolist(),
    )
    return Networks(description, graph)


def generator_of(layout: Layout, t: int, members: int) -> Generator:
    """What the manifest says of the networks of a test: each member has states of its own, all share what is held."""
    held = [layout.signals[signal] for owner, signal in layout.held if owner == t]
    test, own = layout.tests[t], np.flatnonzero(layout.owner == t)
    starts = [layout.starts[f] for f in own]
    return Generator(
        name=f"{test.name}.rnn",
        test=test.name,
        graph=GRAPH,
        predicts=test.predicts,
        inputs=list(test.known),
        states=[
            *(
                State(name=f"{state.name}.{m + 1}", offset=state.offset, gain=state.gain)
                for m in range(members)
                for state in starts
            ),
            *(State(name=f"{signal}{HELD}", offset=0.0, gain={signal: 1.0}) for signal in held),
        ],
        faults=list(test.faults),
        equations=list(test.equations),
        warm_up_s=layout.model.settling_s,
    )

"""Samples of systems whose equations are known here, without a log in between."""

import dataclasses

import numpy as np
import numpy.typing as npt
import torch

from faultline.analysis.model import load_model
from faultline.training.layout import Layout, layout_of
from faultline.training.recipe import DEFAULT, Phase
from faultline.training.samples import Samples, Stretch

PERIOD_S = 0.2  # of the dosing system


Array = npt.NDArray[np.float64]

torch.set_num_threads(1)  # tests run side by side

SHORT = dataclasses.replace(
    DEFAULT, members=2, folds=2, hidden=(8,), phases=(Phase(30, 15, 32, 50), Phase(60, 30, 16, 150)), warm_up=5
)
"""A recipe of seconds, for a system of one state that nothing measures: windows must be longer than it remembers."""


def rc() -> Layout:
    """A resistor and a capacitor: one test, whose h has a state and a signal as arguments."""
    return layout_of(load_model("rc"))


def circuit(seed: int, ticks: int = 1500, stretches: int = 1, noise: float = 1e-4) -> Samples:
    """The circuit on a voltage that jumps: u and y_i, R 200 Ohm, C 0.01 F, each tick exactly integrated."""
    rng = np.random.default_rng(seed)
    found = []
    for number in range(stretches):
        u = np.repeat(rng.uniform(-10.0, 10.0, -(-ticks // 15)), 15)[:ticks]
        tau, u_c, y = 2.0, u[0], []
        for now in u:
            u_c = now + (u_c - now) * np.exp(-PERIOD_S / tau)
            y.append((now - u_c) / 200.0)
        z = np.column_stack([u, np.array(y) + rng.normal(0.0, noise, ticks)])
        found.append(Stretch(f"made-{seed}-{number}", z, 0.0))
    return Samples(("u", "y_i"), tuple(found), (f"{seed:064x}",), None, PERIOD_S * ticks)


def dosing(seed: int, ticks: int = 400) -> Samples:
    """Signals of the dosing system that wander in their ranges: enough for scales and shapes, no physics."""
    rng = np.random.default_rng(seed)
    model = load_model("uds")
    steps = rng.uniform(0.2, 0.8, (-(-ticks // 20), len(model.known)))
    share = np.repeat(steps, 20, axis=0)[:ticks] + rng.normal(0.0, 0.01, (ticks, len(model.known)))
    lower, upper = (np.array([getattr(k, bound) for k in model.known.values()]) for bound in ("min", "max"))
    z = lower + share * (upper - lower)
    return Samples(tuple(model.known), (Stretch(f"made-{seed}", z, 0.0),), (f"{seed:064x}",), None, PERIOD_S * ticks)

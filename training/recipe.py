"""Recipes: how networks are shaped and trained. `default` is ours, `thesis` that of 5.10 and 5.11."""

from dataclasses import dataclass
from typing import Literal

from faultline.training.scaling import Kind


@dataclass(frozen=True)
class Phase:
    """`iterations` on `batch` windows of `length` ticks, of whose beginning `burn` ticks only settle the states.

    A length of None is the recordings from end to end.
    """

    length: int | None
    burn: int
    batch: int
    iterations: int


@dataclass(frozen=True)
class Recipe:
    """What a training does.

    Cell: `relaxation` x+ = x + s (f - x) with s learnt per state, or `increment` x+ = x + Ts g; of the `newest` inputs
    or those before (thesis 3.6), or of those at `both_ends` of the tick: when in between an input changed, a sample
    does not tell. `learns_h`: h is a network even where it is just a state. `linear` begins with the least-squares
    linear part. `rate` of Adam, falling as a cosine to `last` of it, or by 2 % every ten iterations where `last` is
    None; the first `warm_up` iterations have less. Gradients of a member's test are cut at norm `clip`; layers behind
    the first decay (AdamW) by `decay` times the rate, towards functions that are linear. `latent` weighs measured
    states that are not what a test predicts. Messages may be `moved` to other phases, `copies` of the recordings are
    `varied` by so much of the signals' spread (`training.varied`). A member does not see one of the `folds` of the
    recordings, by which its best weights are kept; 0: all see everything, and the last weights stay.
    """

    name: str
    hidden: tuple[int, ...]
    cell: Literal["relaxation", "increment"]
    newest: bool
    both_ends: bool
    learns_h: bool
    linear: bool
    scale: Kind
    phases: tuple[Phase, ...]
    rate: float
    last: float | None
    warm_up: int
    clip: float
    decay: float
    latent: float
    moved: bool
    varied: float
    copies: int
    folds: int
    members: int


DEFAULT = Recipe(
    name="default",
    hidden=(22, 22),  # with the linear part, that makes 24 in the graph: a multiple of 8 is a tenth faster there
    cell="relaxation",
    newest=True,
    both_ends=True,
    learns_h=False,
    linear=True,
    scale="spread",
    phases=(Phase(4, 0, 128, 150), Phase(16, 6, 48, 300), Phase(40, 10, 32, 250), Phase(100, 20, 24, 80)),
    rate=2e-2,
    last=0.02,
    warm_up=20,
    clip=1.0,
    decay=0.1,
    latent=0.02,
    moved=True,
    varied=0.3,
    copies=1,
    folds=5,
    members=5,
)

THESIS = Recipe(
    name="thesis",
    hidden=(128, 128, 128),
    cell="increment",
    newest=False,
    both_ends=False,
    learns_h=True,
    linear=False,
    scale="range",
    phases=(Phase(None, 0, 1, 1500),),
    rate=5e-3,
    last=None,
    warm_up=50,
    clip=1.0,
    decay=0.0,
    latent=0.0,
    moved=False,
    varied=0.0,
    copies=0,
    folds=0,
    members=1,
)
"""3 layers of 128 ReLU, Adam 0.005 less 2 % every ten of 1,500 epochs, each over the whole recording, inputs in 0..1.

Taken literally it diverges at the first step: a random g, summed over 3,000 ticks, is an unstable integrator. What is
added makes it run: last layers begin small, h as the identity, the rate over 50 epochs from zero, the gradient is cut.
"""

RECIPES = {recipe.name: recipe for recipe in (DEFAULT, THESIS)}

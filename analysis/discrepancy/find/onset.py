"""A fault or a model error: physics that a model lacks is there from the start, a fault sets in.

What an equation misses, as it was smoothed over time, is described by one step or by a straight line. Where the step
is much the better of the two, something happened at that time.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from analysis.discrepancy.find.locate import Location
from analysis.model import Model

Array = npt.NDArray[np.float64]

AWAY_S = 30.0
"""A step nearer than this to the beginning or the end may be anything."""

EXPLAINED = 0.6
"""Of the curve's square around its mean: a step that explains less is none."""

BETTER = 0.5
"""Of what a straight line leaves: a wear that grows is no fault that set in."""


CLEAR = 30.0
"""Evidence [nats] that something is missing; with less there is no curve to look at."""


@dataclass(frozen=True)
class Onset:
    """When something set in, `t_s` [s] of log time, in which `equation`, with the `faults` that enter there.

    `where` names the recordings.
    """

    t_s: float
    equation: str
    faults: tuple[str, ...]
    where: str

    def what(self, model: Model) -> str:
        """What happened, for people."""
        faults = "; or ".join(
            f"{model.faults[name].component}: {model.faults[name].description}" for name in self.faults
        )
        return (
            f"something set in at {self.t_s:.0f} s of the {self.where} recordings, as faults do ({self.equation}"
            f"{f', where these enter: {faults}' if faults else ''})"
        )

    def advice(self) -> str:
        """How to tell."""
        return (
            "physics that a model lacks would be there from the start: take a recording from before it, and let "
            "`faultline diagnose` look at this one; nothing was added to the model"
        )


def onset(model: Model, location: Location, where: str) -> Onset | None:
    """Whether what is missing set in while it was recorded; None where it did not, or nothing is missing.

    `where` names the recordings of the location.
    """
    if not location.members or 0.5 * location.suspects[0].evidence < CLEAR:
        return None
    suspect = max((s for s in location.suspects if s.equation in location.members), key=lambda s: s.evidence)
    t, value, weight = suspect.t, suspect.value, 1.0 / suspect.sd**2
    order = np.argsort(t, kind="stable")
    t, value, weight = t[order], value[order], weight[order]
    whole = _left(value, weight, np.ones((len(t), 1)))
    line = _left(value, weight, np.column_stack([np.ones(len(t)), t - t.mean()]))
    inside = t[(t > t[0] + AWAY_S) & (t < t[-1] - AWAY_S)]
    if not len(inside) or whole <= 0.0:
        return None
    left = [_left(value, weight, np.column_stack([t < at, t >= at]).astype(np.float64)) for at in inside]
    best = int(np.argmin(left))
    if left[best] > (1.0 - EXPLAINED) * whole or left[best] > BETTER * line:
        return None
    faults = (
        tuple(fault.name for name in location.members if (fault := model.equations[name].fault) is not None)
        if all(name in model.equations for name in location.members)
        else ()
    )
    return Onset(float(inside[best]), location.members[0], faults, where)


def _left(value: Array, weight: Array, features: Array) -> float:
    """The weighted square that a fit of the features leaves."""
    root = np.sqrt(weight)
    A, b = features * root[:, None], value * root
    return float(np.sum((b - A @ np.linalg.lstsq(A, b, rcond=None)[0]) ** 2))

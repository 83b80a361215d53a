"""A fault or a model error: physics that a model lacks is there from the start, a fault sets in.

What an equation misses, as it was smoothed over time, is described by one step, and by what physics does: a straight
line, something that settles, the quantities that it was found to follow. Where the step is much the better account,
something happened at that time.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from faultline.analysis.discrepancy.find.locate import Location
from faultline.analysis.model import Model

Array = npt.NDArray[np.float64]

AWAY = 1.5
"""Settling times. A step nearer than this to the beginning or the end may be anything."""

EXPLAINED = 0.6
"""Of the curve's square around its mean: a step that explains less is none."""

BETTER = 0.5
"""Of what physics would leave: a wear that grows is no fault that set in."""

CLEAR = 30.0
"""Evidence [nats] that something is missing; with less there is no curve to look at."""


SETTLING = (1.0, 2.0, 4.0, 8.0)
"""What settles, with these time constants in settling times: a warm-up, a clock that is found."""


@dataclass(frozen=True)
class Onset:
    """When something set in, `t_s` [s] of log time of a `recording`, in which `equation`, with the `faults` there."""

    t_s: float
    equation: str
    faults: tuple[str, ...]
    recording: str

    def what(self, model: Model) -> str:
        """What happened, for people."""
        faults = "; or ".join(
            f"{model.faults[name].component}: {model.faults[name].description}" for name in self.faults
        )
        return (
            f"something set in at {self.t_s:.0f} s of {self.recording}, as faults do ({self.equation}"
            f"{f', where these enter: {faults}' if faults else ''})"
        )

    def advice(self) -> str:
        """How to tell."""
        return (
            "physics that a model lacks would be there from the start: take a recording from before it, and let "
            "`faultline diagnose` look at this one; nothing was added to the model"
        )


def onset(model: Model, location: Location, recordings: Sequence[str]) -> Onset | None:
    """Whether what is missing set in while it was recorded; None where it did not, or nothing is missing.

    `recordings` are the names of those of the location.
    """
    if not location.members or 0.5 * location.suspects[0].evidence < CLEAR:
        return None
    suspect = max((s for s in location.suspects if s.equation in location.members), key=lambda s: s.evidence)
    courses = location.courses[suspect.equation]
    for log, recording in enumerate(recordings):
        here = np.asarray(suspect.log == log)
        t_s = _step(suspect.t[here], suspect.value[here], 1.0 / suspect.sd[here] ** 2, courses[here], model.settling_s)
        if t_s is not None:
            own = [model.equations[name] for name in location.members if name in model.equations]  # not an effect's
            return Onset(t_s, location.members[0], tuple(e.fault.name for e in own if e.fault), recording)
    return None


def _step(t: Array, value: Array, weight: Array, courses: Array, settling_s: float) -> float | None:
    """When [s] the values (cells,) take a step; None if that is no good account of them.

    `courses` (cells, n) are those of the quantities that they follow.
    """
    away_s = AWAY * settling_s
    inside = t[(t > t.min() + away_s) & (t < t.max() - away_s)] if len(t) else t
    always = np.ones((len(t), 1))
    whole = _left(value, weight, always)
    if not len(inside) or whole <= 0.0:
        return None
    since = (t[:, None] - t.min()) / settling_s
    physics = [t[:, None] - t.mean(), courses, *(np.exp(-since / tau) for tau in SETTLING)]
    otherwise = min(_left(value, weight, np.hstack([always, course])) for course in physics)
    left = {at: _left(value, weight, np.hstack([always, (t >= at)[:, None]])) for at in inside}
    best = min(left, key=lambda at: left[at])
    return float(best) if left[best] <= min((1.0 - EXPLAINED) * whole, BETTER * otherwise) else None


def _left(value: Array, weight: Array, features: Array) -> float:
    """The weighted square that a fit of the features leaves."""
    root = np.sqrt(weight)
    A, b = features * root[:, None], value * root
    return float(np.sum((b - A @ np.linalg.lstsq(A, b, rcond=None)[0]) ** 2))

"""The active test cycle: steps that a technician, or a routine of the control unit, brings about. Only seen is done.

A step is a mode that the service observes on the bus, held for so long that all tests can tell of it.
"""

from collections.abc import Sequence
from typing import NamedTuple

from faultline.service.core.time_scale import Span

HOLD = Span(settlings=3, seconds=60)
"""A suspicion is looked at afresh one settling time after it; the level of the last 1.5 to 3 of
them is compared with other drives (`core.decision.window.Recent`); an alarm that goes heals after 0.75 in the mode that
showed it."""

VISITS = 2
"""Means of a mode differ from visit to visit by more than noise does (`Evidence.visit`), and what shows only in one
mode is to be seen coming back: two visits tell more than one of twice the length."""

QUIET = Span(settlings=0.75, seconds=15)
"""So long nothing must be suspected before the end: it is what the decision asks of quiet in a mode."""

STOOD = Span(settlings=1.3, seconds=26)
"""So long the explanations of a fault must have stood: one until they are ranked, and two looks at
them."""

PATIENCE = Span(settlings=30, seconds=600)
"""After this what is suspected is confirmed or taken for the drive's."""


class Step(NamedTuple):
    """Hold `mode` until all tests could tell of it for `hold_s` [s]; the `visit`-th time, from 1."""

    mode: str
    visit: int
    hold_s: float


def plan(modes: Sequence[str], hold_s: float, visits: int = VISITS) -> tuple[Step, ...]:
    """Return the steps in the order in which they are asked for; any order counts.

    >>> [f"{step.mode} {step.visit}" for step in plan(["low", "high"], 60.0)]
    ['low 1', 'high 1', 'low 2', 'high 2']
    """
    return tuple(Step(mode, visit, hold_s) for visit in range(1, visits + 1) for mode in modes)

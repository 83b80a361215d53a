"""The active test cycle: steps that a technician, or a routine of the control unit, brings about. Only seen is done.

A step is a mode that the service observes on the bus, held for so long that all tests can tell of it.
"""

from typing import NamedTuple

# A suspicion is looked at afresh once residuals have settled, 20 s (the warm-up of the tests) after it; the level that
# the last 30 to 60 s show is compared with other days (`core.decision.window.Recent`); an alarm that goes heals after
# 15 s in the mode that showed it. A minute of a mode is enough of each.
HOLD_S = 60.0
# Means of a mode differ from visit to visit by more than noise does (`Evidence.visit`), and what shows only in one mode
# is to be seen coming back: twice a minute tells more than two minutes at once.
VISITS = 2
# So long nothing must be suspected before the end: it is what the decision asks of quiet in a mode.
QUIET_S = 15.0
# So long the explanations of a fault must have stood: 20 s until they are ranked, and two looks at them, 3 s apart.
STOOD_S = 26.0
# What is suspected is confirmed or taken for the day's within ten minutes.
PATIENCE_S = 600.0

REQUIRED = ("idle", "partial", "maximum")
"""Modes in which every fault has to be looked for; at an *edge* nothing can be told."""

ORDERS = {
    "idle": "hold the pressure and do not dose",
    "partial": "dose partially: any dose between none and full, held steady",
    "maximum": "dose at maximum: the valve held open",
}
"""What brings a mode about."""


class Step(NamedTuple):
    """Hold `mode` until all tests could tell of it for `hold_s` [s]; the `visit`-th time, from 1."""

    mode: str
    visit: int
    hold_s: float


def plan(hold_s: float = HOLD_S, visits: int = VISITS) -> tuple[Step, ...]:
    """Return the steps in the order in which they are asked for; any order counts.

    >>> [f"{step.mode} {step.visit}" for step in plan()]
    ['idle 1', 'partial 1', 'maximum 1', 'idle 2', 'partial 2', 'maximum 2']
    """
    return tuple(Step(mode, visit, hold_s) for visit in range(1, visits + 1) for mode in REQUIRED)

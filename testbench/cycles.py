"""Cycles: what is asked of the rig over time, as in thesis 5.7.1.

Every cycle stands still first (the external sensors' zero), then builds pressure, and doses only from `DOSING_FROM` on.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import cycle as repeat

import numpy as np

from testbench.errors import RigError
from testbench.units import BAR

STANDING = 15.0  # s, pump off at atmospheric pressure
DOSING_FROM = 40.0  # s
SYSTEM = 10 * BAR  # Pa absolute
SHORTEST = 60.0  # s, room for some dosing


@dataclass(frozen=True)
class Segment:
    """`duration` [s] at pressure `setpoint` [Pa absolute, None: pump off] and dose `duty` [0..1]."""

    duration: float
    setpoint: float | None
    duty: float = 0.0


@dataclass(frozen=True)
class Cycle:
    """A named cycle: `body(duration, rng)` yields what follows the start; it may yield more than fits."""

    name: str
    text: str
    body: Callable[[float, np.random.Generator], Iterator[Segment]]

    def segments(self, duration: float, rng: np.random.Generator) -> list[Segment]:
        """Segments that fill exactly `duration` [s]; raises `RigError` if that is too short."""
        check_duration(duration)
        start = [Segment(STANDING, None), Segment(DOSING_FROM - STANDING, SYSTEM)]
        left = duration - DOSING_FROM
        for segment in self.body(left, rng):
            if segment.duration >= left:
                return [*start, Segment(left, segment.setpoint, segment.duty)]
            start.append(segment)
            left -= segment.duration
        return [*start, Segment(left, SYSTEM)]


# (duration [s], duty). Idle and maximum come back within every 60 to 90 s in both tables; the values between differ.
_TRAINING = (
    (12, 0.10), (14, 0.30), (16, 1.0), (13, 0.0), (10, 0.60), (14, 0.20), (9, 0.80), (15, 1.0), (12, 0.0), (8, 0.45),
    (14, 0.70), (11, 0.05), (15, 1.0), (14, 0.90), (13, 0.0), (16, 0.50), (12, 0.25), (14, 1.0), (10, 0.15), (12, 0.0),
)  # fmt: skip
_VALIDATION = (
    (16, 0.40), (15, 1.0), (14, 0.0), (18, 0.75), (14, 1.0), (12, 0.15), (15, 0.0), (17, 0.55), (16, 1.0), (15, 0.35),
    (14, 0.0), (16, 0.85), (13, 0.08), (15, 1.0), (16, 0.0), (18, 0.25), (14, 0.65), (16, 1.0), (15, 0.0),
)  # fmt: skip
_LADDER = (8.0, 6.0, 7.0, 9.0, 11.0, 12.0, 10.0)  # bar absolute
_LADDER_SHARE = 0.3  # of the time after the start


def _training(duration: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Dose steps of many sizes, then a pressure ladder without dosing; the same for every seed."""
    del rng
    left = (1 - _LADDER_SHARE) * duration
    for length, duty in repeat(_TRAINING):
        yield Segment(min(length, left), SYSTEM, duty)
        left -= length
        if left <= 0:
            break
    for level in _LADDER:
        yield Segment(_LADDER_SHARE * duration / len(_LADDER), level * BAR)


def _validation(duration: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Other dose steps at other times, in the same range; the same for every seed."""
    del duration, rng
    for length, duty in repeat(_VALIDATION):
        yield Segment(length, SYSTEM, duty)


def _drive(duration: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Doses as a road might ask for: a quarter idle, some at maximum, the rest anything between."""
    del duration
    while True:
        length, kind, duty = rng.uniform(4, 25), rng.random(), rng.uniform(0.05, 0.95)
        yield Segment(length, SYSTEM, 0.0 if kind < 0.25 else 1.0 if kind > 0.85 else float(duty))


CYCLES = {
    "training": Cycle("training", "dose steps of many sizes, then a pressure ladder from 6 to 12 bar", _training),
    "validation": Cycle(
        "validation", "other dose steps; idle, partial and maximum dose within every 90 s", _validation
    ),
    "drive": Cycle("drive", "random doses, other ones for every seed", _drive),
}


def check_duration(duration: float) -> None:
    """Raises `RigError` if `duration` [s] leaves no room to dose."""
    if duration < SHORTEST:
        raise RigError(f"duration {duration:g} s is too short for a cycle; give at least {SHORTEST:g}")


def cycle(name: str) -> Cycle:
    """The cycle called `name`; raises `RigError` if there is none."""
    if name not in CYCLES:
        raise RigError(f"there is no cycle {name!r}; choose one of {', '.join(CYCLES)}")
    return CYCLES[name]

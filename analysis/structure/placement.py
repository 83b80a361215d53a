"""Sensor placement: which minimal sets of sensors reach the best detectability or isolability, for a given causality.

What is required is all that all candidate sensors together reach. More sensors never take away a test, whatever its
causality; so a requirement that some sensors do not meet can only be met by one outside of a largest such set, and a
search over these conflicts finds every minimal set (hitting sets, after Reiter 1987). Faulty sensors bring requirements
of their own (their faults are to be detected and isolated too), which count only where the sensor is chosen; no further
sensor makes one of them fail that is met.

Source of the problem: Krysander and Frisk, Sensor placement for fault diagnosis (IEEE Transactions on Systems, Man and
Cybernetics A, 2008), who solve it for mixed causality.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

from faultline.analysis.model.errors import ModelError
from faultline.analysis.structure.diagnosability import Interpretation, OverDeterminedPart
from faultline.analysis.structure.matching import bits, mask_of
from faultline.analysis.structure.sensors import add_sensors, check_unknowns
from faultline.analysis.structure.structure import Structure

MANY_POSITIONS = 40
"""Beyond these, listing every minimal set may take minutes."""

Goal = Literal["isolability", "detectability"]


@dataclass(frozen=True)
class SensorSet:
    """Sensors to add, by the unknowns they measure: one that comes twice is measured by two. `cost` is their sum."""

    sensors: tuple[str, ...]
    cost: float


def place_sensors(
    structure: Structure,
    positions: Sequence[str],
    causality: Interpretation,
    goal: Goal = "isolability",
    costs: Mapping[str, float] | None = None,
    faulty: bool = False,
) -> list[SensorSet]:
    """All minimal sets of sensors at `positions` (unknowns) that reach what all of them reach; cheap, then small first.

    The goal "isolability" includes detectability. With `faulty` sensors each has a fault, which has to be detected and
    isolated, and isolated from, as far as two sensors at every position would do; only then can two at one position be
    needed. A single empty set says that no sensor is needed. `costs` of a sensor by position are 1 unless given.

    Raises:
        ModelError: a position is not an unknown or comes twice, a cost is no position's or not positive, or there is no
            such goal or causality.
    """
    prices = _checked(structure, positions, goal, costs)
    search = _Placement(structure, positions, causality, goal, faulty)
    chosen = [tuple(itertools.chain(*map(itertools.repeat, positions, counts))) for counts in search.minimal()]
    sets = [SensorSet(sensors, math.fsum(prices[name] for name in sensors)) for sensors in chosen]
    order = {name: i for i, name in enumerate(positions)}
    return sorted(sets, key=lambda s: (s.cost, len(s.sensors), [order[name] for name in s.sensors]))


def _checked(
    structure: Structure, positions: Sequence[str], goal: Goal, costs: Mapping[str, float] | None
) -> dict[str, float]:
    """The cost of a sensor at each position."""
    if goal not in get_args(Goal):
        raise ModelError(f"{goal}: no goal of sensor placement; those are {', '.join(get_args(Goal))}")
    check_unknowns(structure, positions)
    for name in positions:
        if positions.count(name) > 1:
            raise ModelError(f"{name}: twice among the positions; once is enough")
    prices = dict.fromkeys(positions, 1.0)
    for name, cost in (costs or {}).items():
        if name not in prices:
            raise ModelError(f"costs: {name} is no position; those are {', '.join(positions) or 'none'}")
        if not 0 < cost < math.inf:
            raise ModelError(f"costs: {cost:g} for {name} is no cost; it must be positive and finite")
        prices[name] = float(cost)
    return prices


Counts = tuple[int, ...]
"""How many sensors there are at each position."""


class _Conflict(NamedTuple):
    """With no more than these sensors, `row` is not in a test without row `other` (None: in no test)."""

    row: int
    other: int | None
    most: Counts


class _Placement:
    """Works on one structure with all sensors; those that are not chosen are removed rows."""

    def __init__(
        self, structure: Structure, positions: Sequence[str], causality: Interpretation, goal: Goal, faulty: bool
    ) -> None:
        self._full = (2 if faulty else 1,) * len(positions)
        everywhere = [name for name, count in zip(positions, self._full, strict=True) for _ in range(count)]
        complete = add_sensors(structure, everywhere, faulty)
        self._parts = OverDeterminedPart(complete, causality)
        self._first = len(structure.equations)  # the row of the first sensor
        self._all_sensors = (1 << len(complete.equations)) - (1 << self._first)
        faults = mask_of([*{*complete.fault_rows.values()}])
        others = [None, *bits(faults)] if goal == "isolability" else [None]
        self._required = {other: self._part(self._full, other) & faults for other in others}
        self._conflicts: list[_Conflict] = []

    def minimal(self) -> list[Counts]:
        """The sets that meet all requirements and contain no other such set."""
        found: list[Counts] = []
        self._search((0,) * len(self._full), self._full, found)
        return [s for s in found if not any(other != s and _within(other, s) for other in found)]

    def _search(self, least: Counts, most: Counts, found: list[Counts]) -> None:
        """Adds to `found` sets between `least` and `most` that meet all requirements, all minimal ones among them."""
        if any(_within(counts, least) for counts in found):
            return
        conflict = self._conflict(least)
        if conflict is None:
            found.append(least)
            return
        for position, count in enumerate(conflict.most):
            if count < most[position]:
                self._search(_with(least, position, count + 1), most, found)
                most = _with(most, position, count)  # later branches do without: no set is found twice

    def _conflict(self, counts: Counts) -> _Conflict | None:
        """A requirement that these sensors do not meet, with a largest set of sensors that does not either."""
        there = ~(self._all_sensors & ~self._rows(counts))
        for conflict in self._conflicts:
            inside = there >> conflict.row & 1 and (conflict.other is None or there >> conflict.other & 1)
            if inside and _within(counts, conflict.most):
                return conflict
        for other, required in self._required.items():
            if other is None or there >> other & 1:
                missing = required & there & ~self._part(counts, other)
                if missing:
                    row = (missing & -missing).bit_length() - 1
                    self._conflicts.append(_Conflict(row, other, self._largest(counts, row, other)))
                    return self._conflicts[-1]
        return None

    def _largest(self, counts: Counts, row: int, other: int | None) -> Counts:
        for position, full in enumerate(self._full):
            for count in range(counts[position] + 1, full + 1):
                more = _with(counts, position, count)
                if self._part(more, other) >> row & 1:
                    break
                counts = more
        return counts

    def _part(self, counts: Counts, other: int | None) -> int:
        """The over-determined part with these sensors, without row `other`."""
        removed = self._all_sensors & ~self._rows(counts)
        return self._parts.without(removed if other is None else removed | 1 << other)

    def _rows(self, counts: Counts) -> int:
        """The rows of these sensors; of two at a position the first is chosen first."""
        rows, row = 0, self._first
        for count, full in zip(counts, self._full, strict=True):
            rows |= ((1 << count) - 1) << row
            row += full
        return rows


def _within(smaller: Counts, larger: Counts) -> bool:
    return all(a <= b for a, b in zip(smaller, larger, strict=True))


def _with(counts: Counts, position: int, count: int) -> Counts:
    return (*counts[:position], count, *counts[position + 1 :])

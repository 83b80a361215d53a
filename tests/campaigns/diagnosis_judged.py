"""What was told of a recording against what was in it: pure functions of the campaign's records."""

from dataclasses import dataclass
from typing import Any

Record = dict[str, Any]
Said = list[tuple[Any, ...]]
"""Diagnoses as (faults joined by +, or unknown; rank; p; equations that the unknown is near to; sizes).

Sizes are 95 % intervals as (low, high, unit); records of older code have none.
"""

LOOKS_S = (30.0, 60.0, 120.0, 300.0)
"""A diagnosis is looked at so long after the first one was told."""
LOOK_S = 120.0
"""The look that most of the page is about."""
EXCITED_S = 300.0
"""A small fault is to be found within so much exciting operation."""


@dataclass(frozen=True)
class Judged:
    """One recording.

    `false` are the diagnoses told before the onset, each by its components of rank 1, in `free_s` [s]. `delay_s` and
    `excited_s` (of exciting operation) run from the onset to the first event that explains something new. `standing`
    is what stood so long after that: empty where all had healed. `changes`: whether the fault changes anything that
    is measured (asked of fA_p only; True for all others). `sizes` are those of `faults`, in the fault's own unit.
    """

    vehicle: int
    kind: str
    label: str
    faults: tuple[str, ...]
    free_s: float
    false: list[list[str]]
    alarms: list[str]
    delay_s: float | None
    excited_s: float | None
    standing: dict[float, Said]
    cannot_tell: float
    changes: bool
    sizes: tuple[float, ...] = ()

    @property
    def detected(self) -> bool:
        """Whether anything new was told after the onset."""
        return self.delay_s is not None

    def first(self, look_s: float = LOOK_S) -> list[str]:
        """The diagnoses of rank 1 at a look."""
        return first(self.standing.get(look_s, []))

    def named(self, look_s: float = LOOK_S) -> set[str]:
        """The components in the diagnoses of rank 1 at a look."""
        return {name for said in self.first(look_s) for name in said.split("+")}

    def holds(self, look_s: float = LOOK_S) -> bool:
        """Whether the truth is a diagnosis of rank 1: the fault, or the pair of them."""
        return "+".join(sorted(self.faults)) in self.first(look_s)

    def located(self, equation: str, look_s: float = LOOK_S) -> bool:
        """Whether of rank 1, alone or among others, is that it is unknown and near to this equation of the model."""
        said = self.standing.get(look_s, [])
        return any(equation in near for name, rank, _, near, *_ in said if rank == 1 and name == "unknown")

    def wrong_alone(self, look_s: float = LOOK_S) -> bool:
        """Whether one diagnosis alone is of rank 1, names something, and names no true fault."""
        said = self.first(look_s)
        return len(said) == 1 and said != ["unknown"] and not set(said[0].split("+")) & set(self.faults)


def first(said: Said) -> list[str]:
    """Those of rank 1, the names of a pair in order."""
    return ["+".join(sorted(name.split("+"))) for name, rank, *_ in said if rank == 1]


def candidates(said: Said) -> list[tuple[str, int]]:
    """Names and ranks: what is new when it changes, as a probability creeps."""
    return [(name, rank) for name, rank, *_ in said]


def judged(vehicle: int, told: Record) -> Judged:
    """The judgement of a record of `diagnosis_shop.told_of`."""
    onset = told["onset_s"] if told["faults"] else told["seconds"]
    events = [(t, excited, how, [(*row,) for row in said]) for t, excited, how, said in told["events"]]
    before = [said for t, _, _, said in events if t < onset]
    stood = candidates(before[-1]) if before else []
    news = next(
        ((t, excited) for t, excited, _, said in events if t >= onset and said and candidates(said) != stood), None
    )
    standing = {}
    if news is not None and told["faults"]:
        for look in LOOKS_S:
            if news[0] + look <= told["seconds"]:
                standing[look] = [said for t, _, _, said in events if t <= news[0] + look][-1]
    return Judged(
        vehicle=vehicle,
        kind=told["kind"],
        label=told["label"],
        faults=tuple(told["faults"]),
        free_s=onset,
        false=[first(said) for t, _, how, said in events if how == "occurred" and t < onset],
        alarms=[test for _, test in told["alarms"]],
        delay_s=None if news is None else round(news[0] - onset, 1),
        excited_s=None if news is None else news[1],
        standing=standing,
        cannot_tell=told["cannot_tell"],
        changes=told.get("changes", True),
        sizes=tuple(told["faults"].values()),
    )


def all_of(records: list[Record]) -> list[Judged]:
    """Every recording of the vehicles' records."""
    return [judged(record["vehicle"], told) for record in records for told in record["judged"]]

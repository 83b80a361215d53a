"""What was wanted of the diagnosis beside what was measured: one row a figure."""

import statistics
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from diagnosis_judged import EXCITED_S, LOOK_S, Judged
from diagnosis_mates import Cell, in_words, narrow
from results_page import exact_rate, exact_share

APART = ("fA_p", "leak_ap")
"""fA_p may change nothing that is measured; a leak is no fault of the model."""
FAST = ("fA_ori", "fA_t", "fA_du")

HOSE = "e10"
"""The balance of the hose after the pump, in the four-state model: what a leak there adds to."""

SIZES = ("small", "large")

Row = tuple[str, str, str]
"""What, what was wanted, what was measured."""
Mates = Mapping[int, Mapping[Cell, frozenset[str]]]


@dataclass(frozen=True)
class Hours:
    """Fault-free driving: how long [h], what was told of it, alarms by test, on how many vehicles; tuning's claim."""

    hours: float
    vehicles: int
    false: list[list[str]]
    alarms: Mapping[str, int]
    claim: str


def singles(told: Sequence[Judged], label: str, *, only: Sequence[str] = ()) -> list[Judged]:
    """Single faults of a size: all but those apart, or `only` these."""
    chosen = [one for one in told if one.kind == "single" and one.label == label]
    return [one for one in chosen if (one.faults[0] in only if only else one.faults[0] not in APART)]


def share(told: Sequence[Judged], true: Callable[[Judged], bool]) -> str:
    """How many of them, with the exact interval."""
    return exact_share(sum(map(true, told)), len(told))


def detected(told: Sequence[Judged]) -> list[Judged]:
    """Those in which something was told after the onset, and looked at later."""
    return [one for one in told if LOOK_S in one.standing]


def early(one: Judged) -> bool:
    """Whether it was detected within the exciting operation that a small fault is given."""
    return one.excited_s is not None and one.excited_s <= EXCITED_S


def mean_size(told: Sequence[Judged]) -> str:
    """The mean number of diagnoses of rank 1, of those that stand; how many had healed besides."""
    sizes = [len(one.first()) for one in detected(told)]
    standing = [size for size in sizes if size]
    healed = len(sizes) - len(standing)
    return (f"{statistics.fmean(standing):.2f}" if standing else "-") + (f", {healed} healed" if healed else "")


def median(values: Sequence[float | None]) -> str:
    """Of those that are there."""
    there = [value for value in values if value is not None]
    return f"{statistics.median(there):.0f}" if there else "-"


def goals(told: Sequence[Judged], free: Hours, of_others: Mates) -> list[str]:
    """The table, as lines of Markdown."""
    rows = [
        *_of_free(free),
        *_of_large(singles(told, "large"), of_others),
        *_of_pump([one for label in SIZES for one in singles(told, label, only=["fA_p"])], of_others),
        *_of_small(singles(told, "small")),
        *_of_leaks([one for label in SIZES for one in singles(told, label, only=["leak_ap"])]),
        *_of_pairs([one for one in told if one.kind == "pair"]),
        *_of_all([one for one in told if one.kind in ("single", "pair")]),
    ]
    head = ["| | wanted | measured |", "|---|---|---|"]
    return [*head, *(f"| {what} | {wanted} | {measured} |" for what, wanted, measured in rows)]


def _of_free(free: Hours) -> Iterator[Row]:
    told, alarms = exact_rate(len(free.false), free.hours), exact_rate(sum(free.alarms.values()), free.hours)
    yield "fault-free: diagnoses told", "none in 500 h over 20 vehicles", f"{told}, {free.vehicles} vehicles"
    claim = f"{alarms}; the first vehicle's tuning: {free.claim}"
    yield "fault-free: alarms of single tests", "at the rate tuned", claim


def _of_large(large: Sequence[Judged], of_others: Mates) -> Iterator[Row]:
    seen = detected(large)
    yield "large: detected", "100 %", share(large, lambda one: one.detected)
    for fault in FAST:
        delay = median([one.excited_s for one in large if one.faults[0] == fault])
        yield f"large {fault}: median delay in exciting operation", "< 15 s", f"{delay} s"
    yield "large: true component in the diagnosis after 120 s", ">= 98 %", share(seen, Judged.holds)
    among = share(seen, lambda one: narrow(one, of_others))
    mates = in_words(of_others, "large", APART)
    yield "large: alone or only with practical mates", ">= 95 %", f"{among}; mates: {mates}"
    yield "large: alone", "-", share(seen, lambda one: one.first() == [*one.faults])
    yield "large: mean size", "<= 1.5", mean_size(large)


def _of_pump(pump: Sequence[Judged], of_others: Mates) -> Iterator[Row]:
    visible, hidden = ([one for one in pump if one.changes is changes] for changes in (True, False))
    seen, what = detected(visible), "fA_p that changes what is measured"
    yield f"{what}: detected", "100 %", share(visible, lambda one: one.detected)
    yield f"{what}: in the diagnosis after 120 s", ">= 98 %", share(seen, Judged.holds)
    among = share(seen, lambda one: narrow(one, of_others))
    yield f"{what}: alone or only with practical mates", ">= 95 %", among
    yield f"{what}: unknown", "-", share(seen, lambda one: one.first() == ["unknown"])
    yield "fA_p that changes nothing: quiet", "100 %", share(hidden, lambda one: not one.detected)


def _of_small(small: Sequence[Judged]) -> Iterator[Row]:
    yield "small: detected within 300 s of exciting operation", ">= 90 %", share(small, early)
    yield "small: true component in the diagnosis after 120 s", ">= 95 %", share(detected(small), Judged.holds)
    yield "small: mean size", "<= 2.5", mean_size(small)


def _of_leaks(leaks: Sequence[Judged]) -> Iterator[Row]:
    seen = detected(leaks)
    what = "leak: unknown, near the hose's balance"
    yield f"{what}, alone or among others", "100 %", share(seen, lambda one: one.located(HOSE))
    yield f"{what}, alone", "-", share(seen, lambda one: one.located(HOSE) and one.first() == ["unknown"])


def _of_pairs(pairs: Sequence[Judged]) -> Iterator[Row]:
    seen = detected(pairs)
    yield "pairs: one diagnosis alone, with no true fault", "-", share(seen, Judged.wrong_alone)
    yield "pairs: the true pair in the diagnosis", ">= 60 %", share(seen, Judged.holds)
    yield "pairs: judged as two", "-", share(seen, _as_two)


def _of_all(told: Sequence[Judged]) -> Iterator[Row]:
    seen = detected(told)
    wrong = "single faults, leak and pairs: one diagnosis alone, with no true fault"
    yield wrong, "<= 2 %", share(seen, Judged.wrong_alone)


def _as_two(one: Judged) -> bool:
    return bool(one.first()) and all("+" in said for said in one.first())

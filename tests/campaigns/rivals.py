"""Rivals on the campaign's recordings, at faultline's rate of false alarms: `make campaign-rivals`, after the campaign.

Vehicles are dealt into folds. A method is made from the vehicles outside a fold; its limit is the smallest with at most
as many false alarms as faultline's rate in the whole campaign allows, rounded up, on vehicles outside the fold that it
was not made from either; then it is tried on the fold's vehicles. What learns from many vehicles is limited half by
half, each by what the other half makes; what is made from one vehicle is limited on all the others outside the fold.
Neither knows the vehicle that it is tried on, while faultline's thresholds come from the vehicle's own fault-free
drives, as its workshop has them. Beside these stands the thesis' method with nu and J from the vehicle's own drives.
"""

import argparse
import math
import os
import statistics
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from diagnosis import RESULTS, folder_of, kept, kept_in
from diagnosis_cases import Set
from diagnosis_goals import APART, detected
from diagnosis_judged import Judged
from diagnosis_page import latest, write_page
from results_page import exact_rate, exact_share
from rival_methods import Components, Forest, Rival, ThesisCusum, Variance
from rival_series import Array, Series, false_alarms, first_alarm, limit_for, load

from faultline.service.bundle.load import load_bundle

FOLDS = 5
LEAST = 3  # vehicles: one to try, two to make a method and its limit from

TRIED = ("free", "single")
"""Kinds of recordings that the comparison is about; forests learn from the curve over size besides."""

Make = Callable[[], Rival]
Wanted = Callable[[Judged], bool]
Way = Literal["others", "one", "own"]
"""A method is made from the vehicles outside a fold, from the first of them, or from the vehicle it is tried on."""
Scored = tuple[Rival, Series, Array]
OWN_DRIVES = 2
"""Fault-free drives that an own vehicle's method is made from, as many as tuning has; it is not tried on them."""

INTRODUCTION = """## Rivals

On the same recordings and residuals; limits of rivals raised until they had, on vehicles that they were not made from,
as many false alarms an hour as faultline had in the campaign (the number rounded up: at least its rate); then tried on
further ones, where they have the rates of the table. *Thesis*: CUSUM of |r| with nu (90 % quantile) and J from one
other vehicle, or from two fault-free drives of the vehicle itself, which are then not judged (*own vehicle*; faultline
has two drives of each vehicle as well and, where it adapts a tuning, fault-free drives of reference vehicles); names by
minimal hitting sets, or by exact columns of the signature matrix.
*Forest*: mean and spread of residuals by mode over 60 s, trained with other vehicles' faults, of which faultline has
seen none. *PCA*: T2 and Q of the raw signals. Forest, PCA and the transferred thesis do not know the vehicle. Single
faults without fA_p and the leak. *Mean size*: where something stands after 120 s; what had healed is counted apart.
"""

PUMP_FILTER = """## The test of the variance

On clogged pump filters that change what is measured: the p_tp residuals get quieter (thesis ch. 7.4), which faultline's
`tune --spread` tests. From two fault-free drives of the vehicle itself, at the same rate of false alarms as above. What
it adds is a suspicion: it names nothing.
"""


@dataclass
class Outcome:
    """What a method did on vehicles that it was not made from; by size in words."""

    false: int = 0
    hours: float = 0.0
    tried: dict[str, int] = field(default_factory=lambda: {"small": 0, "large": 0})
    delays: dict[str, list[float]] = field(default_factory=lambda: {"small": [], "large": []})
    sizes: dict[str, list[int]] = field(default_factory=lambda: {"small": [], "large": []})
    held: dict[str, int] = field(default_factory=lambda: {"small": 0, "large": 0})
    wrong: dict[str, int] = field(default_factory=lambda: {"small": 0, "large": 0})
    healed: dict[str, int] = field(default_factory=lambda: {"small": 0, "large": 0})

    def name(self, fault: str, label: str, said: Sequence[str]) -> None:
        """Counts what was named where `fault` was; nothing is named where all has healed, which has no size."""
        if not said:
            self.healed[label] += 1
            return
        self.sizes[label].append(len(said))
        self.held[label] += fault in said
        self.wrong[label] += len(said) == 1 and said[0] not in (fault, "unknown")


def known_single(one: Judged) -> bool:
    """Whether it is a small or large single fault that the model knows and that changes what is measured."""
    return one.kind == "single" and one.faults[0] not in APART


def pump_filter(one: Judged) -> bool:
    """Whether it is a clogged pump filter that changes what is measured."""
    return one.kind == "single" and one.faults == ("fA_p",) and one.changes


def faultline(told: Sequence[Judged], wanted: Wanted = known_single) -> Outcome:
    """Its own outcome, from what it told."""
    given = [one for one in told if one.kind in TRIED]
    outcome = Outcome(sum(len(one.false) for one in given), sum(one.free_s for one in given) / 3600)
    for one in filter(wanted, told):
        outcome.tried[one.label] += 1
        if one.delay_s is not None:
            outcome.delays[one.label].append(one.delay_s)
    for one in detected([*filter(wanted, told)]):
        outcome.name(one.faults[0], one.label, one.first())
    return outcome


def folds(numbers: Sequence[int], curved: Collection[int] = ()) -> list[set[int]]:
    """The vehicles dealt out.

    Raises:
        ValueError: there are too few to make, to limit and to try a method on different ones.
    """
    if len(numbers) < LEAST:
        raise ValueError(f"{len(numbers)} vehicles are too few for rivals; run the campaign on {LEAST} at least")
    return dealt(numbers, min(FOLDS, len(numbers)), curved)


def dealt(numbers: Sequence[int], count: int, curved: Collection[int] = ()) -> list[set[int]]:
    """The vehicles dealt into so many: those with a curve over size first, so that they are spread."""
    order = sorted(numbers, key=lambda number: (number not in curved, number))
    return [set(order[k::count]) for k in range(count)]


def tried(
    make: Make, series: Sequence[Series], an_hour: float, way: Way = "others", wanted: Wanted = known_single
) -> Outcome:
    """A method on all vehicles, each with what `way` makes it from; `an_hour` is the rate of false alarms allowed.

    Detection is counted over the recordings that are `wanted`.
    """
    outcome = Outcome()
    for fold in folds(sorted({s.vehicle for s in series}), _curved(series)):
        outside = [s for s in series if s.vehicle not in fold]
        limit = _limit(make, outside, an_hour, way)
        inside = [s for s in series if s.vehicle in fold and s.judged.kind in TRIED]
        for method, s, score in _scored(make, outside, inside, way):
            _try(method, limit, s, score, outcome, wanted)
    return outcome


def _curved(series: Sequence[Series]) -> set[int]:
    return {s.vehicle for s in series if s.judged.kind == "curve"}


def _scored(make: Make, made_from: Sequence[Series], on: Sequence[Series], way: Way) -> list[Scored]:
    """Scores of recordings by methods made from others, or from drives of the same vehicle that are not scored."""
    if way != "own":
        method = make()
        method.fit(made_from)
        return [(method, s, method.score(s)) for s in on]
    scored = []
    for number in sorted({s.vehicle for s in on}):
        mine = [s for s in on if s.vehicle == number]
        free = [k for k, s in enumerate(mine) if s.judged.kind == "free"][:OWN_DRIVES]
        if not free:
            raise ValueError(f"truck-{number} has no fault-free drive to make a method from; run the campaign again")
        method = make()
        method.fit([mine[k] for k in free])
        scored += [(method, s, method.score(s)) for k, s in enumerate(mine) if k not in free]
    return scored


def _limit(make: Make, outside: Sequence[Series], an_hour: float, way: Way) -> float:
    """The limit that leaves at least faultline's rate: the number allowed is rounded up."""
    numbers, scored = sorted({s.vehicle for s in outside}), []
    if way == "own":
        scored = _scored(make, outside, outside, way)
    elif way == "one":  # the very nu and J that are tried; who they are from is no witness
        scored = _scored(make, outside, [s for s in outside if s.vehicle != numbers[0]], way)
    else:
        for half in dealt(numbers, 2, _curved(outside)):
            rest = [s for s in outside if s.vehicle not in half]
            scored += _scored(make, rest, [s for s in outside if s.vehicle in half], way)
    hours = sum(s.onset_s for _, s, _ in scored) / 3600
    return limit_for([(score, s) for _, s, score in scored], allowed(an_hour, hours))


def allowed(an_hour: float, hours: float) -> int:
    """False alarms in so many hours, rounded up, so that a rival is never held to a stricter rate than faultline."""
    return math.ceil(an_hour * hours - 1e-9)


def _try(method: Rival, limit: float, s: Series, score: Array, outcome: Outcome, wanted: Wanted) -> None:
    outcome.false += false_alarms([(score, s)], limit)
    outcome.hours += s.onset_s / 3600
    if not wanted(s.judged):
        return
    label, [fault] = s.judged.label, s.judged.faults
    outcome.tried[label] += 1
    t = first_alarm(score, limit, s)
    if t is not None:
        outcome.delays[label].append(t - s.onset_s)
        said = method.names(s, t, limit)
        if said is not None:
            outcome.name(fault, label, said)


def table(outcomes: dict[str, Outcome]) -> list[str]:
    """As lines of Markdown."""
    lines = [
        "| method | false alarms where tried | size | detected | median delay [s] | true fault named | mean size "
        "| wrong alone |",
        "|---" * 8 + "|",
    ]
    for name, outcome in outcomes.items():
        for label in ("small", "large"):
            delays, sizes, count = outcome.delays[label], outcome.sizes[label], outcome.tried[label]
            healed = outcome.healed[label]
            delay = f"{statistics.median(delays):.0f}" if delays else "-"
            named = exact_share(outcome.held[label], len(sizes) + healed) if sizes or healed else "-"
            mean = (f"{statistics.fmean(sizes):.2f}" if sizes else "-") + (f", {healed} healed" if healed else "")
            rate = exact_rate(outcome.false, outcome.hours) if label == "small" else ""
            seen = exact_share(len(delays), count)
            lines.append(
                f"| {name if label == 'small' else ''} | {rate} | {label} | {seen} | {delay} "
                f"| {named} | {mean} | {outcome.wrong[label] if sizes else '-'} |"
            )
    return lines


def better(outcomes: dict[str, Outcome]) -> list[str]:
    """Where a rival beats faultline, in sentences, of the same recordings: one not detected is not named either."""
    own, said = outcomes["faultline"], []
    for name, rival in outcomes.items():
        where = [] if rival is own else [what for label in ("small", "large") for what in _better(rival, own, label)]
        if where:
            rates = [f"{outcome.false / outcome.hours:.2g}" for outcome in (rival, own) if outcome.hours]
            at = f" (at {rates[0]} against {rates[1]} false alarms an hour)" if len(set(rates)) == 2 else ""
            said.append(f"{name}{at} {', '.join(where)}")
    return said


def _better(rival: Outcome, own: Outcome, label: str) -> list[str]:
    said, delays, sizes = [], (rival.delays[label], own.delays[label]), (rival.sizes[label], own.sizes[label])
    if not own.tried[label]:
        return []
    if len(delays[0]) > len(delays[1]):
        said.append(f"detects more of the {label} faults")
    sooner = all(delays) and statistics.median(delays[0]) < statistics.median(delays[1])
    if sooner and len(delays[0]) >= len(delays[1]):
        said.append(f"detects {label} faults sooner")
    if rival.held[label] > own.held[label]:
        said.append(f"names the true one of more of the {label} faults")
    narrower = all(sizes) and statistics.fmean(sizes[0]) < statistics.fmean(sizes[1])
    if narrower and rival.held[label] >= own.held[label]:
        said.append(f"is narrower on {label} faults ({statistics.fmean(sizes[0]):.1f} names)")
    return said


def page(outcomes: dict[str, Outcome]) -> str:
    """The part of the page."""
    where = better(outcomes)
    verdict = "Where faultline is not better: " + ("; ".join(where) + "." if where else "nowhere in this table.")
    return "\n".join([INTRODUCTION, *table(outcomes), "", verdict, ""])


def main(arguments: Sequence[str] | None = None) -> None:
    """Tries all rivals and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--effects", choices=get_args(Set), default=os.environ.get("EFFECTS", "A"))
    parser.add_argument("--results", type=Path, default=RESULTS)
    options = parser.parse_args(arguments)
    path = kept_in(options.effects, options.results)
    records = latest(kept(path))
    if not records:
        raise SystemExit(f"{path}: no records; run make campaign-diagnosis first")
    root = folder_of(options.effects, records[-1]["code"], records[-1]["tuning"])
    series = load(records, root)
    manifest = load_bundle(root / f"truck-{records[0]['vehicle']}" / "bundle").manifest
    matrix = [frozenset(generator.faults) for generator in manifest.generators]
    own = faultline([s.judged for s in series])
    methods: dict[str, tuple[Make, Way]] = {
        "thesis, hitting sets": (lambda: ThesisCusum(matrix, exact=False), "one"),
        "thesis, exact column": (lambda: ThesisCusum(matrix, exact=True), "one"),
        "thesis, own vehicle, hitting sets": (lambda: ThesisCusum(matrix, exact=False), "own"),
        "thesis, own vehicle, exact column": (lambda: ThesisCusum(matrix, exact=True), "own"),
        "random forest": (Forest, "others"),
        "PCA (detects only)": (Components, "others"),
    }
    outcomes = {"faultline": own}
    for name, (make, way) in methods.items():
        outcomes[name] = tried(make, series, own.false / own.hours, way)
        print(name, outcomes[name], flush=True)
    pump = {
        "faultline": faultline([s.judged for s in series], pump_filter),
        "test of the variance": tried(Variance, series, own.false / own.hours, "own", pump_filter),
    }
    of = f"\n{len(records)} vehicles, records of code {records[-1]['code']}.\n"
    text = "\n".join([page(outcomes), PUMP_FILTER, *table(pump)])
    (options.results / f"diagnosis-rivals-{options.effects}.md").write_text(f"{text}\n{of}")
    write_page(options.results)


if __name__ == "__main__":
    main()

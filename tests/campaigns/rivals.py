"""Rivals on the campaign's recordings, at faultline's rate of false alarms: `make campaign-rivals`, after the campaign.

Vehicles are dealt into folds. A method is made from the vehicles outside a fold; its limit is the smallest with as many
false alarms an hour as faultline had in the whole campaign, on vehicles outside the fold that it was not made from
either (each half by what the other half makes); then it is tried on the fold's vehicles. None of it knows the vehicle.
Faultline's thresholds come from the vehicle's own two fault-free drives, as its workshop has them: that is its method.
"""

import argparse
import os
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import get_args

from diagnosis import RESULTS, folder_of, kept, kept_in
from diagnosis_cases import Set
from diagnosis_goals import APART, detected
from diagnosis_judged import Judged
from diagnosis_page import latest, write_page
from results_page import exact_rate, exact_share
from rival_methods import Components, Forest, Rival, ThesisCusum
from rival_series import Series, false_alarms, first_alarm, limit_for, load

from service.bundle import load_bundle

FOLDS = 5
LEAST = 3  # vehicles: one to try, two to make a method and its limit from

TRIED = ("free", "single")
"""Kinds of recordings that the comparison is about; forests learn from the curve over size besides."""

Make = Callable[[], Rival]

INTRODUCTION = """## Rivals

On the same recordings and residuals; limits of rivals raised until they had, on vehicles that they were not made from,
as many false alarms an hour as faultline had in the campaign; then tried on further ones. *Thesis*: CUSUM of |r| with
nu (90 % quantile) and J from one vehicle, names by minimal hitting sets, or by exact columns of the signature matrix.
*Forest*: mean and spread of residuals by mode over 60 s, trained with other vehicles' faults, of which faultline has
seen none. *PCA*: T2 and Q of the raw signals. Single faults without fA_p and the leak. Faultline's own false alarms are
those at its thresholds, which it tunes on each vehicle.
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

    def name(self, fault: str, label: str, said: Sequence[str]) -> None:
        """Counts what was named where `fault` was."""
        self.sizes[label].append(len(said))
        self.held[label] += fault in said
        self.wrong[label] += len(said) == 1 and said[0] not in (fault, "unknown")


def judged_singles(told: Sequence[Judged]) -> list[Judged]:
    """Small and large single faults that the model knows and that change what is measured."""
    return [one for one in told if one.kind == "single" and one.faults[0] not in APART]


def faultline(told: Sequence[Judged]) -> Outcome:
    """Its own outcome, from what it told."""
    given = [one for one in told if one.kind in TRIED]
    outcome = Outcome(sum(len(one.false) for one in given), sum(one.free_s for one in given) / 3600)
    for one in judged_singles(told):
        outcome.tried[one.label] += 1
        if one.delay_s is not None:
            outcome.delays[one.label].append(one.delay_s)
    for one in detected(judged_singles(told)):
        outcome.name(one.faults[0], one.label, one.first())
    return outcome


def folds(numbers: Sequence[int]) -> list[set[int]]:
    """The vehicles dealt out.

    Raises:
        ValueError: there are too few to make, to limit and to try a method on different ones.
    """
    if len(numbers) < LEAST:
        raise ValueError(f"{len(numbers)} vehicles are too few for rivals; run the campaign on {LEAST} at least")
    count = min(FOLDS, len(numbers))
    return [set(numbers[k::count]) for k in range(count)]


def tried(make: Make, series: Sequence[Series], an_hour: float) -> Outcome:
    """A method on all vehicles, each with what the others make of it; `an_hour` is the rate of false alarms allowed."""
    outcome = Outcome()
    for fold in folds(sorted({s.vehicle for s in series})):
        outside = [s for s in series if s.vehicle not in fold]
        limit = _limit(make, outside, an_hour)
        method = make()
        method.fit(outside)
        for s in (s for s in series if s.vehicle in fold and s.judged.kind in TRIED):
            _try(method, limit, s, outcome)
    return outcome


def _limit(make: Make, outside: Sequence[Series], an_hour: float) -> float:
    numbers = sorted({s.vehicle for s in outside})
    scores = []
    for half in (set(numbers[::2]), set(numbers[1::2])):
        method = make()
        method.fit([s for s in outside if s.vehicle not in half])
        scores += [(method.score(s), s) for s in outside if s.vehicle in half]
    return limit_for(scores, int(an_hour * sum(s.onset_s for s in outside) / 3600))


def _try(method: Rival, limit: float, s: Series, outcome: Outcome) -> None:
    score = method.score(s)
    outcome.false += false_alarms([(score, s)], limit)
    outcome.hours += s.onset_s / 3600
    if not judged_singles([s.judged]):
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
        "| method | false alarms on other vehicles | size | detected | median delay [s] | true fault named | mean size "
        "| wrong alone |",
        "|---" * 8 + "|",
    ]
    for name, outcome in outcomes.items():
        for label in ("small", "large"):
            delays, sizes, count = outcome.delays[label], outcome.sizes[label], outcome.tried[label]
            delay = f"{statistics.median(delays):.0f}" if delays else "-"
            named = exact_share(outcome.held[label], len(sizes)) if sizes else "-"
            mean = f"{statistics.fmean(sizes):.2f}" if sizes else "-"
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
        for label in ("small", "large"):
            if name == "faultline" or not own.tried[label]:
                continue
            if len(rival.delays[label]) > len(own.delays[label]):
                said.append(f"{name} detects more of the {label} faults")
            if rival.delays[label] and own.delays[label]:
                faster = statistics.median(rival.delays[label]) < statistics.median(own.delays[label])
                if faster and len(rival.delays[label]) >= len(own.delays[label]):
                    said.append(f"{name} detects {label} faults sooner")
            if rival.held[label] > own.held[label]:
                said.append(f"{name} names the true one of more of the {label} faults")
            if rival.sizes[label] and own.sizes[label] and rival.held[label] >= own.held[label]:
                sizes = [statistics.fmean(outcome.sizes[label]) for outcome in (rival, own)]
                if sizes[0] < sizes[1]:
                    said.append(f"{name} is narrower on {label} faults ({sizes[0]:.1f} names)")
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
    records = kept(kept_in(options.effects, options.results))
    records = latest(records)
    root = folder_of(options.effects, records[-1]["code"], records[-1]["tuning"])
    series = load(records, root)
    manifest = load_bundle(root / f"truck-{records[0]['vehicle']}" / "bundle").manifest
    matrix = [frozenset(generator.faults) for generator in manifest.generators]
    own = faultline([s.judged for s in series])
    methods: dict[str, Make] = {
        "thesis, hitting sets": lambda: ThesisCusum(matrix, exact=False),
        "thesis, exact column": lambda: ThesisCusum(matrix, exact=True),
        "random forest": Forest,
        "PCA (detects only)": Components,
    }
    outcomes = {"faultline": own}
    for name, make in methods.items():
        outcomes[name] = tried(make, series, own.false / own.hours)
        print(name, outcomes[name], flush=True)
    (options.results / f"diagnosis-rivals-{options.effects}.md").write_text(page(outcomes))
    write_page(options.results)


if __name__ == "__main__":
    main()

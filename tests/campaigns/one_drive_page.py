"""The page of `one_drive.py`: small faults and false reports by what a vehicle was tuned with."""

from collections.abc import Sequence
from statistics import median
from typing import Any

from diagnosis_judged import EXCITED_S, LOOK_S, Judged, judged
from hybrid_page import in_set
from results_page import exact_rate, exact_share, provenance

Record = dict[str, Any]

METHODS = {"five": "five own drives", "one": "one drive", "fleet": "one drive and the fleet"}

HEAD = """# A vehicle tuned with one drive

All data are **simulated** by the rig. Made by `make campaign-one-drive`; vehicles, sizes and what counts are declared
in `tests/campaigns/one_drive.py`. The fleet and the vehicles that are tuned are different trucks. *Detected*: something
new is reported within 300 s of exciting operation. *In the set*: two minutes after the first diagnosis the true
component is of rank 1, alone or in a pair. Cases in which a clogged pump filter changes nothing that is measured are
left out. Intervals of 95 % are exact.
"""


def page(records: Sequence[Record]) -> str:
    """The tables, of all vehicles that are there."""
    of: dict[str, list[Judged]] = {method: [] for method in METHODS}
    suspicions = dict.fromkeys(METHODS, 0)
    for record in records:
        for told in record["judged"]:
            if told["changes"]:
                onset = told["onset_s"] or told["seconds"]
                of[told["method"]].append(judged(record["vehicle"], told))
                suspicions[told["method"]] += sum(how == "suspected" and t < onset for t, _, how, _ in told["events"])
    commit = ", ".join(sorted({record["commit"] for record in records}))
    lines = [HEAD, provenance(commit, sum(record["wall_s"] for record in records)), ""]
    fleet = records[0]["fleet"] if records else {"vehicles": 0, "drives": 0, "hours": 0.0}
    others = f"{fleet['vehicles']} others, {fleet['drives']} drives, {fleet['hours']:.1f} h"
    lines += [f"{len(records)} vehicles; the fleet: {others}.", ""]
    lines += [f"| | {' | '.join(METHODS.values())} |", "|---" * (1 + len(METHODS)) + "|"]
    small = {method: [each for each in of[method] if each.faults] for method in METHODS}

    def row(what: str, cells: Sequence[str]) -> None:
        lines.append(f"| {what} | {' | '.join(cells)} |")

    refused = [sum(method in record["refused"] for record in records) for method in METHODS]
    row("vehicles refused by the tuning", [str(each) for each in refused])
    row("small faults detected", [_share(small[m], _detected) for m in METHODS])
    row("in the set, of all", [_share(small[m], lambda one: one.detected and in_set(one)) for m in METHODS])
    row("in the set, of those detected", [_share(_found(small[m]), in_set) for m in METHODS])
    row("names of rank 1, mean", [_names(small[m]) for m in METHODS])
    row("median of exciting operation until detected", [_delay(small[m]) for m in METHODS])
    hours = {method: sum(each.free_s for each in of[method]) / 3600.0 for method in METHODS}
    false = {method: sum(len(each.false) for each in of[method]) for method in METHODS}
    row("false diagnoses", [exact_rate(false[m], hours[m]) for m in METHODS])
    row("false suspicions", [exact_rate(suspicions[m], hours[m]) for m in METHODS])
    costs = [[record["costs"][m] for record in records if m in record["costs"]] for m in METHODS]
    row("tuning and export, CPU time, median", [f"{median(each):.0f} s" if each else "-" for each in costs])
    lines += ["", "## Every fault", "", "Detected, in the set.", ""]
    lines += [f"| | {' | '.join(METHODS.values())} |", "|---" * (1 + len(METHODS)) + "|"]
    for fault in dict.fromkeys(each.faults[0] for each in small["five"]):
        chosen = [[each for each in small[m] if each.faults == (fault,)] for m in METHODS]
        row(fault, [f"{sum(map(_detected, c))}, {sum(map(in_set, _found(c)))} of {len(c)}" for c in chosen])
    return "\n".join(lines) + "\n"


def _found(of: Sequence[Judged]) -> list[Judged]:
    return [each for each in of if each.standing.get(LOOK_S)]


def _detected(one: Judged) -> bool:
    return one.excited_s is not None and one.excited_s <= EXCITED_S


def _share(of: Sequence[Judged], is_so: Any) -> str:
    return exact_share(sum(map(is_so, of)), len(of)) if of else "-"


def _names(of: Sequence[Judged]) -> str:
    sizes = [len(each.named()) for each in _found(of)]
    return f"{sum(sizes) / len(sizes):.2f}" if sizes else "-"


def _delay(of: Sequence[Judged]) -> str:
    delays = [each.excited_s for each in of if each.excited_s is not None]
    return f"{median(delays):.0f} s" if delays else "-"

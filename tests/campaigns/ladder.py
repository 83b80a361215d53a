"""Faults from small to total failure on vehicles that nothing was chosen on: `make campaign-ladder`.

    .venv/bin/python tests/campaigns/ladder.py --vehicles 521 522

Eight trucks of the rig's fleet (profile `everyday`, hidden effects of set A or B), calibrated and tuned as their
workshop would (`diagnosis_shop`). Of each component five sizes, abrupt, within a drive; one from the start of a drive,
and one that grows to a total failure. A line of the results is a vehicle; what is there of the same code is not made
again.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from by_vehicle import Campaign, run
from diagnosis_cases import Case, Set, hidden, seed_of
from diagnosis_judged import Judged, all_of
from diagnosis_shop import Workshop, run_of, told_of, watched
from diagnosis_visible import changes
from results_page import exact_share, provenance

from faultline.service.core.errors import InputError
from faultline.testbench.bus import load_dbc
from faultline.testbench.faults import Course, Fault
from faultline.testbench.request import Request
from faultline.testbench.traffic import frames

Record = dict[str, Any]

VEHICLES = tuple(range(521, 529))
"""Sets A and B in turn: hidden effects that the decision's development had, on vehicles that nothing was chosen on."""
SECONDS = 480.0
FROM_START_S = 2.0
SIZES: dict[str, tuple[float, ...]] = {
    "fA_t": (0.4, 0.6, 0.75, 0.88, 0.97),
    "fA_p": (0.8, 0.85, 0.9, 0.94, 0.97),
    "fA_du": (0.35, 0.55, 0.75, 0.88, 0.97),
    "fA_ori": (0.05, 0.2, 0.5, 0.8, 0.97),
    "fA_dos": (0.05, 0.2, 0.5, 0.8, 0.97),
    "fq_pump": (0.03, 0.15, 0.4, 0.7, 0.95),
    "fy_p_tp": (5e3, 2e4, 4e4, 6.5e4, 9e4),
    "fy_p_ap": (1e4, 4e4, 1e5, 2e5, 4e5),
    "fy_p_du": (1e4, 4e4, 1e5, 2e5, 4e5),
    "leak_ap": (0.1, 0.3, 0.8, 1.8, 4.0),
}
"""From some twice the large size of `testbench/sizes.toml` to a total failure, in the units given there."""
LEAKS_AT = "e10"
"""The equation near which a leak is to be found: no component of the model leaks."""
COLUMNS = (*"12345", "from the start", "growing")
HEAD = """# From a small fault to a total failure

All data are **simulated** by the rig. Made by `make campaign-ladder`; vehicles, sizes and what counts are declared in
`tests/campaigns/ladder.py`, frozen before it was run. *Excluded*: two minutes after the first diagnosis the true
component is among no explanation, whatever its rank, neither alone nor as one of two. *Rank 1*: alone, or one of
several. A leak, which is no component's, is right where the fault is unknown near its equation. Cases in which a
clogged pump filter changes nothing that is measured are left out. Intervals of 95 % are exact (Clopper and Pearson).

The decision was developed after a first look, at vehicles 501 to 508 (commit ba26e09c, code that changed in between):
3.9 % of 558 excluded, 94.6 % of rank 1, 9 diagnoses in 21.1 fault-free hours.
"""
RESULTS = Path("docs/results/ladder.jsonl")
WORK = Path("out/campaign-ladder")
FROZEN = ("analysis", "service", "testbench", "dbc", "tests/campaigns/ladder.py", "tests/campaigns/diagnosis_shop.py")


@dataclass(frozen=True)
class Rung(Case):
    """One size of one fault; `start_s` [s] where it is not the seed that says the onset."""

    course: Course = "abrupt"
    start_s: float | None = None

    @property
    def onset_s(self) -> float:
        """From when on the fault is there [s]."""
        return super().onset_s if self.start_s is None else self.start_s

    @property
    def request(self) -> Request:
        """What is asked of the rig."""
        faults = tuple(Fault(name, size, self.onset_s, self.course) for name, size in self.faults)
        return replace(self.healthy, faults=faults)


def rungs(number: int, effects_set: Set) -> Iterator[Rung]:
    """All recordings of a vehicle. Sensors read too much or too little, by the seed."""
    rng = np.random.default_rng([number, 17])
    for row, (fault, sizes) in enumerate(SIZES.items()):
        signs = rng.choice([-1.0, 1.0], 7) if fault.startswith("fy") else np.ones(7)
        some = int(rng.integers(len(sizes)))
        for column, sign in enumerate(signs.tolist()):
            size = sign * sizes[(*range(5), some, 4)[column]]
            label = (*map(str, range(1, 6)), f"{some + 1} from the start", "5 growing")[column]
            course: Course = "growing" if column == 6 else "abrupt"
            seed = seed_of(number, 500 + 10 * row + column)
            start = FROM_START_S if column == 5 else None
            yield Rung(number, effects_set, "single", label, ((fault, size),), seed, SECONDS, course, start)


def vehicle(shop: Workshop) -> Record:
    """All recordings of one vehicle; none where the workshop's tuning refuses it."""
    start, busy = time.monotonic(), time.process_time()
    told: list[Record] = []
    refused = None
    try:
        bundle = shop.bundle()
        for rung in rungs(shop.number, shop.effects_set):
            run = run_of(rung.request)
            drive = frames(rung.request, load_dbc(), [run])
            seen = told_of(rung, watched(bundle, rung.request.name, drive), bundle.manifest.period_s)
            if "fA_p" in dict(rung.faults):
                seen["changes"] = changes(rung.request, run, run_of(rung.healthy))
            told.append(seen)
    except InputError as error:
        refused = str(error)
    spent = {"wall_s": round(time.monotonic() - start, 1), "cpu_s": round(time.process_time() - busy, 1)}
    effects = hidden(shop.number, shop.effects_set)
    return {"vehicle": shop.number, "effects": effects, "refused": refused, "judged": told, **spent}


def truth_in(one: Judged, names: Sequence[str], near: bool) -> bool:
    """Whether the true component is among these explanations, alone or as one of two; a leak is `near` its place."""
    if one.faults == ("leak_ap",):
        return near
    return any(one.faults[0] in name.split("+") for name in names)


def page(records: Sequence[Record]) -> str:
    """The tables, of all vehicles that are there."""
    cases = [one for one in all_of(list(records)) if one.changes]
    refused = ", ".join(str(r["vehicle"]) for r in records if r["refused"]) or "none"
    commit = ", ".join(sorted({record["commit"] for record in records}))
    counted = f"{len(records)} vehicles, {len(cases)} cases. Refused by the workshop's tuning: {refused}."
    lines = [HEAD, provenance(commit, sum(record["wall_s"] for record in records)), "", counted, ""]
    found = [one for one in cases if one.detected]
    looked = [one for one in found if one.standing.get(120.0)]
    inside = [one for one in looked if _in(one)]
    first = [one for one in looked if _first(one)]
    total = [one for one in looked if one.label[0] in "45" and "grow" not in one.label]
    few = [one for one in total if len(one.first()) <= 3]
    lines += [
        "| | wanted | measured |",
        "|---|---|---|",
        f"| detected | where the operation excites it | {exact_share(len(found), len(cases))} |",
        f"| excluded two minutes later | <= 1 % | {exact_share(len(looked) - len(inside), len(looked))} |",
        f"| of rank 1 then | >= 98 % | {exact_share(len(first), len(looked))} |",
        f"| at most 3 names, rungs 4 and 5 | 100 % | {exact_share(len(few), len(total))} |",
        f"| the 95 % interval of the size holds it, abrupt | 90 to 98 % | {_held(looked)} |",
        f"| the same, growing | 90 to 98 % | {_held(looked, growing=True)} |",
        f"| fault-free time before the onset: diagnoses | none | {sum(len(one.false) for one in cases)} in "
        f"{sum(one.free_s for one in cases) / 3600:.1f} h |",
        "",
        "By commit, as code changed from vehicle to vehicle; figures above are of all together.",
        "",
        "| commit | vehicles | excluded | of rank 1 |",
        "|---|---|---|---|",
        *_by_commit(records),
        "",
        "## Every fault",
        "",
        "Detected, in, rank 1; median delay [s] and mean number of names of rank 1.",
        "",
        f"| fault | {' | '.join(COLUMNS)} |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for fault in SIZES:
        here = [one for one in cases if one.faults == (fault,)]
        columns = [_cell([one for one in here if _column(one.label) == column]) for column in COLUMNS]
        lines.append(f"| {fault} | {' | '.join(columns)} |")
    lines += ["", "## Excluded, or not detected", ""]
    for one in cases:
        if not one.detected or (one in looked and not _in(one)):
            said = "; ".join(one.first()) if one.detected else "not detected"
            lines.append(f"- truck-{one.vehicle} {one.faults[0]} {one.sizes[0]:g} ({one.label}): {said}")
    return "\n".join(lines) + "\n"


def _column(label: str) -> str:
    return label if len(label) == 1 else label[2:]


def _in(one: Judged) -> bool:
    said = one.standing[120.0]
    return truth_in(one, [name for name, *_ in said], one.located(LEAKS_AT))


def _first(one: Judged) -> bool:
    if one.faults == ("leak_ap",):
        return one.located(LEAKS_AT)
    return one.faults[0] in one.first()


def _by_commit(records: Sequence[Record]) -> list[str]:
    """The two figures of the vehicles of each commit."""
    rows = []
    for commit in dict.fromkeys(record["commit"] for record in records):
        own = [record for record in records if record["commit"] == commit]
        cases = [one for one in all_of(own) if one.changes and one.detected and one.standing.get(120.0)]
        out, first = sum(not _in(one) for one in cases), sum(map(_first, cases))
        vehicles = ", ".join(str(record["vehicle"]) for record in own)
        shares = f"{exact_share(out, len(cases))} | {exact_share(first, len(cases))}"
        rows.append(f"| {commit} | {vehicles} | {shares} |")
    return rows


DISPLAYED = {"%": -100.0, "bar": 1e-5}
"""What one of a fault's size is in the unit in which intervals are displayed; a flow is another form of a worn pump."""


def interval(one: Judged) -> tuple[float, float, float] | None:
    """The interval of the true component's size, where that is named alone, and the true size in its unit."""
    for name, _, _, _, *sizes in one.standing[120.0]:
        for low, high, unit in sizes[0] if sizes and name == one.faults[0] else []:
            if unit in DISPLAYED:
                return low, high, one.sizes[0] * DISPLAYED[unit]
    return None


def _held(looked: Sequence[Judged], *, growing: bool = False) -> str:
    """How many intervals hold the size that the fault has at the end."""
    given = [interval(one) for one in looked if one.label.endswith("growing") == growing]
    there = [each for each in given if each is not None]
    return str(exact_share(sum(low <= true <= high for low, high, true in there), len(there)))


def _cell(here: Sequence[Judged]) -> str:
    if not here:
        return "-"
    found = [one for one in here if one.delay_s is not None]
    looked = [one for one in found if one.standing.get(120.0)]
    inside, first = sum(map(_in, looked)), sum(map(_first, looked))
    if not found:
        return f"0 of {len(here)}"
    late = median(one.delay_s for one in found if one.delay_s is not None)
    names = np.mean([len(one.first()) for one in looked]) if looked else float("nan")
    return f"{len(found)} of {len(here)}, {inside}, {first} of {len(looked)}; {late:.0f} s, {names:.1f}"


if __name__ == "__main__":
    run(Campaign(__doc__, VEHICLES, vehicle, page, RESULTS, WORK, FROZEN))

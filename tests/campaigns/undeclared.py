"""Faults that no model declares, on vehicles that nothing was chosen on: `make campaign-undeclared`.

    .venv/bin/python tests/campaigns/undeclared.py --vehicles 621 622

Trucks of the rig's fleet (profile `everyday`, hidden effects of set A or B), calibrated and tuned as their workshop
would (`diagnosis_shop`). Of each fault of `testbench.undeclared`, and of a leak, one size that shows and a severe one,
abrupt, within a drive. A line of the results is a vehicle; what is there of the same code is not made again.
"""

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from by_vehicle import Campaign, run, set_of
from diagnosis_cases import Case, hidden, seed_of
from diagnosis_judged import Judged, all_of
from diagnosis_shop import Workshop, sent, told_of, watched
from results_page import exact_share, provenance

from faultline.service.core.errors import InputError
from faultline.testbench.undeclared import UNDECLARED

Record = dict[str, Any]

VEHICLES = tuple(range(621, 627))
SECONDS = 480.0
SIZES = {name: (each.shows, each.severe) for name, each in UNDECLARED.items()} | {"leak_ap": (0.1, 1.8)}
EQUIVALENT = {"air_tp": ("fq_pump", "fA_p"), "return_kinked": ("fA_ori",), "inlet_sticks": ("fy_p_ap",)}
"""Components that do to all that is measured what the fault does. Air in the suction pipe costs the pump flow; the
filter in the tank passes as much as before, and nothing measures the pressure behind the pump's. At a pressure that is
held, the return passes less by a pressure behind it as by a smaller orifice. A valve that opens at a certain drop adds
this drop to the line, as a sensor before it would that reads too much."""
HEAD = """# Faults that nobody declared

All data are **simulated** by the rig. Made by `make campaign-undeclared`; vehicles, faults, sizes and what counts are
declared in `tests/campaigns/undeclared.py`, frozen before it was run. Two minutes after the first diagnosis, *unknown*
is right: alone, or as one of the explanations, whatever its rank; behind every single fault it has at least its prior
probability, so that *of rank 1* is what the evidence says. *One wrong component*: a single explanation of rank 1, which
is no unknown one. Three faults do to all that is measured what a declared one does: air in the suction pipe
(a worn pump), a kinked return (its clogged orifice), and a sticking inlet valve (the sensor before it). They are
counted, and left out in rows of their own. Intervals of 95 % are exact (Clopper and Pearson).

The decision was developed after a first look, at vehicles 601 to 604 (commit ba26e09c): unknown among the explanations
in 54 % of 87, one wrong component in 22 %.
"""
RESULTS = Path("docs/results/undeclared.jsonl")
WORK = Path("out/campaign-undeclared")
FROZEN = (
    "analysis", "service", "testbench", "dbc", "tests/campaigns/undeclared.py", "tests/campaigns/diagnosis_shop.py",
)  # fmt: skip


def cases(number: int) -> Iterator[Case]:
    """All recordings of a vehicle."""
    for row, (fault, sizes) in enumerate(SIZES.items()):
        for column, size in enumerate(dict.fromkeys(sizes)):
            seed = seed_of(number, 700 + 2 * row + column)
            label = ("shows", "severe")[column]
            yield Case(number, set_of(number), "single", label, ((fault, size),), seed, SECONDS)


def vehicle(shop: Workshop) -> Record:
    """All recordings of one vehicle; none where the workshop's tuning refuses it."""
    start, busy = time.monotonic(), time.process_time()
    told: list[Record] = []
    refused = None
    try:
        bundle = shop.bundle()
        for case in cases(shop.number):
            seen = watched(bundle, case.name, sent(case))
            told.append(told_of(case, seen, bundle.manifest.period_s))
    except InputError as error:
        refused = str(error)
    spent = {"wall_s": round(time.monotonic() - start, 1), "cpu_s": round(time.process_time() - busy, 1)}
    effects = hidden(shop.number, shop.effects_set)
    return {"vehicle": shop.number, "effects": effects, "refused": refused, "judged": told, **spent}


def is_unknown(one: Judged) -> bool:
    """Whether an explanation is that the fault is unknown."""
    return any(name == "unknown" for name, *_ in one.standing[120.0])


def is_first(one: Judged) -> bool:
    """Return True if an unknown fault is of rank 1."""
    return "unknown" in one.first()


def is_wrong(one: Judged) -> bool:
    """Whether one component alone is of rank 1."""
    said = one.first()
    return len(said) == 1 and said != ["unknown"]


def page(records: Sequence[Record]) -> str:
    """The tables, of all vehicles that are there."""
    judged = all_of(list(records))
    looked = [one for one in judged if one.standing.get(120.0)]
    telling = [one for one in looked if one.faults[0] not in EQUIVALENT]
    refused = ", ".join(str(r["vehicle"]) for r in records if r["refused"]) or "none"
    commit = ", ".join(sorted({record["commit"] for record in records}))
    lines = [HEAD, provenance(commit, sum(record["wall_s"] for record in records)), ""]
    lines += [f"{len(records)} vehicles, {len(judged)} cases. Refused by the workshop's tuning: {refused}.", ""]
    lines += ["| | wanted | measured |", "|---|---|---|"]
    lines.append(f"| detected | - | {exact_share(sum(one.detected for one in judged), len(judged))} |")
    for which, of in (("", looked), (", without these three", telling)):
        lines.append(f"| unknown is among the explanations{which} | >= 90 % | {_share(is_unknown, of)} |")
        lines.append(f"| unknown is of rank 1{which} | - | {_share(is_first, of)} |")
        lines.append(f"| one wrong component{which} | <= 2 % | {_share(is_wrong, of)} |")
    lines += [
        "",
        "## Every fault",
        "",
        "Detected; of these *unknown*, and one wrong component; names of rank 1.",
        "",
    ]
    lines += ["| fault | shows | severe |", "|---|---|---|"]
    for fault in SIZES:
        here = [one for one in judged if one.faults == (fault,)]
        cells = [_cell([one for one in here if one.label == label]) for label in ("shows", "severe")]
        lines.append(f"| {fault} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _share(right: Any, of: Sequence[Judged]) -> str:
    return str(exact_share(sum(map(right, of)), len(of)))


def _cell(here: Sequence[Judged]) -> str:
    if not here:
        return "-"
    looked = [one for one in here if one.standing.get(120.0)]
    named = sorted({" ".join(one.first()) for one in looked})
    counts = f"{sum(map(is_unknown, looked))}, {sum(map(is_wrong, looked))} of {len(looked)}"
    return f"{sum(one.detected for one in here)} of {len(here)}; {counts}; {'; '.join(named)}"


if __name__ == "__main__":
    run(Campaign(__doc__, VEHICLES, vehicle, page, RESULTS, WORK, FROZEN))

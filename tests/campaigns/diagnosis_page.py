"""The page of `diagnosis`: one table a question, what was wanted first."""

import json
import os
import platform
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from diagnosis_goals import Hours, goals
from diagnosis_judged import Judged, all_of
from diagnosis_limits import beside_the_limit
from diagnosis_mates import excused
from diagnosis_tables import alarms, by_effect, by_fault, by_look, calibration, curve, isolability, pairs, smallest
from results_page import exact_rate

Record = dict[str, Any]

PAGE = "diagnosis.md"
HEADING = 2
"""Lines of a table's head: one without more is left out."""

HEAD = """# What is told of faults on other vehicles

All data are **simulated** by the rig. Sets A and B: profile `everyday`, every recording has a day of its own
(viscosity, zeros of the sensors, tank level), every vehicle one or two hidden effects of modest size. None: profile
`realistic`, days do not differ and nothing is hidden; against that the frozen sizes are small and large. Set C: the
effects of A and B on other trucks, every fifth with a sensor's backlash, and six plants of families of another
structure; frozen, then run once. Sets that older code has made are not here. Made by
`make campaign-diagnosis` and `make campaign-false-alarms`; vehicles, effects, faults, sizes and pairs are declared in
`tests/campaigns/diagnosis_cases.py`. Each vehicle is calibrated on a training recording of its own and tuned as its
workshop would, then judged on other drives, by what it tells. Small and large are sizes by effect, frozen before any
decision was tuned to them (`testbench/sizes.toml`).

*Delay*: from the onset to the first new diagnosis, in seconds and in seconds of exciting operation (dose above idle).
*In the diagnosis*: of the detected, those whose true component is of rank 1, 120 s after the first diagnosis; one that
has healed by then is not. *Mean size*: how many are of rank 1 then, where any are. *Wrong alone*: one is, and it names
no true fault. *Practical mates*: what stood beside the fault in two recordings at least, and in a fifth, of the other
half of the vehicles. *Smallest size detected*: of the sizes driven, in the units of `testbench/sizes.toml`; the true
limit is between it and the next smaller one. Intervals are exact (Clopper and Pearson, Garwood): "at most" is a
one-sided bound of 95 %, from-to a two-sided interval of 95 %.
"""


def page(records: Sequence[Record], hours: Sequence[Record] = (), more: str = "") -> str:
    """The page of one set of hidden effects, as Markdown."""
    refused = [f"truck-{record['vehicle']}" for record in records if record.get("refused")]
    records = [record for record in records if not record.get("refused")]
    told = all_of([*records])
    free, of_others = fault_free(told, hours, records[0]["claim"]), excused(told)
    effects = {record["vehicle"]: [*record["effects"]] for record in records}
    said = Counter(name for names in free.false for name in names)
    limits = {record["vehicle"]: record["limit"] for record in records if record.get("limit")}
    tables = {
        "Wanted and measured": goals(told, free, of_others),
        "Beside the limit": beside_the_limit(told, limits) if limits else [],
        "Every fault": by_fault(told, of_others),
        "How a diagnosis develops": by_look(told),
        "Probabilities": calibration(told),
        "Detection over size": curve(told),
        "Smallest size detected": smallest(told),
        "Two faults at once": pairs(told),
        "Practical isolability": isolability(told),
        "Alarms without a fault": [*alarms(free), "", f"Told without a fault: {dict(said) or 'nothing'}."],
        "Hidden effects": by_effect(told, effects),
    }
    doubted = sum(bool(record["doubts"]) for record in records)
    lines = [
        f"{len(records)} vehicles, {len(told)} recordings. `calibrate` doubts its model of {doubted} of the vehicles:"
    ]
    lines[0] += " hidden effects, or a zero of y_p_tp that is the tank's level; the workshop takes it all the same."
    blind = sum(one.cannot_tell for one in told) / len(told)
    lines.append(f"After the onset (in fault-free drives: throughout) {100 * blind:.1f} % of the tests could not tell.")
    if refused:
        lines.append(
            f"Refused by the workshop's tuning, so in no figure: {', '.join(refused)}. They have no fault: hidden "
            "effects move their residuals by more than the reference vehicles make plausible."
        )
    for title, table in tables.items():
        if len(table) > HEADING:
            lines += ["", f"## {title}", "", *table]
    cpu = sum(record["cpu_s"] for record in records)
    commits, codes = (", ".join(sorted({r[name] for r in [*records, *hours]})) for name in ("commit", "code"))
    machine = f"{platform.machine()} with {os.cpu_count()} cores"
    lines += [more, f"Commit {commits}, code {codes}, {machine}, {cpu / 3600:.1f} CPU-h."]
    return "\n".join(lines) + "\n"


def fault_free(told: Sequence[Judged], hours: Sequence[Record], claim: str) -> Hours:
    """What was told where there was no fault: before onsets, in fault-free drives, and in the hours driven besides."""
    counted = Counter(test for one in told for test in one.alarms)
    false = [names for one in told for names in one.false]
    for hour in hours:
        counted.update(hour["alarms"])
        false += [names for _, names in hour["false"]]
    seconds = sum(one.free_s for one in told) + sum(hour["seconds"] for hour in hours)
    vehicles = {one.vehicle for one in told} | {hour["vehicle"] for hour in hours}
    return Hours(seconds / 3600, len(vehicles), false, counted, claim)


def by_vehicle(hours: Sequence[Record]) -> list[str]:
    """The hours driven besides, by vehicle, and all of them; older ones did not count suspicions."""
    rows = ["| vehicle | diagnoses told | suspicions | alarms of single tests |", "|---|---|---|---|"]
    numbers = sorted({hour["vehicle"] for hour in hours})
    groups = {f"truck-{number}": [hour for hour in hours if hour["vehicle"] == number] for number in numbers}
    for name, own in (groups | {"all": [*hours]}).items():
        driven = sum(hour["seconds"] for hour in own) / 3600
        told, single = sum(len(hour["false"]) for hour in own), sum(sum(hour["alarms"].values()) for hour in own)
        counted = all("suspected" in hour for hour in own)
        suspected = exact_rate(sum(len(hour["suspected"]) for hour in own), driven) if counted else "-"
        rows.append(f"| {name} | {exact_rate(told, driven)} | {suspected} | {exact_rate(single, driven)} |")
    return rows


def of_same_code(hours: Sequence[Record], records: Sequence[Record]) -> list[Record]:
    """The hours that were driven with what made the records."""
    ways = {(record["code"], record["tuning"]) for record in records}
    return [hour for hour in hours if (hour["code"], hour["tuning"]) in ways]


def latest(records: Sequence[Record]) -> list[Record]:
    """Of each vehicle the last of those of the code and tuning that the last of all is of: no others count with it."""
    same = [record for record in records if all(record[name] == records[-1][name] for name in ("code", "tuning"))]
    return [*{record["vehicle"]: record for record in same}.values()]


def write_page(results: Path) -> None:
    """Writes the page of what is there: set B first, which is used once, then A, then none.

    Raises:
        SystemExit: nothing is there.
    """
    parts = [HEAD]
    for name in ("C", "B", "A", "none"):
        records, hours = (_read(results / f"{kind}-{name}.jsonl") for kind in ("diagnosis", "false-alarms"))
        rivals = results / f"diagnosis-rivals-{name}.md"
        more = "\n" + rivals.read_text() if rivals.exists() else ""
        records = latest(records)
        hours = of_same_code(hours, records)
        if hours:
            more += "\n" + "\n".join(["## Hours by vehicle", "", *by_vehicle(hours), ""])
        if records:
            title = "# No days, no hidden effects" if name == "none" else f"# Set {name}"
            parts.append(f"{title}\n\n" + page(records, hours, more))
    if len(parts) == 1:
        raise SystemExit(f"{results}: no records of a diagnosis campaign; run make campaign-diagnosis first")
    (results / PAGE).write_text("\n".join(parts))


def _read(path: Path) -> list[Record]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []

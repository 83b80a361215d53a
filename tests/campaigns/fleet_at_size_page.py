"""The page of `fleet_at_size.py`: what a fleet costs, and what it is told."""

from collections import Counter
from collections.abc import Sequence
from statistics import median
from typing import Any

from results_page import exact_rate, exact_share, provenance

Record = dict[str, Any]

HEAD = """# A fleet of simulated vehicles

All data are **simulated** by the rig. Made by `make campaign-fleet`; what counts is declared in
`tests/campaigns/fleet_at_size.py`. Every vehicle is built like one of eight trucks that were calibrated and tuned by
`faultline fleet`, and makes one drive of ten minutes on a day of its own; one in five gets a large fault on the way.
Logs are deleted once a shard of 25 vehicles is diagnosed.
"""


def page(records: Sequence[Record]) -> str:
    """The tables of these shards."""
    vehicles = [each for record in records for each in record["vehicles"]]
    hours = sum(each.get("span_s", 0.0) for each in vehicles) / 3600.0
    commit = ", ".join(sorted({record["commit"] for record in records}))
    seconds = sum(record["rig_wall_s"] + record["diagnose"]["wall_s"] for record in records)
    lines = [HEAD, provenance(commit, seconds), "", f"**{len(vehicles)} vehicles, {hours:.1f} vehicle-hours**", ""]
    lines += ["## What a vehicle-hour costs", "", "| | CPU time of a vehicle-hour | largest worker |", "|---|---|---|"]
    rig = sum(record["rig_cpu_s"] for record in records)
    lines.append(f"| the rig, writing the log | {rig / max(hours, 1e-9):.1f} s | |")
    spent = [record["diagnose"] for record in records]
    cpu_s, largest = sum(each["cpu_s"] for each in spent), max((each["mib"] for each in spent), default=0.0)
    lines.append(
        f"| `fleet diagnose`, starting its workers for every shard | {_per(cpu_s, hours)} | {largest:.0f} MiB |"
    )
    for fault, what in ((False, "without a fault"), (True, "with one")):
        rows = [each for each in vehicles if (each["fault"] is not None) == fault and "cpu_s" in each]
        own = sum(each["span_s"] for each in rows) / 3600.0
        lines.append(f"| its drives {what} | {_per(sum(each['cpu_s'] for each in rows), own)} | |")
    for name, cost in (records[0]["costs"] if records else {}).items():
        lines.append(f"| `fleet {name}` | {_per(cost['cpu_s'], cost['hours'])} | {cost['mib']:.0f} MiB |")
    lines += ["", *_processes(records), "", "## What it is told", "", *_told(vehicles, hours), ""]
    twice, lost = sum(record["twice"] for record in records), sum(each["verdict"] == "lost" for each in vehicles)
    killed = sum(record["killed"] for record in records)
    lines.append(f"Workers killed at work: {killed}; drives without a row: {lost}, with two: {twice}.")
    return "\n".join(lines) + "\n"


def _per(cpu_s: float, hours: float) -> str:
    return f"{cpu_s / hours:.1f} s" if hours else "-"


def _processes(records: Sequence[Record]) -> list[str]:
    found = []
    for record in records:
        if "one_process" in record:
            one, two = record["one_process"]["wall_s"], record["two_processes"]["wall_s"]
            four = two - (one - two) / 2.0
            found.append(
                f"A shard with one process: {one:.0f} s, with two: {two:.0f} s; with four, on paper: {four:.0f} s. "
                f"Of its first vehicles diagnosed one by one, {record['differ']} have other events."
            )
    return found


def _told(vehicles: Sequence[Record], hours: float) -> list[str]:
    faulty = [each for each in vehicles if each["fault"] is not None]
    sound = [each for each in vehicles if each["fault"] is None]
    verdicts = Counter(each["verdict"] for each in vehicles)
    found = [each for each in faulty if each["verdict"] == "fault" and each["occurred_s"] >= each["onset_s"]]
    false = [each for each in sound if each["verdict"] == "fault"]
    false += [each for each in faulty if each["verdict"] == "fault" and each["occurred_s"] < each["onset_s"]]
    first = [each for each in found if (each["fault"] if each["fault"] != "leak_ap" else "unknown") in each["first"]]
    free = sum(each.get("span_s", 0.0) for each in sound) + sum(each["onset_s"] for each in faulty)
    lines = ["| | |", "|---|---|"]
    lines.append(f"| verdicts | {', '.join(f'{count} {name}' for name, count in sorted(verdicts.items()))} |")
    lines.append(f"| with a fault: found after its onset | {exact_share(len(found), len(faulty))} |")
    lines.append(f"| of those: the component among the best explanations | {exact_share(len(first), len(found))} |")
    lines.append(f"| false reports | {exact_rate(len(false), free / 3600.0)} |")
    delays = [each["occurred_s"] - each["onset_s"] for each in found]
    lines.append(f"| median delay | {median(delays):.0f} s |" if delays else "| median delay | - |")
    return lines

"""The page of `diagnosis`: by fault and size, what was told."""

import os
import platform
import statistics
from collections.abc import Sequence
from typing import Any

from results_page import exact_share

Record = dict[str, Any]

HEAD = """# What is told of faults on other vehicles

All data are **simulated** by the rig, profile `realistic`; made by `make campaign-diagnosis`. Each vehicle of the fleet
is calibrated on a training recording of its own and tuned on two fault-free drives, then judged on other drives. Faults
are there from 150 s on; small and large are sizes by effect, frozen before any decision was tuned to them
(`testbench/sizes.toml`). *In* is the share of the detected whose true component is of rank 1, 120 s after the first
diagnosis; *size* is how many are of rank 1 then, none where the diagnosis has healed by then, as small faults do
between doses; *wrong alone*: one component is, and it is another. Intervals are exact (95 %). Not here yet: drift from
one drive to the next, hidden effects, two faults at once.
"""

TAIL = """
fA_p changes what is measured only where the pump starves, which the model's equations do not have, and a leak is no
fault of the model: both are told as what they look like, a weak pump.
"""

COLUMNS = "| fault | size | detected | median delay [s] | in | size | wrong alone |"
APART, ALL = ("fA_p", "leak_ap"), "**all but fA_p and the leak**"
MOST = 3.0
"""Upper 95 % limit of a count that was zero (Poisson)."""


def page(records: Sequence[Record]) -> str:
    """The page, as Markdown."""
    judged = [told for record in records for told in record["judged"]]
    hours = sum(told["seconds"] for told in judged) / 3600
    false = [named for told in judged for named in told["false"]]
    lines = [HEAD, f"{len(records)} vehicles. Fault-free: {len(false)} diagnoses told in {hours:.1f} h"]
    lines[-1] += f": {false}." if false else f", so at most {MOST / hours:.2f} an hour (95 %)."
    lines += ["", COLUMNS, "|---|---|---|---|---|---|---|"]
    faulty = [told for told in judged if told["fault"]]
    for fault, size in dict.fromkeys((told["fault"], told["size"]) for told in faulty):
        lines.append(_row(fault, size, [told for told in faulty if (told["fault"], told["size"]) == (fault, size)]))
    for size in ("small", "large"):
        lines.append(_row(ALL, size, [t for t in faulty if t["size"] == size and t["fault"] not in APART]))
    lines.append(TAIL)
    commits, codes = (", ".join(sorted({r[name] for r in records})) for name in ("commit", "code"))
    lines += ["", f"Commit {commits}, code {codes}, {platform.machine()} with {os.cpu_count()} cores."]
    return "\n".join(lines) + "\n"


def _row(fault: str, size: str, told: Sequence[Record]) -> str:
    seen = [one for one in told if one["delay_s"] is not None]
    right = [one for one in seen if one["fault"] in one["standing"]]
    alone = [one for one in seen if len(one["standing"]) == 1 and one["standing"] != ["unknown"] and one not in right]
    delay = f"{statistics.median(one['delay_s'] for one in seen):.0f}" if seen else "-"
    mean = f"{statistics.fmean(len(one['standing']) for one in seen):.1f}" if seen else "-"
    shares = exact_share(len(right), len(seen)), exact_share(len(seen), len(told))
    return f"| {fault} | {size} | {shares[1]} | {delay} | {shares[0]} | {mean} | {len(alone)} |"

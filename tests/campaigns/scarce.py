"""Little data: equations and networks from 2, 5 and 20 minutes of driving. `make campaign-scarce`.

    .venv/bin/python tests/campaigns/scarce.py --vehicles 961 962

Trucks of the rig's fleet (profile `everyday`, hidden effects): the four bundles of `hybrid.py`, calibrated and trained
on a recording of 2, 5 or 20 minutes behind its start-up, with the same tuning drives, faults and drives. A line of the
results is a vehicle; what is there of the same code is not made again.
"""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from by_vehicle import Campaign, run
from diagnosis_shop import Workshop
from hybrid import judged_by
from hybrid_page import METHODS, read, shares
from results_page import provenance

from faultline.service.core.errors import InputError

Record = dict[str, Any]

VEHICLES = tuple(range(961, 965))
MINUTES = (2, 5, 20)
START_UP_S = 30.0
"""Pressure is built up [s], and below 5 bar nothing can be learnt: of 2 minutes with it 100 s were left, which `train`
refused (d3d85ef)."""
RESULTS = Path("docs/results/scarce.jsonl")
WORK = Path("out/campaign-scarce")
FROZEN = (
    "analysis", "service", "testbench", "training", "dbc", "tests/campaigns/hybrid.py", "tests/campaigns/scarce.py",
    "tests/campaigns/diagnosis_shop.py",
)  # fmt: skip
HEAD = """# Equations and networks from little data

All data are **simulated** by the rig. Made by `make campaign-scarce`; vehicles and what counts are declared in
`tests/campaigns/scarce.py` and `hybrid.py`. The same vehicles, tuning drives, drives and faults, large and severe; what
differs is how long the recording is, behind a start-up of 30 s, that calibrates the equations and trains the networks.
From structure alone a second one besides, as long, excites. *In the set* as in the page of [the comparison](hybrid.md).
"""


def vehicle(shop: Workshop) -> Record:
    """All recordings of one vehicle, by all methods, from each length of the recording."""
    start, busy = time.monotonic(), time.process_time()
    told: dict[str, Any] = {}
    for minutes in MINUTES:
        of = replace(shop, folder=shop.folder / f"{minutes}-minutes", training_s=START_UP_S + 60.0 * minutes)
        try:
            told[str(minutes)] = {"refused": None, "judged": judged_by(of)[0]}
        except (InputError, RuntimeError) as error:  # a command of the workshop that refused, in its own words
            told[str(minutes)] = {"refused": str(error).strip().splitlines()[-1], "judged": []}
    spent = {"wall_s": round(time.monotonic() - start, 1), "cpu_s": round(time.process_time() - busy, 1)}
    return {"vehicle": shop.number, "minutes": told, **spent}


def page(records: Sequence[Record]) -> str:
    """The tables, of all vehicles that are there."""
    commit = ", ".join(sorted({record["commit"] for record in records}))
    lines = [HEAD, provenance(commit, sum(record["wall_s"] for record in records)), "", f"{len(records)} vehicles.", ""]
    lines += [f"| | {' | '.join(METHODS.values())} |", "|---" * (1 + len(METHODS)) + "|"]
    for minutes in map(str, MINUTES):
        told = read([{**record, **record["minutes"][minutes]} for record in records])
        lines += [f"| {minutes} minutes: {what} | {' | '.join(row)} |" for what, row in shares(told)]
    refused = [
        f"- truck-{record['vehicle']}, {minutes} minutes: {of['refused']}"
        for record in records
        for minutes, of in record["minutes"].items()
        if of["refused"]
    ]
    return "\n".join([*lines, *(["", "Refused:", "", *refused] if refused else [])]) + "\n"


if __name__ == "__main__":
    run(Campaign(__doc__, VEHICLES, vehicle, page, RESULTS, WORK, FROZEN))

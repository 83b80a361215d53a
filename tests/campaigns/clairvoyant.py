"""Is the limit one, on recordings? `make campaign-clairvoyant`.

    .venv/bin/python tests/campaigns/clairvoyant.py --vehicles 931 932

Trucks of the rig's fleet (profile `everyday`, hidden effects of set A or B), calibrated and tuned as their workshop
would (`diagnosis_shop`), and drives with each small and large fault of the frozen list. A clairvoyant that knows fault,
onset and size watches the log-likelihood ratio of the block means

    L_k = sum_{j <= k} g_j' w_j - |g_j|^2 / 2            w: whitened innovations, g: their shift by this very fault

and decides at ln(500 h / 3 s) nats. By `faultline limit` L has the mean J and the variance 2 J: what reaches the nats
earlier than J + 1.645 sqrt(2 J) does is faster than the limit lets one drive in twenty be. A line of the results is a
vehicle; what is there of the same code is not made again.
"""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from by_vehicle import Campaign, run, set_of
from diagnosis_cases import cases, hidden
from diagnosis_limit import EVERY_H, OF_MODEL, blocks_of, shift
from diagnosis_shop import Workshop, sent
from results_page import exact_share, provenance

from faultline.analysis.limit.information import signatures
from faultline.service.bundle.load import Bundle
from faultline.service.core.decision.baseline import BaselineFilter, BaselineModel
from faultline.service.core.decision.blocks import BLOCK, Block
from faultline.service.core.errors import InputError

Record = dict[str, Any]

VEHICLES = (931, 932, 933, 934)
EARLY = 1.645
"""Standard deviations that one in twenty is beyond."""
HEAD = """# The limit beside a clairvoyant

All data are **simulated** by the rig. Made by `make campaign-clairvoyant`; vehicles and cases are declared in
`tests/campaigns/clairvoyant.py`. A clairvoyant knows fault, onset and size, and decides by the log-likelihood ratio of
the same block means that the vehicle has. It should be faster than the limit lets one drive in twenty be in no more
than 5 % of the recordings, and in the median no slower than 1.5 times the limit. Delays are in 3 s blocks of steady
operation. Left out: a leak, which the model has no such size of, and faults that neither reaches within the drive.
"""
RESULTS = Path("docs/results/clairvoyant.jsonl")
WORK = Path("out/campaign-clairvoyant")
FROZEN = (
    "analysis", "service", "testbench", "dbc", "tests/campaigns/clairvoyant.py", "tests/campaigns/diagnosis_limit.py",
    "tests/campaigns/diagnosis_shop.py", "tests/campaigns/diagnosis_cases.py",
)  # fmt: skip


def vehicle(shop: Workshop) -> Record:
    """All recordings of one vehicle; none where the workshop's tuning refuses it."""
    start, busy = time.monotonic(), time.process_time()
    found: list[Record] = []
    refused = None
    try:
        bundle = shop.bundle()
        for case in cases(shop.number, shop.effects_set):
            if case.kind == "single" and case.faults[0][0] not in LEAKS:
                [(fault, size)] = case.faults
                blocks = blocks_of(bundle, sent(case))
                found.append(
                    {"fault": fault, "label": case.label, **delays_of(bundle, blocks, fault, size, case.onset_s)}
                )
    except InputError as error:
        refused = str(error)
    spent = {"wall_s": round(time.monotonic() - start, 1), "cpu_s": round(time.process_time() - busy, 1)}
    return {"vehicle": shop.number, "effects": hidden(shop.number, set_of(shop.number)), "refused": refused,
            "cases": found, **spent}  # fmt: skip


LEAKS = {fault for fault, (name, *_) in OF_MODEL.items() if name != fault}


def delays_of(
    bundle: Bundle, blocks: Sequence[Block], fault: str, size: float, onset_s: float
) -> dict[str, float | None]:
    """The delays [s] of the clairvoyant, of the limit in the mean and in the earliest twentieth; None for never."""
    manifest = bundle.manifest
    model = BaselineModel(manifest.evidence, manifest.time)
    nats = float(np.log(3600.0 * EVERY_H / (manifest.time.ticks(BLOCK) * manifest.time.period_s)))
    end_s = np.array([float(block.end_s[0]) for block in blocks])
    begin = int(np.searchsorted(np.concatenate([[0.0], end_s[:-1]]), onset_s))  # the first block that is all faulty
    if begin >= len(blocks):
        return {"clairvoyant_s": None, "limit_s": None, "early_s": None}
    g = shift(bundle, signatures(blocks, model, np.array([begin])), fault, size)[0]  # (N, K)
    without = BaselineFilter(model)
    white = np.array([without.step(block).white[0] for block in blocks])
    J = (g**2).sum(axis=1).cumsum() / 2.0
    L = (g * white).sum(axis=1).cumsum() - J
    since_s = end_s - onset_s
    courses = {"clairvoyant_s": L, "limit_s": J, "early_s": J + EARLY * np.sqrt(2.0 * J)}
    return {name: _reached(course, since_s, nats) for name, course in courses.items()}


def _reached(course: Any, since_s: Any, nats: float) -> float | None:
    above = np.flatnonzero(course >= nats)
    return round(float(since_s[above[0]]), 1) if len(above) else None


def page(records: Sequence[Record]) -> str:
    """The tables, of all vehicles that are there."""
    told = [case for record in records for case in record["cases"]]
    within = [case for case in told if case["limit_s"] is not None or case["clairvoyant_s"] is not None]
    commit = ", ".join(sorted({record["commit"] for record in records}))
    refused = ", ".join(str(r["vehicle"]) for r in records if r["refused"]) or "none"
    lines = [HEAD, provenance(commit, sum(record["wall_s"] for record in records)), ""]
    lines += [f"{len(records)} vehicles, {len(told)} recordings. Refused by the workshop's tuning: {refused}.", ""]
    lines += ["| | wanted | measured |", "|---|---|---|"]
    early = sum(faster(case) for case in within)
    lines.append(f"| faster than the limit lets one in twenty be | <= 5 % | {exact_share(early, len(within))} |")
    lines.append(f"| clairvoyant to limit, median | <= 1.5 | {ratio(within)} |")
    lines += ["", "| fault | size | recordings | clairvoyant, median [s] | limit, median [s] | ratio | faster |"]
    lines.append("|---|---|---|---|---|---|---|")
    for fault, label in dict.fromkeys((case["fault"], case["label"]) for case in within):
        own = [case for case in within if (case["fault"], case["label"]) == (fault, label)]
        medians = [median([case[name] for case in own]) for name in ("clairvoyant_s", "limit_s")]
        cells = " | ".join([*medians, ratio(own), str(sum(map(faster, own)))])
        lines.append(f"| {fault} | {label} | {len(own)} | {cells} |")
    return "\n".join(lines) + "\n"


def faster(case: Record) -> bool:
    """Return True if the clairvoyant was faster than the limit lets one drive in twenty be."""
    at, early = case["clairvoyant_s"], case["early_s"]
    return at is not None and (early is None or at < early)


def median(values: Sequence[float | None]) -> str:
    """The median, where what never comes is long."""
    found = float(np.median([np.inf if value is None else value for value in values]))
    return f"{found:.0f}" if np.isfinite(found) else "never"


def ratio(told: Sequence[Record]) -> str:
    """The median of the clairvoyant's delay in parts of the limit's, where the limit is reached."""
    both = [
        np.inf if case["clairvoyant_s"] is None else case["clairvoyant_s"] / case["limit_s"]
        for case in told
        if case["limit_s"] is not None
    ]
    return f"{np.median(both):.2f}" if both else "-"


if __name__ == "__main__":
    run(Campaign(__doc__, VEHICLES, vehicle, page, RESULTS, WORK, FROZEN))

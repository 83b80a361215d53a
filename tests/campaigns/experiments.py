"""Where the data leave several names for a hidden effect: does the proposed experiment leave the right one alone?

    .venv/bin/python tests/campaigns/experiments.py

Records are of trucks that no other campaign has, four minutes to fit and four held out, with effects of a size at which
names are hard to tell apart. Where `discover` has several names for the effect, the experiment that it proposes is
recorded on the same truck, and `discover` is called again with it, as its advice says. A set counts unless all its
names are declared equivalents of the truth (`discrepancy_declared.json`), which is known before anything is recorded.
"""

import argparse
import json
import multiprocessing
import tempfile
import time
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

from discrepancy import Inline, done, record_case
from discrepancy_cases import TRUTHS, Case
from discrepancy_page import DECLARED, entries, named_right, resolved, spoke, unique
from results_page import digest, exact_share, head_commit, provenance

from faultline.analysis.discrepancy.data import load
from faultline.analysis.discrepancy.discover import discover
from faultline.analysis.discrepancy.effects.experiments import load_experiments
from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.discrepancy.name.experiment import propose
from faultline.analysis.model import load_model
from faultline.analysis.model.file import SYSTEMS
from faultline.testbench.cycles import CYCLES, read_cycle

DURATION_S = 240.0
PAGE = Path("docs/results/experiments.md")
KEPT = PAGE.with_suffix(".jsonl")
FROZEN = ("analysis", "service/core", "service/logs", "systems/uds", "testbench", "tests/campaigns/experiments.py")
"""What the figures depend on."""

FIRST = 9100
"""The number of the first record, whose seeds no other campaign has used."""

ROUNDS = 3

MARK = "80 %, at least 40 sets"

SIZES: Mapping[str, tuple[float, ...]] = {
    "falling_level": (6.0, 9.0, 12.0),
    "laminar_filters": (5.0, 6.3, 7.5),
    "blocked_vent": (4.0, 6.0, 9.0),
    "stiff_hose": (2.0, 3.0, 4.0),
    "pump_slip": (4.0, 6.0, 7.5),
    "entrained_air": (1.4, 2.0, 3.0),
}
"""In parts of what is declared as the smallest that eight minutes of the cycle show: where trucks of development had
several names. Of the effects not listed all names were declared equivalents there, or one was left."""

HEAD = f"""# Several names for an effect: does the proposed experiment leave the right one alone?

Simulated trucks (`tests/campaigns/experiments.py`), each with one hidden effect of a size at which names are hard to
tell apart, {DURATION_S:.0f} s to fit and as much held out. Where `discover` has several names, the experiment that it
proposes is recorded on the same truck, and `discover` is called again with that recording besides. A set counts unless
all its names are declared equivalents of the truth, from recordings in which nothing is hidden
(`discrepancy_declared.json`). In brackets: exact 95 % intervals (Clopper and Pearson)."""


def evaluation() -> Iterator[Case]:
    """The records, one of every effect and size in turn."""
    number = FIRST
    for _ in range(ROUNDS):
        for place in range(max(map(len, SIZES.values()))):
            for name, sizes in SIZES.items():
                number += 1
                if place < len(sizes):
                    truth = TRUTHS[name]
                    size = sizes[place] * float(DECLARED[truth.entry]["smallest"]) / truth.scale
                    title = f"{number}-{name}-{sizes[place]:g}"
                    yield Case(title, "hidden", {name: size}, f"truck-{number}", 300_000 + 7 * number)


def run(case: Case, duration_s: float = DURATION_S) -> dict[str, Any]:
    """Records and searches; where there are several names, records what is proposed and searches again."""
    with tempfile.TemporaryDirectory() as folder:
        root, model = Path(folder), load_model("uds")
        library = load_library(SYSTEMS / "uds")
        training, held = (
            record_case(case, CYCLES[name], name, case.seed + k, case.effects, root, duration_s)
            for k, name in enumerate(("training", "validation"))
        )
        found = discover(load(model, [training], [held], lambda _: None), library, Inline(), None, lambda *_: None)
        result = {
            "case": case.name,
            "kind": case.kind,
            "effects": dict(case.effects),
            "verdict": found.verdict.kind,
            "sets": [list(names) for names in found.verdict.sets],
            "gain": found.verdict.gain,
        }
        if found.verdict.kind != "one of" or unique(result):
            return result
        start = time.process_time()
        plans = propose(found.study, found.baseline, found.rivals, load_experiments(SYSTEMS / "uds").planned)
        result["plan_cpu_s"] = time.process_time() - start
        if not plans or not plans[0].resolved:
            return {**result, "experiment": {"proposed": None}}
        best = plans[0]
        written = root / "experiment.toml"
        written.write_text(best.experiment.cycle())
        asked = read_cycle(written)
        extra = record_case(case, asked, "experiment", case.seed + 2, case.effects, root, best.experiment.duration_s)
        data = load(model, [training, extra], [held], lambda _: None)
        again = discover(data, library, Inline(), None, lambda *_: None)
        experiment = {
            "proposed": best.experiment.name,
            "duration_s": best.experiment.duration_s,
            "left": best.left,
            "likely": [[true, other, nats, best.likely[true, other]] for (true, other), nats in best.expected.items()],
            "verdict": again.verdict.kind,
            "sets": [list(names) for names in again.verdict.sets],
            "evidence": {attempt.effects[-1]: attempt.evidence for attempt in again.outcome.singles},
        }
        return {**result, "experiment": experiment}


def page(results: list[dict[str, Any]]) -> str:
    """The page."""
    several = [r for r in results if "experiment" in r]
    sets = [r for r in several if named_right({**r, "verdict": "one of"})]
    asked = [r for r in sets if r["experiment"]["proposed"]]
    alone = [r for r in sets if resolved(r)]
    left = [r for r in sets if unique(_after(r))]
    lost = [r for r in sets if spoke(_after(r)) and not named_right(_after(r))]
    of = len(sets)
    rows = [
        ("the right one is left alone", MARK, exact_share(len(alone), of)),
        ("... or with declared equivalents of it", "", exact_share(len(left), of)),
        ("... where an experiment was proposed", "", exact_share(sum(map(resolved, asked)), len(asked))),
        ("the right one is lost", "", exact_share(len(lost), of)),
    ]
    table = "\n".join(f"| {title} | {mark} | {value} |" for title, mark, value in rows)
    said = "\n".join(f"- {low:g} to {high:g}: {value}" for low, high, value in _honest(asked))
    each = "\n".join(map(_row, sets))
    cpu = sorted(r["plan_cpu_s"] for r in several)
    return f"""{HEAD}

Of {len(results)} records {len(several)} had several names that are not all equivalent; in {len(several) - of} of them
none was right, and those are not counted.

| | mark | found |
|---|---|---|
{table}

Pairs of the right name and another, by the probability with which the plan said that the other would be ruled out:

{said}

A plan takes {cpu[len(cpu) // 2]:.0f} s of CPU in the middle, {cpu[-1]:.0f} s at most.

| record | names | experiment | after it |
|---|---|---|---|
{each}
"""


def _after(r: Mapping[str, Any]) -> dict[str, Any]:
    """The record as it is after the experiment."""
    again = r["experiment"]
    return {**r, **({"verdict": again["verdict"], "sets": again["sets"]} if again["proposed"] else {})}


def _honest(asked: list[dict[str, Any]]) -> Iterator[tuple[float, float, str]]:
    """By the probability that was told, how many of the wrong names were ruled out."""
    for low, high in pairwise((0.0, 0.5, 0.8, 0.95, 1.0)):
        gone = []
        for r in asked:
            right, kept = {*entries(r)[0]}, {name for names in r["experiment"]["sets"] for name in names}
            gone += [
                other not in kept
                for true, other, _, likely in r["experiment"]["likely"]
                if true in right and low < likely <= high and other not in right
            ]
        yield low, high, exact_share(sum(gone), len(gone))


def _row(r: dict[str, Any]) -> str:
    again = r["experiment"]
    names, after = ("; ".join(", ".join(names) for names in which) for which in (r["sets"], again.get("sets", [])))
    if not again["proposed"]:
        return f"| {r['case']} | {names} | none | - |"
    good = "**" if resolved(r) else ""
    asked = f"{again['proposed']}, {again['duration_s']:.0f} s"
    return f"| {r['case']} | {names} | {asked} | {good}{again['verdict']}: {after}{good} |"


def main() -> None:
    """Runs what is missing and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--most", type=int, help="run so many further records")
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    commit, code, start = head_commit(), digest(*FROZEN), time.monotonic()
    there = {line["case"] for line in done(KEPT)}
    wanted = [case for case in evaluation() if case.name not in there][: options.most]
    with multiprocessing.Pool(options.processes) as pool, KEPT.open("a") as file:
        for result in pool.imap_unordered(run, wanted):
            file.write(json.dumps({**result, "commit": commit, "code": code}) + "\n")
            file.flush()
            print(result["case"], result["verdict"], result["sets"], result.get("experiment"), flush=True)
    results = sorted(done(KEPT), key=lambda r: str(r["case"]))
    PAGE.write_text(page(results) + "\n" + provenance(commit, time.monotonic() - start) + "\n")


if __name__ == "__main__":
    main()

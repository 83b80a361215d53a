"""Hidden effects that no entry describes: is a formula proposed, in the right equation and of the right form?

    .venv/bin/python tests/campaigns/proposals.py

Records are those of the discrepancy campaign, each a simulated truck of its own. What counts as right was declared
before (`proposals_declared.toml`). An effect is *visible* where the held-out free run's RMS error, in any output and
steady mode, is above 1.2 times that of its twin, the same truck without the effect. Results are appended as they come.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from discrepancy import DURATION_S, Inline, done, record_case
from discrepancy_cases import STRONG, Case, cases
from proposals_page import DECLARED, page
from results_page import digest, head_commit

from faultline.analysis.discrepancy.add.held_out import shown
from faultline.analysis.discrepancy.data import load
from faultline.analysis.discrepancy.discover import Discovery, discover
from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.discrepancy.name.attempt import Judge, Study, baseline_of
from faultline.analysis.discrepancy.propose.proposal import Proposal, propose_formula
from faultline.analysis.model import load_model
from faultline.analysis.model.file import SYSTEMS
from faultline.service.core.manifest import EDGE
from faultline.testbench.cycles import CYCLES
from faultline.testbench.effects import EFFECTS

PAGE = Path("docs/results/proposals.md")
KEPT = PAGE.with_suffix(".jsonl")
FROZEN = (
    "analysis", "service/core", "service/logs", "testbench", "tests/campaigns/proposals.py",
    "tests/campaigns/proposals_page.py", "tests/campaigns/proposals_declared.toml",
)  # fmt: skip
"""What the figures depend on."""

SIZES = (STRONG, 2.0, 0.6)
FIRST, SILENT = 3000, 10
"""The number of the first record, whose seeds no other campaign has used; how many have nothing hidden, after each of
the first two sizes."""


def evaluation() -> Iterator[Case]:
    """The records, the typical sizes first; those with nothing hidden between them."""
    number = FIRST
    for size in SIZES:
        for name, declared in DECLARED["evaluation"].items():
            number += 1
            share = min(size * EFFECTS[name].typical, EFFECTS[name].largest)
            yield _case(f"{name}-x{size:g}", "outside", {name: share}, number, tuple(declared.get("without", ())))
        for _ in range(SILENT if size >= STRONG else 0):
            number += 1
            yield _case("nothing", "nothing", {}, number)


def development() -> Iterator[Case]:
    """Those of set A that the discrepancy campaign has outside the library."""
    return (c for c in cases("A") if c.kind == "outside" and next(iter(c.effects)) in DECLARED["development"])


def _case(name: str, kind: str, effects: Mapping[str, float], number: int, without: tuple[str, ...] = ()) -> Case:
    return Case(f"{number}-{name}", kind, effects, f"truck-{number}", 200_000 + 7 * number, without)


def run(case: Case, duration_s: float = DURATION_S) -> dict[str, Any]:
    """Records, searches, proposes; with the errors of the twin where something is hidden."""
    with tempfile.TemporaryDirectory() as folder:
        root, model = Path(folder), load_model("uds")
        data = load(model, *_recorded(case, case.effects, root, duration_s), lambda _: None)
        library = {n: e for n, e in load_library(SYSTEMS / "uds").items() if n not in case.without}
        start, clock = time.process_time(), time.monotonic()
        found = discover(data, library, Inline(), None, lambda *_: None)
        after = time.process_time()
        set_in = found.onset(["training"], ["validation"])
        proposal = propose_formula(found, Inline(), None, lambda *_: None) if set_in is None else None
        cpu = {"cpu_s": after - start, "proposal_cpu_s": time.process_time() - after}
        result = {"case": case.name, "kind": case.kind, "effects": dict(case.effects), **cpu}
        result |= {
            "seconds": time.monotonic() - clock,
            "verdict": "fault" if set_in else found.verdict.kind,
            **_told(found, proposal),
        }
        if case.effects:
            errors = {"before": _errors(found.study, found, None)}
            if proposal is not None:
                errors["after"] = _errors(proposal.study, found, proposal)
            twin = load(model, *_recorded(case, {}, root / "off", duration_s), lambda _: None)
            study = Study(twin.key, model, {}, twin.training_sections, twin.held_sections)
            errors["twin"] = _errors(study, None, None)
            result["errors"] = errors
    return result


def _recorded(case: Case, effects: Mapping[str, float], root: Path, s: float) -> tuple[list[Path], list[Path]]:
    training = record_case(case, CYCLES["training"], "training", case.seed, effects, root, s)
    return [training], [record_case(case, CYCLES["validation"], "validation", case.seed + 1, effects, root, s)]


def _errors(study: Study, found: Discovery | None, proposal: Proposal | None) -> dict[str, float]:
    """Held-out RMS error by output and steady mode, in the output's unit."""
    baseline = baseline_of(study) if found is None else found.baseline
    nominal = Judge(study, baseline).attempt(()) if found is None else found.outcome.nominal
    runs = shown(study, baseline, nominal, nominal if proposal is None else proposal.outcome.chosen)
    return {
        f"{output} {mode}": float(agreement.rms)
        for output, by_mode in runs.after.agreement.items()
        for mode, agreement in by_mode.items()
        if mode != EDGE
    }


def _told(found: Discovery, proposal: Proposal | None) -> dict[str, Any]:
    told: dict[str, Any] = {
        "sets": [list(names) for names in found.verdict.sets],
        "members": list(found.before.members),
        "remainder": found.verdict.remainder,
        "terms": [],
    }
    if proposal is not None:
        told |= {
            "terms": [term.name for term in proposal.terms],
            "equations": [term.equation for term in proposal.terms],
            "rivals": [rival.name for rival in proposal.rivals],
            "gain": proposal.outcome.gain,
            "left": proposal.remainder,
            "whole": proposal.whole,
        }
    return told


def main() -> None:
    """Runs what is missing and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--development", type=Path, help="run set A's instead, and keep the results there")
    parser.add_argument("--until", type=float, default=float("inf"), help="begin no record after so many seconds")
    options = parser.parse_args()
    kept = options.development or KEPT
    commit, code, start = head_commit(), digest(*FROZEN), time.monotonic()
    there = {line["case"] for line in done(kept)}
    for case in development() if options.development else evaluation():
        if case.name in there or time.monotonic() - start > options.until:
            continue
        result = run(case)
        with kept.open("a") as file:
            file.write(json.dumps({**result, "commit": commit, "code": code}) + "\n")
        print(case.name, result["verdict"], result["terms"], file=sys.stderr, flush=True)
    if options.development is None:
        PAGE.write_text(page(done(kept)))


if __name__ == "__main__":
    main()

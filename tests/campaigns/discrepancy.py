"""The discrepancy workflow against effects that the rig hides: are they found, named, added, and is the gap gone?

    SHARD=1/4 .venv/bin/python tests/campaigns/discrepancy.py --set A

Every record is a truck of its own, recorded on the training and on the validation cycle (profile `ideal` and the
hidden effect), and searched as a user would: the four-state model with its datasheet's values, the shipped library.
Nothing changes between the two recordings of this profile, which is said (`--same-conditions`).
Results are appended as they come, one line a record, so that shards may be run on different days; the page is made of
all that are there. Set A is what the workflow was developed on, set B is run once after a commit that says so.
"""

import argparse
import json
import multiprocessing
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

from discrepancy_ablations_page import ABLATIONS, ablations
from discrepancy_cases import STRONG, Case, cases
from discrepancy_page import page
from results_page import digest, head_commit

from faultline.analysis.discrepancy.add.gate import adoption
from faultline.analysis.discrepancy.add.held_out import shown
from faultline.analysis.discrepancy.data import Data, load
from faultline.analysis.discrepancy.discover import Discovery, discover
from faultline.analysis.discrepancy.effects.experiments import load_experiments
from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.discrepancy.effects.rewrite import rewritten
from faultline.analysis.discrepancy.name.experiment import propose
from faultline.analysis.model import load_model
from faultline.analysis.model.file import SYSTEMS
from faultline.service.core.manifest import EDGE
from faultline.testbench.bus import load_dbc
from faultline.testbench.cycles import CYCLES, Cycle, read_cycle
from faultline.testbench.effects import EFFECTS
from faultline.testbench.recording import record
from faultline.testbench.request import Request
from faultline.testbench.vehicles import vehicle

DURATION_S, EXPERIMENT_S = 480.0, 120.0
PAGE = Path("docs/results/discrepancy.md")

FROZEN = (
    "analysis", "service/core", "service/logs", "testbench", "tests/campaigns/discrepancy.py",
    "tests/campaigns/discrepancy_cases.py", "tests/campaigns/discrepancy_declared.json",
)  # fmt: skip
"""What the figures depend on: it stays as it is from the first record of set B to the last."""


class Inline(Executor):
    """Here and now: the campaign's records, not their attempts, are what runs side by side."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """What `fn` returns, as a future that is done."""
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


def run(case: Case, duration_s: float = DURATION_S, *, further: bool = True) -> dict[str, Any]:
    """Records, searches and judges one case; `further`: with what experiments and closure tell."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        training = record_case(case, CYCLES["training"], "training", case.seed, case.effects, root, duration_s)
        held = record_case(case, CYCLES["validation"], "validation", case.seed + 1, case.effects, root, duration_s)
        start, busy = time.monotonic(), time.process_time()
        model = load_model("uds")
        library = {name: effect for name, effect in load_library(SYSTEMS / "uds").items() if name not in case.without}
        data = load(model, [training], [held], _nothing, same_conditions=True)
        found = discover(data, library, Inline(), None, _quiet)
        result = {
            "case": case.name,
            "kind": case.kind,
            "effects": dict(case.effects),
            "seconds": time.monotonic() - start,
            "cpu_s": time.process_time() - busy,
            **_judged(case, found),
        }
        if further and found.verdict.kind == "one of" and case.kind == "hidden":
            result["experiment"] = _resolved(case, found, training, held, root)
        if further and case.kind == "hidden" and _share(case) >= STRONG:
            result |= _closure(case, found, data, root)
    return result


def tried(case: Case) -> dict[str, Any]:
    """The same, or what went wrong: that is a result too."""
    try:
        return run(case)
    except Exception as error:  # noqa: BLE001  (whatever it is, the page counts it against the workflow)
        nothing = {"sets": [], "members": [], "changed": [], "gain": 0.0, "remainder": 0.0, "seconds": 0.0}
        what = {"case": case.name, "kind": case.kind, "effects": dict(case.effects), "cpu_s": 1e9}
        return {**what, **nothing, "verdict": f"{type(error).__name__}: {error}"}


def record_case(
    case: Case, cycle: Cycle, name: str, seed: int, effects: Any, root: Path, s: float = DURATION_S
) -> Path:
    """The case's vehicle on a cycle, with effects, in a folder."""
    request = Request(name, vehicle(case.vehicle), cycle, (), seed, s, effects, kind="instrumented")
    folder, _ = record(request, load_dbc(), root / "logs", root / "truth", force=True, progress=lambda _: None)
    return folder


def _judged(case: Case, found: Discovery) -> dict[str, Any]:
    return {
        "verdict": "fault" if found.onset(["training"], ["validation"]) else found.verdict.kind,
        "sets": [list(names) for names in found.verdict.sets],
        "gain": found.verdict.gain,
        "remainder": found.verdict.remainder,
        "threshold": found.outcome.threshold,
        "dispersion": [found.outcome.nominal.dispersion, found.outcome.chosen.dispersion],
        "members": list(found.before.members),
        "changed": _changed(found),
        "singles": [[a.effects[0], a.evidence - found.outcome.nominal.evidence] for a in found.outcome.singles[:5]],
    }


def _changed(found: Discovery) -> list[str]:
    """The equations that the chosen effects change."""
    model = found.study.model
    texts = [rewritten(model, found.study.library[names[0]]).equations for names in found.verdict.sets]
    return sorted({name for new in texts for name, e in model.equations.items() if new[name].text != e.text})


def _resolved(case: Case, found: Discovery, training: Path, held: Path, root: Path) -> dict[str, Any]:
    """Whether the proposed experiment tells which it is."""
    plans = propose(found.study, found.baseline, found.rivals, load_experiments(SYSTEMS / "uds").planned)
    if not plans or not plans[0].resolved:
        return {"proposed": None}
    best = plans[0]
    written = root / "experiment.toml"
    written.write_text(best.experiment.cycle())
    extra = record_case(case, read_cycle(written), "experiment", case.seed + 2, case.effects, root, EXPERIMENT_S)
    data = load(load_model("uds"), [training, extra], [held], _nothing, same_conditions=True)
    again = discover(data, load_library(SYSTEMS / "uds"), Inline(), None, _quiet)
    return {
        "proposed": best.experiment.name,
        "expected": min(best.resolved.values()),
        "untold": [list(pair) for pair in best.unresolved],
        "verdict": again.verdict.kind,
        "sets": [list(names) for names in again.verdict.sets],
    }


def _closure(case: Case, found: Discovery, data: Data, root: Path) -> dict[str, Any]:
    """Held-out RMS by output and mode [Pa]: as it was, with what was found, and without the effect (the floor).

    Also why `--apply` would refuse what was found, if it would.
    """
    off = root / "off"
    training = record_case(case, CYCLES["training"], "training", case.seed, {}, off)
    held = record_case(case, CYCLES["validation"], "validation", case.seed + 1, {}, off)
    without = load(load_model("uds"), [training], [held], _nothing, same_conditions=True)
    twin = discover(without, {}, Inline(), None, _quiet)
    runs, floor = (shown(d.study, d.baseline, d.outcome.nominal, d.outcome.chosen) for d in (found, twin))
    errors = {"before": runs.before.agreement, "after": runs.after.agreement, "floor": floor.before.agreement}
    by_regime = {
        f"{name} {mode}": {title: float(by_output[name][mode].rms) for title, by_output in errors.items()}
        for name, by_mode in floor.before.agreement.items()
        for mode in by_mode
        if mode != EDGE
    }
    return {"closure": by_regime, "refused": list(adoption(data, found, runs).reasons)}


def _share(case: Case) -> float:
    [(name, size)] = case.effects.items()
    return size / EFFECTS[name].typical


def _nothing(_: str) -> None: ...


def _quiet(*_: object) -> None: ...


def kept_in(set_name: str) -> Path:
    """The file of a set's results."""
    return PAGE.with_name(f"discrepancy-{set_name}.jsonl")


def done(path: Path) -> list[dict[str, Any]]:
    """The results so far."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def shard(all_of_them: Sequence[Case], text: str) -> list[Case]:
    """The i-th of n parts, for text i/n."""
    i, n = (int(part) for part in text.split("/"))
    return list(all_of_them)[i - 1 :: n]


def results(wanted: Sequence[Case], processes: int) -> Iterator[dict[str, Any]]:
    """Those of the cases as they come."""
    with multiprocessing.Pool(processes, maxtasksperchild=40) as pool:
        yield from pool.imap_unordered(tried, wanted, chunksize=1)


def main() -> None:
    """Runs what is missing and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", choices=("A", "B"), default="B")
    parser.add_argument("--shard", default=os.environ.get("SHARD", "1/1"), help="i/n: this part of the cases")
    parser.add_argument("--every", type=int, default=1, help="only every so many cases")
    parser.add_argument("--kinds", nargs="+", default=["hidden", "nothing", "outside", "two"])
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    commit, code, kept = head_commit(), digest(*FROZEN), kept_in(options.set)
    there = {line["case"] for line in done(kept)}
    wanted = [c for c in list(cases(options.set))[:: options.every] if c.kind in options.kinds]
    wanted = [c for c in shard(wanted, options.shard) if c.name not in there]
    for number, result in enumerate(results(wanted, options.processes), 1):
        with kept.open("a") as file:
            file.write(json.dumps({**result, "commit": commit, "code": code}) + "\n")
        print(f"{number} of {len(wanted)}: {result['case']}: {result['verdict']} {result['sets']}", flush=True)
    by_set = {name: done(kept_in(name)) for name in ("B", "A")}
    PAGE.write_text(page({name: found for name, found in by_set.items() if found}, ablations(done(ABLATIONS))))


if __name__ == "__main__":
    main()

"""What both kinds of residual generators cost to develop: the thesis' third question, in figures that can be counted.

    .venv/bin/python tests/campaigns/effort.py

Calibrated equations against grey-box networks of the same tests. CPU time of calibration is measured here, on a
recording of the length that the networks are trained with; that of training, and the errors, are those of
`make campaign-training` (`docs/results/grey-box.jsonl`). Parameters and states are counted in the objects themselves,
lines in the source. Nothing is guessed: hours of an engineer are not here, since nobody has measured them.
"""

import json
import statistics
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from diagnosis_shop import must
from results_page import digest, head_commit, provenance

from faultline.analysis.calibration.command import main as calibrate
from faultline.analysis.graph.bank import build_bank
from faultline.analysis.model import Model, load_model
from faultline.testbench.command import main as rig
from faultline.training.layout import layout_of
from faultline.training.network import Networks
from faultline.training.recipe import DEFAULT

Record = dict[str, Any]

RESULTS = Path("docs/results")
RECORDING_S = 600.0
FEWER_S = 120.0
"""A recording that adapts networks of another vehicle (`make campaign-training`, transfer)."""

PARTS: dict[str, dict[str, tuple[str, ...]]] = {
    "both": {
        "structure: tests from the model": ("analysis/structure",),
        "model file: reading, checking": ("analysis/model",),
        "graphs: what both run as": ("analysis/graph/writer.py", "analysis/graph/runnable.py"),
    },
    "equations": {
        "equations and parameters (TOML)": ("systems/uds/model.toml",),
        "calibration, with the free run": ("analysis/calibration", "analysis/simulation"),
        "implicit steps as ONNX": tuple(
            f"analysis/graph/{name}.py" for name in ("bank", "formula", "linear", "network", "step", "independence")
        ),
    },
    "networks": {
        "training, variance": ("training",),
        "networks as ONNX": ("analysis/graph/cells.py", "analysis/graph/networks.py"),
    },
}
"""Source of each part, by who needs it. `analysis.graph.network` are the equations' nodes and edges, not neurons."""


@dataclass(frozen=True)
class Counted:
    """What can be counted: learnt numbers, of all members for networks; states; tests."""

    equations: int
    networks: int
    of_a_member: int
    equation_states: int
    network_states: int
    tests: int


def counted(model: Model) -> Counted:
    """Of the calibrated equations and of networks of the usual recipe for the same tests."""
    bank, layout = build_bank(model), layout_of(model, None)
    networks = Networks(layout, DEFAULT, DEFAULT.members)
    learnt = sum(parameter.numel() for parameter in networks.parameters())
    return Counted(
        equations=len(model.calibrated),
        networks=learnt,
        of_a_member=learnt // DEFAULT.members,
        equation_states=sum(len(generator.states) for generator in bank.generators),
        network_states=len(layout.states),
        tests=len(bank.tests),
    )


def lines(places: Sequence[str]) -> int:
    """Lines that are not empty, docstrings and comments among them: somebody wrote those as well."""
    files = [f for place in map(Path, places) for f in ([place] if place.is_file() else sorted(place.rglob("*.py")))]
    return sum(bool(line.strip()) for file in files for line in file.read_text().splitlines())


def calibration_cpu_s(folder: Path) -> float:
    """CPU time [s] of calibrating the equations on a training recording of the bench."""
    given = ["record", "--cycle", "training", "--kind", "instrumented", "--profile", "ideal", "--seed", "1"]
    given += ["--duration", str(RECORDING_S), "--id", "training"]
    must(rig, [*given, "--out", str(folder / "logs"), "--truth", str(folder / "truth")])
    busy = time.process_time()
    must(calibrate, ["uds", str(folder / "logs" / "training"), "--out", str(folder / "model.toml")])
    return time.process_time() - busy


def adapted(record: Record) -> str:
    """What a short recording of another vehicle made of the networks' errors there."""
    errors = record["errors"]
    worse = sum(errors["adapted"][test] > before for test, before in errors["as they are"].items())
    return f"{record['seconds']:.0f} s made {worse} of {len(errors['adapted'])} tests worse, in the one trial measured"


def page(records: Sequence[Record], count: Counted, calibration_s: float) -> str:
    """The page, as Markdown."""
    compared = [r for r in records if r["kind"] == "compared"]
    training_s = statistics.median(r["cpu_s"] for r in compared)
    ratios = [t["networks"] / t["equations"] for r in compared for t in r["judged"]["drive"].values()]
    whole = statistics.median(r["cpu_s"] for r in records if r["kind"] == "whole")
    [fewer] = [r for r in records if r["kind"] == "transfer" and r["seconds"] == FEWER_S]
    rows = [
        ("fault-free data to make them", f"{RECORDING_S:.0f} s", f"{RECORDING_S:.0f} s"),
        ("further data to tune them", "two drives", "the same"),
        ("adapted to another vehicle", "-", adapted(fewer)),
        ("CPU time", f"{calibration_s:.0f} s", f"{training_s:.0f} s ({len(compared)} trainings, median)"),
        ("CPU time for another vehicle", "the same, calibrated anew", f"{fewer['cpu_s']['adapted']:.0f} s, adapted"),
        ("CPU time by the thesis' recipe", "-", f"{whole:.0f} s a test and member"),
        (
            f"learnt numbers, {count.tests} tests",
            f"{count.equations}",
            f"{count.networks}: {DEFAULT.members} members of {count.of_a_member}",
        ),
        ("states", f"{count.equation_states}", f"{count.network_states}"),
        ("formulas to write", "all equations", "none: who is in which equation"),
        (
            "error on a drive, networks over equations",
            "1",
            f"{statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})",
        ),
        ("what they say of faults", "how residuals move, by size", "that a test does not fit"),
    ]
    told = ["| | calibrated equations | grey-box networks |", "|---|---|---|"]
    told += [f"| {what} | {equations} | {networks} |" for what, equations, networks in rows]
    code = ["| needed by | part | lines |", "|---|---|---|"]
    for who, parts in PARTS.items():
        code += [f"| {who} | {part} | {lines(places)} |" for part, places in parts.items()]
        code.append(f"| **{who}** | | **{sum(lines(places) for places in parts.values())}** |")
    return "\n".join([HEAD, *told, "", "Lines of source, empty ones apart:", "", *code, ""])


HEAD = """# What both kinds of generators cost to develop

The third question of the thesis: is a network for each test less work than equations that must be calibrated? Counted
and measured on our own code and **simulated** recordings (`tests/campaigns/effort.py`, `make campaign-training`). Hours
of an engineer are not here: nobody has measured them. The networks are grey boxes: they need the same structural model,
with names in place of formulas.
"""


def main() -> None:
    """Measures what is not in the results yet, and writes the page."""
    start, commit = time.monotonic(), head_commit()
    records = [json.loads(line) for line in (RESULTS / "grey-box.jsonl").read_text().splitlines()]
    with tempfile.TemporaryDirectory() as folder:
        measured = calibration_cpu_s(Path(folder))
    text = page(records, counted(load_model("uds")), measured)
    code = digest("analysis", "training", "testbench")
    text += f"\nCode {code}; trainings of the commits {', '.join(sorted({r['commit'] for r in records}))}. "
    (RESULTS / "effort.md").write_text(text + provenance(commit, time.monotonic() - start) + "\n")


if __name__ == "__main__":
    main()

"""The main job end to end, and the README's commands on what it made."""

import json
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from faultline.service.core.decision.decision import RANKING

FAULTLINE = str(Path(sys.executable).with_name("faultline"))
ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()
PAGES = README + (ROOT / "docs" / "structural-analysis.md").read_text()
BLOCKS = re.findall(r"```sh\n(.*?)```", PAGES, flags=re.DOTALL)
pytestmark = pytest.mark.alone  # two of the demo's recordings go over a bus
COMMANDS = [line for block in BLOCKS for line in block.splitlines() if line and not line.startswith("#")]


@dataclass(frozen=True)
class Ran:
    """A finished demo: the folder it ran in, its exit code and what it printed."""

    folder: Path
    code: int
    out: str
    err: str


SLOWLY = ("--speed", "8")
"""As a machine that stands still for 50 ms now and then, which some do, is then late by less of the log's time."""


LOOKS = 2 * RANKING.periods
"""Samples by which what refines a diagnosis may come earlier or later over the bus than in the log, as the README says.

A bus that is a few ms late at 8x shifts frames by part of a sample, so that some samples are others; a fault at the
limit of what fits is then listed a look earlier or later (copies of the log with frames held up: 15 samples in 2 of 4).
"""


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    """One run, in a folder of its own, for every test that looks at what it made."""
    folder = tmp_path_factory.mktemp("demo")
    done = subprocess.run(
        [FAULTLINE, "demo", *SLOWLY], cwd=folder, capture_output=True, text=True, check=False, timeout=2400
    )
    return Ran(folder, done.returncode, done.stdout, done.stderr)


def test_it_isolates_both_faults_and_says_so(demo: Ran) -> None:
    assert demo.code == 0, demo.out + demo.err
    [du] = [line for line in demo.out.splitlines() if line.strip().startswith("fA_du from")]
    [t] = [line for line in demo.out.splitlines() if line.strip().startswith("fA_t from")]
    assert "first fA_du, 0 false alarms before" in du
    for line in (du, t):
        found = re.search(r"0 false alarms before, over the bus within (\d+) samples of offline: as promised", line)
        assert found, line
        assert int(found[1]) <= LOOKS, line
    assert "fault-free: 0 false alarms: as promised" in demo.out
    assert "cannot tell: t02" in demo.out
    assert "1. fA_du (dosing unit filter" in demo.out


def test_it_draws_a_picture_of_every_evaluated_recording(demo: Ran) -> None:
    pictures = sorted((demo.folder / "out" / "demo").glob("*.png"))
    assert [path.name for path in pictures] == ["fA_du.png", "fA_t.png", "fault-free.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures)


def test_the_recordings_keep_the_truth_apart(demo: Ran) -> None:
    out = demo.folder / "out" / "demo"
    for folder in [*(out / "bench").iterdir(), *(out / "logs").iterdir()]:
        names = {path.name for path in folder.iterdir()}
        assert not any("truth" in name for name in names)
    bench = tomllib.loads((out / "bench" / "training-1" / "recording.toml").read_text())
    assert bench["kind"] == "bench"
    log = tomllib.loads((out / "logs" / "training-1" / "recording.toml").read_text())
    assert log["kind"] == "instrumented"
    assert "external" not in log


def test_calibration_tuning_and_evaluation_saw_disjoint_data(demo: Ran) -> None:
    origin = json.loads((demo.folder / "out" / "demo" / "bundle" / "manifest.json").read_text())["origin"]
    assert len(origin["calibrate"]) == 1
    assert len(origin["tune"]) == 3
    assert not set(origin["calibrate"]) & set(origin["tune"])


def candidate_changes(events: list[dict[str, Any]]) -> list[tuple[str, list[list[str]], int]]:
    """Transition, candidates (without ranks) and tick of every event that changes the candidates."""
    changes: list[tuple[str, list[list[str]], int]] = []
    for event in events:
        candidates = sorted(diagnosis["faults"] for diagnosis in event["diagnoses"])
        if candidates != (changes[-1][1] if changes else []):
            changes.append((event["transition"], candidates, event["tick"]))
    return changes


@pytest.mark.parametrize("name", ["validation-6-fA_du", "validation-7-fA_t"])
def test_the_live_candidates_are_those_of_the_log(demo: Ran, name: str) -> None:
    """8x over the bus against `diagnose`: the same candidates in the same order, at nearly the same ticks."""
    out = demo.folder / "out" / "demo"
    told = [json.loads(line) for line in (out / f"{name}.events.jsonl").read_text().splitlines()]
    live = [record for record in told if record["schema"] == "faultline.event/1"]
    command = [FAULTLINE, "diagnose", out / "logs" / name, "--bundle", out / "bundle", "--json"]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
    ours, theirs = candidate_changes([json.loads(line) for line in done.stdout.splitlines()]), candidate_changes(live)
    assert [change[:2] for change in ours] == [change[:2] for change in theirs]
    apart = [abs(mine[2] - yours[2]) for mine, yours in zip(ours, theirs, strict=True)]
    refined = [change[0] == "refined" for change in ours]
    assert all(ticks <= (LOOKS if later else 2) for ticks, later in zip(apart, refined, strict=True)), apart


@pytest.mark.parametrize("command", [line for line in COMMANDS if line.startswith(".venv/bin/")])
def test_every_command_of_the_pages_runs(demo: Ran, command: str) -> None:
    words, _, comment = command.partition("  # ")
    arguments = [FAULTLINE, *shlex.split(words)[1:]]
    done = subprocess.run(arguments, cwd=demo.folder, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == (1 if "exits with 1" in comment else 0), done.stdout + done.stderr


def test_the_readmes_make_targets_exist() -> None:
    targets = [line.split()[1] for line in COMMANDS if line.startswith("make ")]
    assert targets[:2] == ["demo", "test"]
    makefile = (ROOT / "Makefile").read_text()
    assert all(re.search(rf"^{target}:", makefile, flags=re.MULTILINE) for target in targets)


def test_the_readme_shows_pictures_and_pages_that_exist() -> None:
    links = re.findall(r"\]\(([^)#]+)\)", README)
    assert any(link.endswith(".png") for link in links)
    missing = [link for link in links if not (ROOT / link).exists()]
    assert missing == []

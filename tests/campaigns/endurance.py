"""How long the service lasts: 25 hours of log time, 10 million mutated frames, a flood: `make campaign-endurance`.

In processes of their own, and the flood in a guest with a real CAN bus; a page of what they said of themselves.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from results_page import head_commit, provenance

GUEST = Path(__file__).resolve().parents[1] / "guest"
ENDURED = Path(__file__).with_name("endured.py")
FOREIGN = 8000
"""Frames a second: four times a full bus of 250 kbit/s."""
SETTLED = 0.1
"""The first part of a run is not looked at for what grows: what is made once is made then."""


class Said(NamedTuple):
    """What the other parts said of themselves."""

    refused: str
    rate: str
    flooded: str


class Run(NamedTuple):
    """What a process said of itself at `at` (K,) [h or frames]: memory (K,) [MiB] and descriptors (K,)."""

    at: np.ndarray[tuple[int], np.dtype[np.float64]]
    rss: np.ndarray[tuple[int], np.dtype[np.float64]]
    descriptors: np.ndarray[tuple[int], np.dtype[np.int64]]
    cpu_s: float

    @property
    def later(self) -> "Run":
        """Once what is made once has been made."""
        late = self.at > SETTLED * self.at[-1]
        return Run(self.at[late], self.rss[late], self.descriptors[late], self.cpu_s)

    @property
    def slope(self) -> float:
        """Of the memory [MiB per unit of `at`]."""
        return float(np.polyfit(self.later.at, self.later.rss, 1)[0])


def run(*words: str) -> Run:
    """A run of `endured.py`; raises where it fails."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, str(ENDURED), *words]
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"endured.py {' '.join(words)}: {done.returncode}\n{done.stderr[-4000:]}")
    said = [json.loads(line) for line in done.stderr.splitlines() if line.startswith("{")]
    at, rss, descriptors = (np.array([each[name] for each in said]) for name in ("at", "rss_mib", "descriptors"))
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return Run(at, rss, descriptors, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)


def line_rate(seconds: float, foreign: int) -> str:
    """What becomes of so many foreign frames a second beside ours on this machine; raises where one of ours is lost."""
    command = [sys.executable, str(ENDURED), "rate", str(seconds), str(foreign)]
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=True)
    said = json.loads(done.stderr.splitlines()[-1])
    if said["full"] or said["taken"] != said["wanted"]:
        raise RuntimeError(f"frames were lost: {said}")
    beside = f"{said['ours'] - said['wanted']} that the bundle does not use and {said['foreign']} foreign ones"
    return f"none of {said['wanted']}, beside {beside}; {100 * said['share']:.1f} % of a core"


def flood(seconds: float) -> str:
    """What the guest says of so many seconds of all that it can send; raises where a frame of ours was lost."""
    sys.path.insert(0, str(GUEST))
    from machine import prepared

    with TemporaryDirectory() as folder:
        guest = prepared(Path(folder))
        failed = guest.run(GUEST / "on_the_vehicle.py", "flood", f"{seconds:g}")
        told = [json.loads(line) for line in guest.said.splitlines()]
        if failed:
            raise RuntimeError(guest.said)
        return next(str(step["said"]) for step in told if step["step"] == "flooded")


def hostile(seeds: int) -> str:
    """What pytest says of so many damaged bundles and configurations of each kind; raises where one got through."""
    root = GUEST.parents[1]
    files = ("service/bundle/test_random", "service/daemon/test_config", "analysis/graph/test_graph_file")
    tests = [f"tests/{file}.py" for file in (*files, "analysis/graph/test_hostile_bundle")]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests]
    done = subprocess.run(
        command, cwd=root, env={**os.environ, "SEEDS": str(seeds)}, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(done.stdout[-4000:])
    return done.stdout.splitlines()[-1].strip("= ")


def page(soaked: Run, fuzzed: Run, seed: int, said: Said, commit: str) -> str:
    """The results."""
    soak, fuzz = soaked.later, fuzzed.later
    rows = [
        (f"{soaked.at[-1]:.0f} hours: resident memory at most", "110 MB", f"{1.048576 * soaked.rss.max():.0f} MB"),
        ("its slope, after the first tenth", "under 1 MiB/h", f"{soaked.slope:+.4f} MiB/h"),
        ("descriptors", "constant", f"{soak.descriptors.min()} to {soak.descriptors.max()}"),
        ("seconds of computing for an hour", "-", f"{soaked.cpu_s / soaked.at[-1]:.1f}"),
        (f"{fuzzed.at[-1]:.0f} mutated frames (seed {seed}): exceptions", "none", "none"),
        ("resident memory: growth after the first tenth", "bounded", f"{fuzz.rss[-1] - fuzz.rss[0]:+.2f} MiB"),
        ("damaged bundles and configurations: refused in one line, or the same", "100 %", f"100 %; {said.refused}"),
        (f"{FOREIGN} foreign frames/s on this machine, none filtered: frames of ours lost", "none", said.rate),
        ("as many foreign frames as the guest can send: frames of ours lost", "none", f"none; {said.flooded}"),
    ]
    lines = [
        "# How long the service lasts",
        "",
        "Made by `make campaign-endurance` on the golden recording (**simulated**) and its bundle, in own processes.",
        provenance(commit, soaked.cpu_s + fuzzed.cpu_s),
        "",
        "| | wanted | measured |",
        "|---|---|---|",
        *(f"| {what} | {wanted} | {measured} |" for what, wanted, measured in rows),
        "",
        "*Soak*: the daemon's loop with the bundle, a subscriber and a bus that gives the recording of 2 min, with its",
        "fault, over and over; a frame's time is log time. *Fuzz*: recorded frames with wrong bytes, of other lengths,",
        "of other senders, and frames of any identifier, length and content; times that jump by up to 100 s, back too.",
        "*Damaged*: bits flipped and files cut short in every file of a bundle; nonsense in a manifest, golden vectors",
        "and graph that are sealed anew; hostile graphs (loops, constants that are huge, data in other files, links,",
        "functions); configurations with wrong bytes.",
        "*Flood*: User-Mode Linux, a virtual bus, `cangen` without a gap; first the same time without it.",
    ]
    return "\n".join([*lines, ""])


def main() -> None:
    """Runs all and writes the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=25.0)
    parser.add_argument("--frames", type=int, default=10_000_000)
    parser.add_argument("--flood", type=float, default=60.0, help="seconds")
    parser.add_argument("--seeds", type=int, default=2000, help="damaged bundles of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("docs/results/endurance.md"))
    options = parser.parse_args()
    commit = head_commit()
    soaked = run("soak", str(options.hours))
    fuzzed = run("fuzz", str(options.frames), str(options.seed))
    said = Said(hostile(options.seeds), line_rate(options.flood, FOREIGN), flood(options.flood))
    text = page(soaked, fuzzed, options.seed, said, commit)
    options.out.write_text(text)
    print(text)


if __name__ == "__main__":
    main()

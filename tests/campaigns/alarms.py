"""Alarms through kills: is each in the store, and told to every kind of subscriber? Writes docs/results/alarms.md."""

import argparse
import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from alarmed import Outcome, killed
from results_page import head_commit, provenance

PAGE = Path(__file__).resolve().parents[2] / "docs" / "results" / "alarms.md"
TARGET_MS = 100.0


def table(outcome: Outcome) -> list[str]:
    """What each kind of subscriber heard."""
    rows = ["| subscriber | records | different | in the store and never heard | heard and not in the store |"]
    rows.append("|---|---|---|---|---|")
    for kind, heard in outcome.heard.items():
        different = len({each.id for each in heard})
        rows.append(f"| {kind} | {len(heard)} | {different} | {outcome.missing(kind)} | {outcome.unknown(kind)} |")
    return rows


def delays(outcome: Outcome) -> list[str]:
    """From the number of a record, before the disk, to the subscriber."""
    rows = ["| subscriber | records | median [ms] | 99 % [ms] | longest [ms] |", "|---|---|---|---|---|"]
    for kind, heard in outcome.heard.items():
        ms = 1e3 * np.array([each.delay_s for each in heard[1:]])  # the first were told before it asked
        rows.append(f"| {kind} | {len(ms)} | {np.median(ms):.1f} | {np.percentile(ms, 99):.1f} | {ms.max():.1f} |")
    return rows


def page(outcome: Outcome, quiet: Outcome, seed: int, commit: str, seconds: float) -> str:
    """The page."""
    kills = ", ".join(f"{name} {count}" for name, count in outcome.kills.items())
    lost = sum(outcome.missing(kind) + outcome.unknown(kind) for kind in outcome.heard)
    return "\n".join(
        [
            "# Alarms through kills",
            "",
            "The daemon with its store, `faultline mqtt` with mosquitto, and `faultline serve` on one machine; the",
            "golden recording is played over and over at twenty times its speed, so that something is told every",
            "second or so. Then one process after another is killed (`kill -9`) at random instants and started again.",
            "A subscriber of each kind connects again and asks for what came after the last id that it has. The broker",
            "and the subscribers stay. Simulated data.",
            "",
            f"**{sum(outcome.kills.values())} kills ({kills}), {len(outcome.stored)} records in the store: "
            f"{lost} lost.** "
            f"Seed {seed}.",
            "",
            *table(outcome),
            "",
            "Undisturbed, from when a record gets its number (before it is on the disk) to the subscriber:",
            "",
            *delays(quiet),
            "",
            provenance(commit, seconds),
            "",
        ]
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--undisturbed", type=float, default=120.0, metavar="S")
    parser.add_argument("--seed", type=int, default=int.from_bytes(os.urandom(4)))
    parser.add_argument("--out", type=Path, default=PAGE)
    options = parser.parse_args()
    commit, begin = head_commit(), time.monotonic()
    print(f"seed {options.seed}", file=sys.stderr)
    with TemporaryDirectory() as folder, TemporaryDirectory() as other:
        outcome = killed(Path(folder), options.kills, options.seed)
        quiet = killed(Path(other), 0, options.seed, options.undisturbed)
    text = page(outcome, quiet, options.seed, commit, time.monotonic() - begin)
    options.out.write_text(text)
    print(text)
    return 0 if not sum(outcome.missing(kind) + outcome.unknown(kind) for kind in outcome.heard) else 1


if __name__ == "__main__":
    sys.exit(main())

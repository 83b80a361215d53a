"""Logs in numbers (`make campaign-logs`): formats written by others, damage, cost and memory; docs/results/logs.md.

The log is the golden one, simulated. Each format is written by python-can, not by faultline, where it writes it.
"""

import gzip
import random
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import can
from results_page import head_commit, provenance

from faultline.service.logs import LogError, open_any
from faultline.service.logs.batch import Batch

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "service" / "logs"))
from test_fuzz import damaged

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = ROOT / "tests" / "golden" / "log" / "can.log"
VEHICLE = ROOT / "out" / "vehicle-environment"
PAGE = ROOT / "docs" / "results" / "logs.md"
ENDINGS = {"candump": "log", "ASC": "asc", "BLF": "blf", "TRC": "trc", "CSV": "csv", "SQLite": "db", "MF4": "mf4"}
TRIES = 100

Frames = Counter[tuple[int, bytes]]


def written(folder: Path) -> dict[str, Path]:
    """The golden log in each format, by python-can."""
    found = {}
    for name, ending in ENDINGS.items():
        found[name] = folder / f"x.{ending}"
        with can.LogReader(GOLDEN) as reader, can.Logger(found[name]) as logger:
            for message in reader:
                logger(message)
            if name == "SQLite":
                time.sleep(5.0)  # it is written by a thread, which its end does not wait for
    return found


def frames_of(path: Path) -> tuple[Frames, bool]:
    """The frames of a log by identifier and data, and whether anything is said to be lost."""
    log = open_any(path)
    lost = log.report.lost or bool(log.report.remote or log.report.errors)
    return Counter(each for batch in log.batches() for each in _pairs(batch)), lost


def _pairs(batch: Batch) -> Iterator[tuple[int, bytes]]:
    return ((frame.can_id, frame.data) for frame in batch.with_data.frames())


def of_format(name: str, path: Path) -> str:
    """A row of the table of formats."""
    with can.LogReader(path) as reader:
        theirs = sum(1 for _ in reader)
    packed = path.with_name(f"{path.name}.gz")
    packed.write_bytes(gzip.compress(path.read_bytes(), 1))
    odd = path.with_name("no-ending")
    odd.write_bytes(path.read_bytes())
    counts = [open_any(each).report.frames for each in (path, packed, odd)]
    return f"| {name} | {theirs} | {' | '.join(map(str, counts))} |"


def of_damage(name: str, path: Path, packed: bool) -> tuple[str, Counter[str]]:
    """A row of the table of damage, and what was silent, by the kind of damage."""
    raw = gzip.compress(path.read_bytes(), 1) if packed else path.read_bytes()
    whole, _ = frames_of(path)
    place = path.with_name(f"damaged.{path.suffix}{'.gz' if packed else ''}")
    outcomes, silent, slowest, kept = Counter[str](), Counter[str](), 0.0, []
    for seed in range(TRIES):
        content, what, _, _ = damaged(raw, random.Random(seed))  # noqa: S311
        place.write_bytes(content)
        start = time.process_time()
        try:
            found, lost = frames_of(place)
        except LogError:
            outcomes["refused"] += 1
            continue
        finally:
            slowest = max(slowest, time.process_time() - start)
        right = (whole & found).total()
        kept.append(right / whole.total())
        outcome = "said" if lost else "no frame is lost" if right == whole.total() == found.total() else "silent"
        outcomes[outcome] += 1
        silent[what] += outcome == "silent"
    middle = sorted(kept)[len(kept) // 2] if kept else 0.0
    cells = [str(outcomes[each]) for each in ("said", "refused", "no frame is lost", "silent")]
    title = f"{name}, gzip" if packed else name
    return f"| {title} | {' | '.join(cells)} | {100 * middle:.1f} % | {slowest:.2f} |", silent


def size_mib(folder: Path) -> float:
    """What a folder takes on the disk."""
    return sum(each.stat().st_size for each in folder.rglob("*") if each.is_file()) / 2**20


def main() -> None:
    """Write the page."""
    commit, start = head_commit(), time.monotonic()
    with TemporaryDirectory() as name:
        logs = written(Path(name))
        formats = [of_format(*each) for each in logs.items()]
        rows, silent = [], Counter[str]()
        for form, path in logs.items():
            for packed in (False, True):
                row, missed = of_damage(form, path, packed)
                rows.append(row)
                silent += Counter({f"{form}{', gzip' if packed else ''}: {what}": n for what, n in missed.items() if n})
    bench = subprocess.run(
        [sys.executable, "-m", "tests.bench_logs"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    unsaid = "; ".join(f"{what} {count}" for what, count in sorted(silent.items())) or "none"
    installed = f"{size_mib(VEHICLE):.0f} MiB" if VEHICLE.exists() else "not made here"
    PAGE.write_text(
        f"""# Logs: formats, damage, cost, memory

Made by `make campaign-logs` of the golden log (simulated), which python-can wrote in each format.
{provenance(commit, time.monotonic() - start)}

## Frames

| format | by python-can | by faultline | packed by gzip | without a name's ending |
|---|---:|---:|---:|---:|
{chr(10).join(formats)}

## Damage

{TRIES} files of each, damaged at random by a seed: cut, a flipped bit, zeros, or 1 to 5,000 bytes put in, removed or
overwritten. *said*: the report counts a loss. *refused*: one line says why it is no log. *silent*: frames are missing
or others, and nothing is said.

| format | said | refused | no frame is lost | silent | right frames, median | slowest, CPU s |
|---|---:|---:|---:|---:|---:|---:|
{chr(10).join(rows)}

Silent by kind: {unsaid}.

## Cost and memory

`python -m tests.bench_logs`: medians of seven interleaved pairs, CPU time; in brackets the least and the most.

```text
{bench.stdout.strip()}
```

The vehicle's environment, with its libraries and faultline: {installed}.
"""
    )


if __name__ == "__main__":
    main()

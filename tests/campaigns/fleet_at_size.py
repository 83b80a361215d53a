"""A fleet of 1,000 vehicles made and diagnosed on two cores, in shards: `make campaign-fleet`.

    .venv/bin/python tests/campaigns/fleet_at_size.py --shards 0 1 2

Eight trucks of the rig (`BUILDS`) are calibrated, tuned and exported by `faultline fleet`, which says what a
vehicle-hour of each command costs. Every vehicle of the fleet is built like one of them, and makes one drive on a day
of its own; one in five gets a large fault on the way. A shard of vehicles is recorded, diagnosed by `faultline fleet
diagnose` and its logs deleted; a line of the results is a shard. What is there of the same code is not made again.
"""

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from by_vehicle import set_of
from diagnosis_cases import Case, request, seed_of
from fleet_at_size_page import page
from pyarrow import parquet
from results_page import digest, head_commit

from faultline.analysis.fleet import tables
from faultline.testbench.bus import load_dbc
from faultline.testbench.faults import Fault
from faultline.testbench.recording import record
from faultline.testbench.sizes import frozen

Record = dict[str, Any]

BUILDS = tuple(range(1101, 1109))
SHARDS, OF_SHARD, SECONDS = 40, 25, 600.0
DRIVES = (2, 3, 4, 5)
JUDGED = {6: None, 7: "fA_t", 8: "fy_p_du"}
"""Further drives of each build, for `evaluate`."""
FAULTY = 0.2
KILLED_IN = 3
"""The shard in which a worker is killed, once some of its drives are done."""
AGAIN = 1
"""The shard that is diagnosed with one process as well, and of which some vehicles are by themselves."""
ALONE = 5
RUN = """
import resource, sys
from faultline.service.cli import main
code = main()
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, file=sys.stderr)  # of itself it is the campaign's, too
sys.exit(code)
"""
RESULTS = Path("docs/results/fleet.jsonl")
WORK = Path("out/campaign-fleet")
FROZEN = ("analysis", "service", "testbench", "training", "dbc", "tests/campaigns/fleet_at_size.py")
FAULTS = {name: large for name, (_, large) in frozen().items()}


class Spent(NamedTuple):
    """Records what a command took: wall clock and CPU time with workers [s], the largest of them [MiB], its exit code.

    `killed` are the workers of it that were killed.
    """

    wall_s: float
    cpu_s: float
    mib: float
    code: int
    killed: tuple[int, ...] = ()


def command(*words: str, kill_once: Callable[[], bool] | None = None) -> Spent:
    """Run `faultline` with these words to its end; kill one of its workers once this is so."""
    began, killed = time.monotonic(), list[int]()
    with subprocess.Popen([sys.executable, "-c", RUN, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as it:
        assert it.stderr is not None
        if kill_once is not None:
            threading.Thread(target=_kill_worker, args=(it.pid, kill_once, killed), daemon=True).start()
        said = it.stderr.read().decode()
        _, status, used = os.wait4(it.pid, 0)
        it.returncode = os.waitstatus_to_exitcode(status)
    if it.returncode not in (0, 1, 2):
        raise SystemExit(f"faultline {' '.join(words)}: {it.returncode}: {said}")
    cpu_s = used.ru_utime + used.ru_stime
    return Spent(time.monotonic() - began, cpu_s, int(said.split()[-1]) / 1024.0, it.returncode, tuple(killed))


def build_drive(number: int, cycle: str, k: int, into: Path, fault: str | None = None) -> Path:
    """A recording of a truck that vehicles are built like; its truth stands beside its folder."""
    wanted = request(number, set_of(number), cycle, seed_of(number, k), SECONDS)
    if fault is not None:
        wanted = replace(wanted, faults=(Fault(fault, FAULTS[fault], SECONDS / 4),))
    return record(wanted, load_dbc(), into, into.parent / "truth", force=True, progress=lambda _: None)[0]


def vehicle_drive(place: tuple[int, Path]) -> tuple[Record, float]:
    """Record the drive of a vehicle; return what is in it, and the CPU time [s]."""
    number, folder = place
    busy = time.process_time()
    build = BUILDS[number % len(BUILDS)]
    rng = np.random.default_rng([number, 37])
    fault = str(rng.choice([*FAULTS])) if rng.uniform() < FAULTY else None
    seed = seed_of(2000 + number // 1000, number % 1000)
    faults = () if fault is None else ((fault, FAULTS[fault]),)
    case = Case(build, set_of(build), "single", "large", faults, seed, SECONDS)
    name = f"fleet-{number:04}"
    wanted = replace(case.request, name=f"{name}-drive", vehicle=replace(case.request.vehicle, name=name))
    record(wanted, load_dbc(), folder / "logs", folder / "truth", force=True, progress=lambda _: None)
    onset = case.onset_s if fault else None
    return {"vehicle": name, "fault": fault, "onset_s": onset}, time.process_time() - busy


def prepare(work: Path, processes: int) -> Record:
    """The bundles of all builds, by the commands themselves, and what each took."""
    if (done := work / "prepared.json").exists():
        return dict(json.loads(done.read_text()))
    with get_context("spawn").Pool(processes) as pool:
        pool.starmap(build_drive, [(number, "training", 1, work / "training") for number in BUILDS])
        pool.starmap(build_drive, [(number, "drive", k, work / "drive") for number in BUILDS for k in DRIVES])
        judged = [(number, "drive", k, work / "judged", fault) for number in BUILDS for k, fault in JUDGED.items()]
        pool.starmap(build_drive, judged)
    made, model = str(work / "made"), str(work / "made" / "vehicle={vehicle}" / "model.toml")
    training, drives = str(work / "training"), str(work / "drive")
    given = ["--out", made, "--processes", str(processes)]
    tuning = str(work / "made" / "vehicle={vehicle}" / "tuning.json")
    bundle = str(work / "made" / "vehicle={vehicle}" / "bundle")
    orders = {
        "calibrate": ["uds", training, *given, "--", "--force"],
        "tune": [model, drives, *given],
        "export": [model, training, *given, "--", "--tuning", tuning],
        "evaluate": [bundle, str(work / "judged"), *given, "--", "--truth", str(work / "truth")],
        "train": [model, str(next((work / "training").iterdir())), *given],
    }
    hours = dict.fromkeys(orders, len(BUILDS)) | {"tune": len(BUILDS) * len(DRIVES), "train": 1}
    hours["evaluate"] = len(BUILDS) * len(JUDGED)
    costs = {}
    for name, words in orders.items():
        spent = command("fleet", name, *words)
        if spent.code:
            raise SystemExit(f"fleet {name}: some build failed; {made}/vehicle=*/{name}.txt says why")
        costs[name] = {**spent._asdict(), "hours": hours[name] * SECONDS / 3600.0}
        print(name, costs[name], flush=True)
    done.write_text(json.dumps(costs))
    return costs


def shard(k: int, work: Path, processes: int) -> Record:
    """Record, diagnose and delete the drives of a shard."""
    folder, numbers = work / f"shard-{k:02}", range(k * OF_SHARD, (k + 1) * OF_SHARD)
    shutil.rmtree(folder, ignore_errors=True)
    began = time.monotonic()
    with get_context("spawn").Pool(processes) as pool:
        made = pool.map(vehicle_drive, [(number, folder) for number in numbers], chunksize=1)
    recorded_s = time.monotonic() - began
    truth = {each["vehicle"]: each for each, _ in made}
    for number, name in zip(numbers, truth, strict=True):
        link = work / "made" / f"vehicle={name}"
        if not link.exists():
            link.symlink_to(f"vehicle=truck-{BUILDS[number % len(BUILDS)]}")
    bundle, out = str(work / "made" / "vehicle={vehicle}" / "bundle"), work / "fleet"
    words = ["fleet", "diagnose", str(folder / "logs"), "--bundle", bundle]

    def done() -> int:
        return sum((out / tables.DRIVES / f"vehicle={name}").exists() for name in truth)

    before = done()  # by an earlier try that was stopped

    def some_are_done() -> bool:
        return done() > before

    kill_once = some_are_done if k == KILLED_IN else None
    spent = command(*words, "--out", str(out), "--processes", str(processes), kill_once=kill_once)
    rows = [row for row in tables.drives(out) if row["vehicle"] in truth]
    found = {row["vehicle"]: _outcome(row) for row in rows}
    outcome = {
        "shard": k,
        "rig_cpu_s": sum(cpu_s for _, cpu_s in made),
        "rig_wall_s": recorded_s,
        "diagnose": spent._asdict(),
        "killed": bool(spent.killed),
        "twice": len(rows) - len(found),
        "vehicles": [{**each, **found.get(name, {"verdict": "lost"})} for name, each in truth.items()],
    }
    if k == AGAIN:
        outcome["one_process"] = command(*words, "--out", str(folder / "one"), "--processes", "1")._asdict()
        outcome["two_processes"] = command(*words, "--out", str(folder / "two"), "--processes", "2")._asdict()
        outcome["differ"] = sum(_differs(name, folder, bundle, out) for name in [*truth][:ALONE])
    shutil.rmtree(folder)
    return outcome


def _kill_worker(parent: int, once: Callable[[], bool], killed: list[int]) -> None:
    """Kill one of the processes that a command has started to work for it, once this is so, and note which."""
    while Path(f"/proc/{parent}").exists():
        if once() and (workers := _workers(parent)):
            os.kill(workers[0], signal.SIGKILL)
            killed.append(workers[0])
            print(f"worker {workers[0]} of {workers} killed", flush=True)
            return
        time.sleep(0.02)


def _workers(parent: int) -> list[int]:
    """The processes that work for a command, as long as it runs."""
    found = []
    with suppress(OSError):
        for each in Path(f"/proc/{parent}/task").glob("*/children"):
            started = map(int, each.read_text().split())
            found += [pid for pid in started if "spawn_main" in Path(f"/proc/{pid}/cmdline").read_text()]
    return found


def _differs(name: str, folder: Path, bundle: str, out: Path) -> bool:
    """Whether `faultline diagnose` of this vehicle's drive writes other events than the fleet has."""
    words = [
        "diagnose",
        str(folder / "logs" / f"{name}-drive"),
        "--bundle",
        bundle.replace("{vehicle}", name),
        "--json",
    ]
    told = subprocess.run([sys.executable, "-c", RUN, *words], capture_output=True, text=True, check=False).stdout
    there = [row for file in (out / tables.EVENTS).glob(f"vehicle={name}/*/*.parquet") for row in events_in(file)]
    return told.splitlines() != [row["event"] for row in sorted(there, key=lambda row: row["seq"])]


def events_in(file: Path) -> list[Record]:
    """The rows of events in a file."""
    return list(parquet.ParquetFile(file).read().to_pylist())


def _outcome(row: Record) -> Record:
    best = row["diagnoses"][0]["faults"] if row["diagnoses"] else []
    first = [fault for each in row["diagnoses"] or [] if each["rank"] == 1 for fault in each["faults"] or ["unknown"]]
    kept = {name: row[name] for name in ("verdict", "occurred_s", "cpu_s", "span_s", "native")}
    return {**kept, "best": best, "first": sorted({*first})}


def main(arguments: Sequence[str] | None = None) -> None:
    """Make what is missing, and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shards", type=int, nargs="+", default=range(SHARDS))
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--page-only", action="store_true", help="make nothing, write the page of what is there")
    options = parser.parse_args(arguments)
    code, commit = digest(*FROZEN), head_commit()
    records = [json.loads(line) for line in RESULTS.read_text().splitlines()] if RESULTS.exists() else []
    there = {each["shard"] for each in records if each["code"] == code}
    work = (WORK / code).absolute()
    for k in [] if options.page_only else [k for k in options.shards if k not in there]:
        costs = prepare(work, options.processes)
        made = {**shard(k, work, options.processes), "costs": costs, "code": code, "commit": commit}
        print(f"shard {k}: {made['rig_cpu_s']:.0f} s of the rig, {made['diagnose']}", flush=True)
        records = sorted([each for each in records if each["shard"] != k] + [made], key=lambda each: each["shard"])
        RESULTS.write_text("".join(json.dumps(each) + "\n" for each in records))
    RESULTS.with_suffix(".md").write_text(page(_same(records)))


def _same(records: Iterable[Record]) -> list[Record]:
    """Those of the code that most are of: results of two versions are not added."""
    every = [*records]
    codes = [each["code"] for each in every]
    return [each for each in every if each["code"] == max({*codes}, key=codes.count)]


if __name__ == "__main__":
    main()

"""Power cuts of a guest while alarms are told: what was lost, and to whom? Writes docs/results/power.md."""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from results_page import head_commit, provenance

sys.path.insert(0, str(Path(__file__).parents[1] / "guest"))
from machine import GOLDEN, Guest, NoGuestError, cut_power, environment, prepared

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PAGE = ROOT / "docs" / "results" / "power.md"
SCRIPT = HERE / "power_guest.py"
BESIDE = (ROOT / "tests" / "guest" / "on_the_vehicle.py", ROOT / "tests" / "service" / "mqtt" / "mqtt_fake_broker.py")
KINDS = {"socket": "socket", "SSE": "sse", "MQTT": "mqtt"}
SPEED = 20.0
CUT_S = (2.0, 25.0)
"""The power is cut so long after everything runs."""
READY_S, END_S = 300.0, 500.0
FIRST_S = 1767225600.0
"""Of the golden recording."""
FORGOTTEN = ("aged", "displaced")


class Life(NamedTuple):
    """Of the machine, from its boot to the cut."""

    cut_after_s: float
    heard: dict[str, int]
    """How many records each kind of subscriber heard."""
    alarms: int
    """How many of them told of an alarm, to whoever heard most of those."""
    torn: int
    """Lines that the cut has torn: they were not heard."""


class Outcome(NamedTuple):
    """What is in the store, and what each kind of subscriber heard, oldest first."""

    stored: list[dict[str, Any]]
    heard: dict[str, list[dict[str, Any]]]
    lives: list[Life]
    remembered: list[dict[str, Any]]
    """The faults, by the daemon's word after the last boot."""
    aside: list[str]
    """Damaged stores."""

    @property
    def ids(self) -> set[str]:
        return {each["id"] for each in self.stored}

    def missing(self, kind: str) -> int:
        """Records of the store that a subscriber never heard."""
        return len(self.ids - {each["id"] for each in self.heard[kind]})

    def unknown(self, kind: str) -> int:
        """What a subscriber heard that is not in the store."""
        return len({each["id"] for each in self.heard[kind]} - self.ids)

    def changed(self, kind: str) -> int:
        """What a subscriber heard otherwise than it is in the store."""
        stored = {each["id"]: each for each in self.stored}
        return sum(stored.get(each["id"], each) != each for each in self.heard[kind])

    def twice(self, kind: str) -> int:
        """How many came again."""
        return len(self.heard[kind]) - len({each["id"] for each in self.heard[kind]})

    def figures(self, kind: str) -> tuple[int, int, int, int, int]:
        """How many it heard, how many of them again, and what is wrong: missing, unknown and changed."""
        return len(self.heard[kind]), self.twice(kind), self.missing(kind), self.unknown(kind), self.changed(kind)

    @property
    def gaps(self) -> int:
        """Numbers that are not in the store, or are there for two records."""
        numbers = [each["seq"] for each in self.stored]
        return len({*range(1, max(numbers, default=0) + 1)} - {*numbers}) + len(numbers) - len(self.ids)

    @property
    def forgotten(self) -> int:
        """Faults that are remembered otherwise than the last records tell."""
        told: dict[int, dict[str, Any]] = {}
        for each in self.stored:
            if each["schema"] == "faultline.fault/1":
                told[each["fault"]["number"]] = each["fault"]
                if each["change"] in FORGOTTEN:
                    del told[each["fault"]["number"]]
        now = {each["number"]: each for each in self.remembered}
        return sum(_essence(told.get(number)) != _essence(now.get(number)) for number in {*told, *now})

    @property
    def lost(self) -> int:
        """All that should not be: zero."""
        wrong = sum(sum(self.figures(kind)[2:]) for kind in self.heard)
        return wrong + self.gaps + self.forgotten + len(self.aside)


def _essence(fault: dict[str, Any] | None) -> object:
    """What must outlive a cut: who is suspected, and whether it is confirmed and there."""
    if fault is None:
        return None
    status = fault["status"]
    return fault["system"], fault["diagnoses"], fault["dtcs"], status["confirmed"], status["test_failed"]


def cut(folder: Path, vehicle: Path, cuts: int, seed: int, say: Callable[[str], None] = print) -> Outcome:
    """So many boots that end by a cut at an instant drawn by chance, and one in which all hear what they missed.

    `vehicle` is the environment, which does not change meanwhile.
    """
    chance = np.random.default_rng(seed)
    guest = replace(prepared(folder), environment=vehicle)
    for path in BESIDE:
        shutil.copy(path, guest.share)
    (guest.share / "fast.log").write_text("".join(_faster(SPEED)))
    lives: list[Life] = []
    for turn in range(cuts):
        lives.append(_life(guest, float(chance.uniform(*CUT_S))))
        say(f"{turn + 1} of {cuts}: cut after {lives[-1].cut_after_s:.1f} s, heard {lives[-1].heard}")
    code = guest.run(SCRIPT, "after", f"{SPEED:g}", limit_s=END_S)
    assert code == 0, guest.said
    share = guest.share
    heard = {kind: [_record(line) for line in _lines(share / f"heard-{name}.jsonl")] for kind, name in KINDS.items()}
    stored = [json.loads(line) for line in _lines(share / "store.jsonl")]
    remembered = json.loads((share / "faults.json").read_text())["faults"]
    return Outcome(stored, heard, lives, remembered, json.loads((share / "aside.json").read_text()))


def side_by_side(folder: Path, guests: int, cuts: int, seed: int) -> list[Outcome]:
    """The cuts shared among guests, each with a disk of its own and the next seed."""

    vehicle = with_web()

    def one(number: int) -> Outcome:
        own = folder / f"guest-{number}"
        own.mkdir()
        share = cuts // guests + (number < cuts % guests)
        return cut(own, vehicle, share, seed + number, lambda said: print(number, said, file=sys.stderr, flush=True))

    with ThreadPoolExecutor(guests) as pool:
        return [*pool.map(one, range(guests))]


def with_web() -> Path:
    """The vehicle's environment with what `faultline serve` needs."""
    folder = environment(ROOT / "out" / "vehicle-environment-web")
    (packages,) = folder.glob("lib/python3*/site-packages")
    if not (packages / "uvicorn").exists():
        pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--quiet"]
        pip += ["--constraint", str(ROOT / "constraints.txt"), "--target", str(packages)]
        subprocess.run([*pip, "starlette", "uvicorn", "h11"], check=True)
    return folder


def _faster(speed: float) -> Iterator[str]:
    """The golden recording, with so many times its speed in its stamps."""
    for line in (GOLDEN / "log" / "can.log").read_text().splitlines():
        stamp, rest = line.split(maxsplit=1)
        yield f"({FIRST_S + (float(stamp.strip('()')) - FIRST_S) / speed:.6f}) {rest}\n"


def _life(guest: Guest, seconds: float) -> Life:
    """One boot, until the power is cut so long after everything runs [s]."""
    files = {kind: guest.share / f"heard-{name}.jsonl" for kind, name in KINDS.items()}
    before = {kind: len(_lines(path)) for kind, path in files.items()}
    ready = guest.share / "ready"
    ready.unlink(missing_ok=True)
    process = guest.start(SCRIPT, "cut", f"{SPEED:g}")
    try:
        end = time.monotonic() + READY_S
        while not ready.exists():
            assert process.poll() is None, guest.said
            assert time.monotonic() < end, guest.said
            time.sleep(0.05)
        time.sleep(seconds)
        assert process.poll() is None, guest.said
    finally:
        cut_power(process)
    torn = sum(_taken_off(path) for path in files.values())
    new = {kind: [_record(line) for line in _lines(path)[before[kind] :]] for kind, path in files.items()}
    alarms = max(sum(each.get("transition") == "occurred" for each in records) for records in new.values())
    return Life(seconds, {kind: len(records) for kind, records in new.items()}, alarms, torn)


def _lines(path: Path) -> list[bytes]:
    return path.read_bytes().splitlines() if path.exists() else []


def _record(line: bytes) -> dict[str, Any]:
    said: dict[str, Any] = json.loads(line)
    record: dict[str, Any] = said.get("data", said)  # of a CloudEvent
    return record


def _taken_off(path: Path) -> int:
    """Takes off the end of a file that is no whole line; how many there were, one or none."""
    content = path.read_bytes() if path.exists() else b""
    whole = content.rfind(b"\n") + 1
    if whole == len(content):
        return 0
    os.truncate(path, whole)
    return 1


def table(outcomes: Sequence[Outcome]) -> list[str]:
    """What each kind of subscriber heard."""
    rows = [
        "| subscriber | records | different | came again | in the store and never heard | heard and not in the store |"
    ]
    rows[0] += " heard otherwise |"
    rows.append("|---|---|---|---|---|---|---|")
    for kind in KINDS:
        heard, twice, *wrong = (
            sum(figures) for figures in zip(*(each.figures(kind) for each in outcomes), strict=True)
        )
        rows.append(f"| {kind} | {heard} | {heard - twice} | {twice} | {' | '.join(map(str, wrong))} |")
    return rows


def page(outcomes: Sequence[Outcome], seed: int, commit: str, seconds: float) -> str:
    """The page."""
    lives = [life for each in outcomes for life in each.lives]
    stored = [record for each in outcomes for record in each.stored]
    lost = sum(each.lost for each in outcomes)
    kinds = Counter(each.get("transition") or each["schema"].partition("/")[0] for each in stored)
    held = ", ".join(f"{count} `{name}`" for name, count in kinds.most_common())
    told, alarmed = sum(any(life.heard.values()) for life in lives), sum(bool(life.alarms) for life in lives)
    return "\n".join(
        [
            "# Alarms through power cuts",
            "",
            "A guest with its own kernel, CAN bus and systemd (User-Mode Linux), on which `faultline install` has",
            "set up the daemon, `faultline-mqtt` and `faultline-web` with their hardened units; the golden recording",
            "is played on the bus over and over at twenty times its speed. Some seconds after everything runs",
            f"({CUT_S[0]:.0f} to {CUT_S[1]:.0f} by chance) the machine's process is killed, which takes its memory,",
            "its page cache and all of its processes away; the disk stays as its kernel had written it. In the last",
            "boot nothing is played, and everybody may catch up. A subscriber of each kind has on the host's disk",
            "what it hears before it goes on; after a cut it asks for what came after the last record that it has.",
            "That of MQTT is the broker, outside of the vehicle: it writes before it acknowledges, as one that",
            "persists does. Simulated data.",
            "",
            f"**{len(lives)} cuts of {len(outcomes)} guests, {len(stored)} records in the store: {lost} lost.** "
            f"Seed {seed}.",
            "",
            *table(outcomes),
            "",
            "| | |",
            "|---|---|",
            f"| boots in which something was told before the cut | {told} of {len(lives)} |",
            f"| boots in which a fault was confirmed (`occurred`) before the cut | {alarmed} of {len(lives)} |",
            f"| records in the store | {held} |",
            f"| numbers that are missing or there twice | {sum(each.gaps for each in outcomes)} |",
            f"| remembered faults after the last boot | {sum(len(each.remembered) for each in outcomes)} |",
            f"| of them, otherwise than their last records say | {sum(each.forgotten for each in outcomes)} |",
            f"| stores found damaged | {sum(len(each.aside) for each in outcomes)} |",
            f"| lines of subscribers that the cut tore (not heard) | {sum(life.torn for life in lives)} |",
            "",
            "What this is not: the host's kernel lives on, so that a disk which loses what it said to have written",
            "is not in it; nor is a daemon that is killed as it starts. The units are as installed, but that the",
            "daemon is told the bus's speed, may take the whole of the guest's one processor, and has a watchdog of",
            "60 s, and that all three are told where the guest's Python has its library.",
            "",
            provenance(commit, seconds),
            "",
        ]
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cuts", type=int, default=20)
    parser.add_argument(
        "--guests", type=int, default=2, help="side by side, each with a share of the cuts (default: 2)"
    )
    parser.add_argument("--seed", type=int, default=int.from_bytes(os.urandom(4)))
    parser.add_argument("--keep", type=Path, metavar="DIR", help="a new folder for what was heard; default: none")
    parser.add_argument("--out", type=Path, default=PAGE)
    options = parser.parse_args()
    commit, begin = head_commit(), time.monotonic()
    print(f"seed {options.seed}", file=sys.stderr)
    with TemporaryDirectory() as scratch:
        folder = options.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        try:
            outcomes = side_by_side(folder, options.guests, options.cuts, options.seed)
        except NoGuestError as error:
            print(error, file=sys.stderr)
            return 2
    text = page(outcomes, options.seed, commit, time.monotonic() - begin)
    options.out.write_text(text)
    print(text)
    return 1 if sum(each.lost for each in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())

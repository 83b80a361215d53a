"""Hours of fault-free driving on the campaign's vehicles: `make campaign-false-alarms HOURS=25`.

    SHARD=1/4 EFFECTS=A HOURS=25 .venv/bin/python tests/campaigns/false_alarms.py

Each drive lasts an hour, on a day of its own, and goes from the rig into the monitor without a log being written. A
line of the results is an hour; sessions add to it until every vehicle has as many hours as asked for.
"""

import argparse
import json
import os
import time
from collections import Counter
from collections.abc import Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import msgspec
from diagnosis import FROZEN, RESULTS, add_options, kept, numbers_of, workshops
from diagnosis_cases import Case, Set
from diagnosis_shop import Workshop, said, sent, watched
from results_page import digest, head_commit

from faultline.service.core.errors import InputError

Record = dict[str, Any]

DRIVE_S = 3600.0
SEEDS = 10_000_000
"""Beyond those of the recordings that are judged or tuned on."""


def hour(shop: Workshop, number: int, seconds: float = DRIVE_S) -> Record:
    """The `number`-th fault-free drive of a vehicle: diagnoses told, suspicions, and how often each test alarmed."""
    busy = time.process_time()
    bundle = shop.bundle()
    seed = SEEDS + 1000 * shop.number + number
    case = Case(shop.number, shop.effects_set, "free", "", (), seed, seconds)
    seen = watched(bundle, case.name, sent(case))
    occurred = [(t, event) for t, event in seen.events if event.transition == "occurred"]
    return {
        "vehicle": shop.number,
        "set": shop.effects_set,
        "hour": number,
        "seconds": seconds,
        "false": [[round(t, 1), [said(d)[0] for d in event.diagnoses if d.rank == 1]] for t, event in occurred],
        "suspected": [round(t, 1) for t, event in seen.events if event.transition == "suspected"],
        "alarms": dict(Counter(test for _, test in seen.alarms)),
        "cannot_tell": round(float(seen.blind.mean()), 4),
        "cpu_s": round(time.process_time() - busy, 1),
    }


def kept_in(effects_set: Set, results: Path = RESULTS) -> Path:
    """The file of a set's hours."""
    return results / f"false-alarms-{effects_set}.jsonl"


def _hour(asked: tuple[Workshop, int]) -> Record:
    return hour(*asked)


def main(arguments: Sequence[str] | None = None) -> None:
    """Drives what is missing, and writes the page."""
    from diagnosis_page import write_page

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_options(parser)
    parser.add_argument("--hours", type=int, default=int(os.environ.get("HOURS", "25")), help="of each vehicle")
    options = parser.parse_args(arguments)
    path, code = kept_in(options.effects, options.results), digest(*FROZEN)
    stamp = {"commit": head_commit(), "code": code, "tuning": options.tuning}
    same = [record for record in kept(path) if (record["code"], record["tuning"]) == (code, options.tuning)]
    there = {(record["vehicle"], record["hour"]) for record in same}
    shops = workshops(numbers_of(options), options.effects, code, options.tuning)
    with get_context("spawn").Pool(options.processes) as pool:
        made = pool.map(_made, shops)  # each once, before two processes want the same
        served = [shop for shop, is_made in zip(shops, made, strict=True) if is_made]
        wanted = [(s, k) for k in range(options.hours) for s in served if (s.number, k) not in there]
        for record in pool.imap_unordered(_hour, wanted):
            with path.open("ab") as out:
                out.write(msgspec.json.encode({**record, **stamp}) + b"\n")
            print(json.dumps({name: record[name] for name in ("vehicle", "hour", "false", "cpu_s")}), flush=True)
    write_page(options.results)


def _made(shop: Workshop) -> bool:
    """Whether there is a bundle; one that the workshop's tuning refuses is not put into service."""
    try:
        shop.bundle()
    except InputError as error:
        print(f"truck-{shop.number} is left out: {error}", flush=True)
        return False
    return True


if __name__ == "__main__":
    main()

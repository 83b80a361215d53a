"""What is told of faults on vehicles whose thresholds nobody tuned by hand: `make campaign-diagnosis`.

    SHARD=1/4 EFFECTS=A .venv/bin/python tests/campaigns/diagnosis.py --vehicles 401 402 --faults fA_du

Every vehicle is a truck of the rig's fleet (profile `everyday`, with hidden effects of its own): calibrated on one
training recording and tuned as a workshop would (`diagnosis_shop.tuning`), then judged on other drives: fault-free
ones, and each fault of the frozen list, small and large, pairs of faults, and a curve over size. Nothing of a judged
recording was used before. A line of the results is a vehicle; what is there of the same code and tuning is not made
again. With `--faults` the results go to a file of their own, and no page is written of them.
"""

import argparse
import json
import os
import time
from collections.abc import Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any, get_args

import diagnosis_plants
import msgspec
from diagnosis_cases import PLANTS, VEHICLES, VEHICLES_C, Case, Set, cases, hidden
from diagnosis_limit import limit_of
from diagnosis_shop import Workshop, run_of, sent, told_of, watched
from diagnosis_visible import changes
from results_page import digest, head_commit

from faultline.service.bundle.load import Bundle
from faultline.service.core.errors import InputError

Record = dict[str, Any]

RESULTS = Path("docs/results")
WORK = Path("out/campaign-diagnosis")
"""Bundles and series of residuals, by the code that made them; not in git."""
WAYS = ("own", "adapted")
"""A vehicle is tuned on drives of its own, or adapts the tuning of the reference vehicles."""
_OWN = (f"tests/campaigns/diagnosis_{name}.py" for name in ("cases", "plants", "shop", "reference"))
FROZEN = ("analysis", "service", "testbench", "dbc", *_OWN)


def workshops(numbers: Sequence[int], effects_set: Set, code: str, way: str) -> list[Workshop]:
    """Those of the vehicles, as this code makes them; the reference tuning, if they adapt one, is made first."""
    base = None
    if way == "adapted":
        from diagnosis_reference import reference

        base = reference(WORK / code)
    root = folder_of(effects_set, code, way)
    return [Workshop(number, effects_set, root / f"truck-{number}", base=base) for number in numbers]


def folder_of(effects_set: Set, code: str, way: str) -> Path:
    """Where the vehicles of a campaign have what they made."""
    return WORK / code / f"{effects_set}-{way}"


def numbers_of(options: argparse.Namespace) -> list[int]:
    """The vehicles of this part."""
    own = VEHICLES_C if options.effects == "C" else VEHICLES
    return shard(options.vehicles or own, options.shard)


def add_options(parser: argparse.ArgumentParser) -> None:
    """What both campaigns are asked."""
    parser.add_argument("--effects", choices=get_args(Set), default=os.environ.get("EFFECTS", "A"))
    parser.add_argument("--shard", default=os.environ.get("SHARD", "1/1"), help="i/n: this part of the vehicles")
    parser.add_argument("--vehicles", type=int, nargs="+", help="their numbers; those of the set where none are given")
    parser.add_argument("--tuning", choices=WAYS, default=os.environ.get("TUNING", WAYS[0]), help="how it is tuned")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--results", type=Path, default=RESULTS)


def vehicle(shop: Workshop, wanted: Sequence[Case]) -> Record:
    """All recordings of one vehicle; none where the workshop's tuning refuses it: it is not put into service."""
    start, busy = time.monotonic(), time.process_time()
    bundle, refused = None, None
    free = [case for case in wanted if case.kind == "free"]
    try:
        bundle = shop.bundle()
    except InputError as error:
        refused = str(error)
    return {
        "vehicle": shop.number,
        "set": shop.effects_set,
        "effects": hidden(shop.number, shop.effects_set),
        "doubts": shop.doubts,
        "refused": refused,
        "claim": None if bundle is None else shop.claim,
        "limit": None if bundle is None else limit_of(bundle, [sent(case) for case in free]),
        "judged": [] if bundle is None else [_judged(shop, bundle, case) for case in wanted],
        "wall_s": round(time.monotonic() - start, 1),
        "cpu_s": round(time.process_time() - busy, 1),
    }


def _judged(shop: Workshop, bundle: Bundle, case: Case) -> Record:
    seen = watched(bundle, case.name, sent(case))
    seen.save(shop.folder / "series" / f"{case.name}.npz")
    told = told_of(case, seen, bundle.manifest.period_s)
    if case.kind != "pair" and "fA_p" in dict(case.faults):
        told["changes"] = _changes(case)
    return told


def _changes(case: Case) -> bool:
    """Whether the fault changes anything that is measured."""
    if case.number in PLANTS:
        return diagnosis_plants.changes(case)
    return changes(case.request, run_of(case.request), run_of(case.healthy))


def kept_in(effects_set: Set, results: Path = RESULTS, *, part: bool = False) -> Path:
    """The file of a set's results, or of `part` of its cases."""
    return results / f"diagnosis-{effects_set}{'-part' if part else ''}.jsonl"


def kept(path: Path) -> list[Record]:
    """The records that are there."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def is_made(number: int, wanted: Sequence[Case], records: Sequence[Record], code: str, tuning: str) -> bool:
    """Whether a record of the vehicle, made by this code with this tuning, has all these cases."""
    names = {case.name for case in wanted}
    return any(
        (record["vehicle"], record["code"], record["tuning"]) == (number, code, tuning)
        and (record.get("refused") or names <= {told["case"] for told in record["judged"]})
        for record in records
    )


def shard(numbers: Sequence[int], text: str) -> list[int]:
    """The i-th of n parts, for text i/n."""
    i, n = (int(part) for part in text.split("/"))
    return list(numbers)[i - 1 :: n]


def _vehicle(asked: tuple[Workshop, list[Case]]) -> Record:
    return vehicle(*asked)


def main(arguments: Sequence[str] | None = None) -> None:
    """Makes what is missing, and the page."""
    from diagnosis_page import write_page

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_options(parser)
    parser.add_argument("--faults", nargs="+", help="only recordings of these, and fault-free ones: to a file apart")
    parser.add_argument("--page-only", action="store_true", help="make nothing, write the page of what is there")
    options = parser.parse_args(arguments)
    path = kept_in(options.effects, options.results, part=options.faults is not None)
    if not options.page_only:
        code = digest(*FROZEN)
        stamp = {"commit": head_commit(), "code": code, "tuning": options.tuning}
        there = kept(path)
        asked = {number: _wanted(number, options.effects, options.faults) for number in numbers_of(options)}
        missing = [
            number for number in numbers_of(options) if not is_made(number, asked[number], there, code, options.tuning)
        ]
        shops = workshops(missing, options.effects, code, options.tuning)
        wanted = [(shop, asked[shop.number]) for shop in shops]
        options.results.mkdir(parents=True, exist_ok=True)
        with get_context("spawn").Pool(options.processes, maxtasksperchild=1) as pool:
            for record in pool.imap_unordered(_vehicle, wanted):
                with path.open("ab") as out:
                    out.write(msgspec.json.encode({**record, **stamp}) + b"\n")
                print(f"truck-{record['vehicle']}: {record['wall_s']:.0f} s", flush=True)
    if options.faults is None:
        write_page(options.results)


def _wanted(number: int, effects_set: Set, faults: Sequence[str] | None) -> list[Case]:
    """The vehicle's cases, of these faults only where they are given."""
    given = cases(number, effects_set)
    return given if faults is None else [case for case in given if {name for name, _ in case.faults} <= {*faults}]


if __name__ == "__main__":
    main()

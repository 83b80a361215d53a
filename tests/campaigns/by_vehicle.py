"""A campaign whose records are vehicles, one a line: what is there of the same code is not made again."""

import argparse
import json
from collections.abc import Callable, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from diagnosis_cases import Set
from diagnosis_shop import Workshop
from results_page import digest, head_commit

Record = dict[str, Any]


class Campaign(NamedTuple):
    """A campaign: what it is, its vehicles, what makes the record of one, the page of all, and where all that goes.

    `frozen` are the files and folders that the records depend on.
    """

    text: str | None
    vehicles: Sequence[int]
    vehicle: Callable[[Workshop], Record]
    page: Callable[[Sequence[Record]], str]
    results: Path
    work: Path
    frozen: Sequence[str]


def set_of(number: int) -> Set:
    """The hidden effects of a vehicle."""
    return "A" if number % 2 else "B"


def run(campaign: Campaign, arguments: Sequence[str] | None = None) -> None:
    """Makes what is missing, and the page."""
    parser = argparse.ArgumentParser(description=campaign.text, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--vehicles", type=int, nargs="+", default=campaign.vehicles)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--page-only", action="store_true", help="make nothing, write the page of what is there")
    options = parser.parse_args(arguments)
    code, commit, results = digest(*campaign.frozen), head_commit(), campaign.results
    records = [json.loads(line) for line in results.read_text().splitlines()] if results.exists() else []
    there = {record["vehicle"] for record in records if record["code"] == code}
    wanted = [] if options.page_only else [number for number in options.vehicles if number not in there]
    shops = [Workshop(number, set_of(number), campaign.work / code / f"truck-{number}") for number in wanted]
    with get_context("spawn").Pool(options.processes) as pool:
        for record in pool.imap_unordered(campaign.vehicle, shops):
            print(f"truck-{record['vehicle']}: {record['cpu_s']:.0f} s of CPU", flush=True)
            records = [each for each in records if each["vehicle"] != record["vehicle"]]
            records.append({**record, "code": code, "commit": commit})
            records.sort(key=lambda each: each["vehicle"])
            results.write_bytes(b"".join(msgspec.json.encode(each) + b"\n" for each in records))
    results.with_suffix(".md").write_text(campaign.page(records))

"""Diagnose, calibrate, tune, evaluate or train for many vehicles at once, on all cores or a cluster."""

import argparse
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from faultline.analysis.fleet.identity import KINDS
from faultline.analysis.progress import Progress
from faultline.options import Parser
from faultline.service.core.errors import InputError
from faultline.service.distribution import install_command
from faultline.writing import write_file

if TYPE_CHECKING:
    from faultline.analysis.fleet.vehicles import Order

EXAMPLE = """example:
  faultline fleet calibrate uds recordings/ --out made
  faultline fleet tune 'made/vehicle={vehicle}/model.toml' recordings/ --out made -- --spread
  faultline tune new/model.toml new/drive --fleet made/fleet.json --out new/tuning.json
  faultline fleet diagnose logs/ --bundle 'made/vehicle={vehicle}/bundle' --out fleet
  faultline fleet diagnose 's3://logs/2026-*/' --bundle out/demo/bundle --out fleet --scheduler tcp://10.0.0.1:8786

A drive is a recording's folder or a log file. Its vehicle is the one that the recording names, or the folder of the log
file; {vehicle} in the path of a model or bundle stands for it. What is behind -- goes to each vehicle's command. What
is done is found again: the same call goes on where it was. `diagnose` exits as `faultline diagnose` of several logs
does, the others with 2 where the command failed for some vehicle. What is written: docs/fleet.md.
"""

ORDERS = {
    "calibrate": ("model", "calibrate a model to each vehicle: OUT/vehicle=NAME/model.toml"),
    "tune": (
        "model",
        "tune each vehicle's thresholds and evidence: OUT/vehicle=NAME/tuning.json, and OUT/fleet.json of all",
    ),
    "export": ("model", "export each vehicle's bundle, with the DBC of its recordings: OUT/vehicle=NAME/bundle"),
    "evaluate": ("bundle", "evaluate each vehicle's bundle against the truth: OUT/vehicle=NAME/report"),
    "train": ("model", "train networks of each vehicle: OUT/vehicle=NAME/networks"),
}
"""Commands that are run for every vehicle, with what each is about."""

FILES = {
    "calibrate": "model.toml",
    "tune": "tuning.json",
    "export": "bundle",
    "evaluate": "report",
    "train": "networks",
}

PIECE_BYTES = 4_000_000
"""Of logs in a piece of work, of 7 min a third."""


def main(argv: list[str]) -> int:
    """Run the command; return 1 where a fault was found, 0 where every drive is an all-clear.

    Raises:
        InputError: no fault was found, and some drives are no all-clear.
    """
    parser = Parser("faultline fleet", description=__doc__, epilog=EXAMPLE)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_diagnose(commands)
    _add_show(commands)
    for name, (subject, help_) in ORDERS.items():
        _add_order(commands, name, subject, help_)
    at = argv.index("--") if "--" in argv else len(argv)
    options = parser.parse_args(argv[:at])
    options.extra = tuple(argv[at + 1 :])
    try:
        run: Callable[[argparse.Namespace], int] = options.run
        return run(options)
    except ModuleNotFoundError as error:
        if error.name in ("distributed", "dask", "fsspec", "numba", "pyarrow"):
            raise InputError(f"fleet needs {error.name}: {install_command('scale')}") from error
        raise


def _add_diagnose(commands: "argparse._SubParsersAction[Parser]") -> None:
    help_ = "diagnose every drive; verdicts and events as Parquet"
    parser = commands.add_parser("diagnose", help=help_, description=help_, epilog=EXAMPLE)
    parser.add_argument("drives", nargs="+", help="folders, log files, globs or URLs of recordings and logs")
    parser.add_argument("--bundle", required=True, help="the bundle folder; {vehicle} in it stands for the vehicle")
    parser.add_argument("--out", type=Path, required=True, help="the folder of the tables")
    parser.add_argument("--with", dest="asked", nargs="+", default=[], choices=KINDS, help="what is left out otherwise")
    _add_cluster(parser)
    parser.set_defaults(run=_diagnose)


def _add_show(commands: "argparse._SubParsersAction[Parser]") -> None:
    help_ = "which vehicles, which components, since when, how sure"
    parser = commands.add_parser("show", help=help_, description=help_, epilog=EXAMPLE)
    parser.add_argument("tables", type=Path, help="the folder that `fleet diagnose` wrote")
    parser.add_argument("--html", type=Path, help="write it as a page here, too")
    parser.add_argument("--json", action="store_true", help="print the findings as JSON lines")
    parser.set_defaults(run=_show)


def _add_order(commands: "argparse._SubParsersAction[Parser]", name: str, subject: str, help_: str) -> None:
    parser = commands.add_parser(name, help=help_.partition(":")[0], description=help_, epilog=EXAMPLE)
    parser.add_argument("subject", metavar=subject.upper(), help=f"the {subject}; {{vehicle}} stands for the vehicle")
    parser.add_argument("drives", nargs="+", help="folders, globs or URLs of recordings")
    parser.add_argument("--out", type=Path, required=True, help="the folder that gets a folder for each vehicle")
    _add_cluster(parser)
    parser.set_defaults(run=_order)


def _add_cluster(parser: argparse.ArgumentParser) -> None:
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--processes", type=int, help="processes of this machine (one a core)")
    where.add_argument("--scheduler", help="address of a Dask scheduler, as tcp://HOST:PORT, in place of these")


def _diagnose(options: argparse.Namespace) -> int:
    from faultline.analysis.fleet.cluster import cluster, pieces_of, worked
    from faultline.analysis.fleet.diagnosing import Wish, diagnosed, lost
    from faultline.analysis.fleet.drives import find_drives

    drives = find_drives(options.drives)
    wish = Wish(options.bundle, options.out.absolute(), tuple(sorted({*options.asked})))
    verdicts: Counter[str] = Counter()
    old, hours, began = 0, 0.0, time.monotonic()
    total = sum(drive.size for drive in drives) or 1
    read = 0
    with Progress("diagnosing") as progress, cluster(options.scheduler, options.processes) as client:
        pieces = pieces_of(drives, [drive.size for drive in drives], PIECE_BYTES)
        for piece, outcomes in worked(client, diagnosed, pieces, wish):
            for outcome in outcomes if outcomes is not None else lost(piece, wish):
                verdicts[outcome.verdict] += 1
                old, hours, read = old + outcome.is_old, hours + outcome.hours, read + outcome.drive.size
            left_s = (time.monotonic() - began) * (total - read) / max(read, 1)
            progress.say(f"{verdicts.total()} of {len(drives)} drives, {hours:.1f} h, {left_s:.0f} s left")
    said = ", ".join(f"{count} {verdict}" for verdict, count in sorted(verdicts.items()))
    print(f"{len(drives)} drives, {hours:.1f} h: {said}; {old} of them done before; tables in {options.out}")
    if verdicts["fault"]:
        return 1
    if open_ := verdicts["open"] + verdicts["failed"]:
        where = f"{options.out / 'drives'}"
        raise InputError(
            f"no fault was found, and {open_} of {len(drives)} drives are no all-clear; {where} has each reason"
        )
    return 0


def _show(options: argparse.Namespace) -> int:
    import msgspec

    from faultline.analysis.fleet import tables
    from faultline.analysis.fleet.findings import fleet_of
    from faultline.analysis.fleet.page import page_of, text_of

    rows = list(tables.drives(options.tables))
    if not rows:
        raise InputError(f"{options.tables}: no drives; give the folder that `faultline fleet diagnose --out` wrote")
    fleet = fleet_of(rows)
    if options.html is not None:
        write_file(options.html, page_of(fleet))
    if options.json:
        for finding in fleet.findings:
            print(msgspec.json.encode(finding._asdict()).decode())
    else:
        print(text_of(fleet))
    return 1 if fleet.standing else 0


def _pooled(order: "Order", vehicles: list[str]) -> str:
    from faultline.analysis.fleet.pooling import pool
    from faultline.analysis.fleet.vehicles import done

    tuned = {}
    for vehicle in vehicles:
        ended = done(order.folder(vehicle), order.command)
        if ended is not None and ended.code == 0:
            tuned[vehicle] = order.folder(vehicle) / order.file
    model = order.arguments(next(iter(tuned)), [])[1]
    return pool(tuned, model, order.out, print)


def _order(options: argparse.Namespace) -> int:
    from faultline.analysis.fleet.cluster import cluster, worked
    from faultline.analysis.fleet.drives import find_drives
    from faultline.analysis.fleet.vehicles import Order, by_vehicle, lost, ordered

    name, out = options.command, options.out.absolute()
    option = "--report" if name == "evaluate" else "--out"
    order = Order(name, options.subject, option, FILES[name], options.extra, out, takes_dbc=name == "export")
    vehicles = by_vehicle(find_drives(options.drives))
    codes: Counter[int] = Counter()
    old, began = 0, time.monotonic()
    with Progress(name) as progress, cluster(options.scheduler, options.processes) as client:
        for piece, ended in worked(client, ordered, [[each] for each in vehicles], order):
            for each in ended if ended is not None else lost(piece):
                codes[each.code] += 1
                old += each.is_old
                if each.code:
                    progress.note(f"{each.vehicle}: exit code {each.code}: {each.said}")
            left_s = (time.monotonic() - began) / codes.total() * (len(vehicles) - codes.total())
            progress.say(f"{codes.total()} of {len(vehicles)} vehicles, {left_s:.0f} s left")
    failed = codes.total() - codes[0]
    print(f"{len(vehicles)} vehicles: {codes[0]} done, {failed} not; {old} of them done before; in {options.out}")
    if name == "tune" and codes[0]:
        print(_pooled(order, [vehicle for vehicle, _ in vehicles]))
    if failed:
        raise InputError(
            f"{name} ended with an error for {failed} of {len(vehicles)} vehicles; {name}.txt of each says why"
        )
    return 0

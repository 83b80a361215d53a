"""Say what faults a drive can show at best: shortest delays, smallest sizes, what can be told apart."""

import argparse
import sys
from functools import partial
from pathlib import Path

import msgspec

from faultline.analysis.limit.drive import blocks_of
from faultline.analysis.limit.limits import limits_of, of_drive
from faultline.analysis.limit.table import Units, lines
from faultline.analysis.progress import Progress
from faultline.analysis.recordings.observe import open_known
from faultline.options import Parser
from faultline.service.bundle.load import load_bundle
from faultline.service.core.errors import InputError
from faultline.writing import check_file

EXAMPLE = """example:
  faultline limit out/demo/bundle out/demo/logs/drive-2 --picture out/limit.png

Noise, visits and baselines are the bundle's, of the fault-free drives that it was tuned on; the drive says what was
operated. No faulty recording is needed, and no detector is faster in the mean: one that knew onset, fault and size
would reach this. docs/limit.md says how to read the tables.
"""


def main(argv: list[str]) -> int:
    """Run the command; return 0."""
    options = _options(argv)
    bundle = load_bundle(options.bundle)
    evidence = bundle.manifest.evidence
    if not evidence.hypotheses:
        raise InputError(
            f"{options.bundle}: assumes no sizes of faults, so that nothing follows of a drive; tune it anew"
        )
    if options.picture:
        check_file(options.picture)
    drives = {}
    with Progress("limits") as progress:
        for path in options.drive:
            progress.say(str(path))
            log = open_known(path, partial(print, file=sys.stderr))
            log.check_senders(bundle.table)
            log.check_dbc(bundle.dbc_sha256)
            drives[log.id] = of_drive(bundle.manifest, blocks_of(bundle, log), options.every, options.within)
        found = limits_of(bundle.manifest, bundle.id, drives, options.every, options.within)
        if options.picture:
            from faultline.analysis.limit.picture import draw  # matplotlib takes a second to import

            draw(found, evidence, options.picture)
    print(msgspec.json.encode(found).decode() if options.json else "\n".join(lines(found, Units(evidence))))
    return 0


def _options(argv: list[str]) -> argparse.Namespace:
    parser = Parser(
        "faultline limit", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("bundle", type=Path, help="a bundle's folder, of `faultline export`")
    add("drive", type=Path, nargs="+", help="fault-free recordings of the operation that is asked about")
    add("--every", type=_positive, default=500.0, metavar="H", help="hours from alarm to alarm without a fault (500)")
    add(
        "--within", type=_positive, default=300.0, metavar="S", help="find the smallest size within these seconds (300)"
    )
    add("--picture", type=Path, help="draw the smallest size of each fault over time into this PNG")
    add("--json", action="store_true", help="print all as one JSON object")
    options = parser.parse_args(argv)
    if options.picture and options.picture.suffix != ".png":
        raise InputError(f"{options.picture}: no name of a picture; give one that ends in .png")
    return options


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no number") from None
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not above zero")
    return value

"""Turn a bench recording (two loggers, two clocks) into an instrumented log; --init: describe files of your own."""

import argparse
import math
from pathlib import Path

import msgspec

from faultline.analysis.progress import Progress
from faultline.analysis.recordings.bench import setup_of
from faultline.analysis.recordings.ingest import ingest
from faultline.analysis.recordings.report import sentences
from faultline.options import Parser
from faultline.service.core.errors import InputError
from faultline.writing import check_folder, write_folder

EXAMPLE = """example:
  faultline ingest recordings/bench-training-s1 --out logs
  faultline ingest recordings/bench-training-s1 --out logs --offset -87.3  # seen at a pressure step
  faultline ingest --init drive.blf --system uds  # writes recording.toml; faultline ingest --init --help
"""

AMBIENT_HPA = 500.0, 1100.0
"""Plausible ambient pressures: at 5500 m of altitude, and the highest at sea level."""


def main(argv: list[str]) -> int:
    """Runs the command; returns its exit code."""
    if "--init" in argv:
        from faultline.analysis.recordings.init import main as init  # which needs models

        return init([word for word in argv if word != "--init"])
    parser = Parser(
        "faultline ingest", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recording", type=Path, help="folder of the bench recording")
    parser.add_argument("--out", type=Path, required=True, help="writes OUT/<id>, the instrumented recording")
    parser.add_argument("--init", action="store_true", help="write recording.toml for a log or table: --init --help")
    parser.add_argument("--force", action="store_true", help="replace what is already there")
    parser.add_argument(
        "--offset", type=_number, metavar="SECONDS", help="CAN time at the second logger's zero, where you know it"
    )
    parser.add_argument(
        "--drift",
        type=_number,
        default=0.0,
        metavar="PPM",
        help="what CAN time gains on it, with --offset (default: 0)",
    )
    parser.add_argument(
        "--ambient-hpa",
        type=_number,
        metavar="HPA",
        help="pressure around the bench, which sensors show at standstill (default: 1013.25, unless all contradict)",
    )
    parser.add_argument(
        "--system",
        metavar="NAME",
        help="system on the bench, or its folder (default: the shipped one that has a bench)",
    )
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    options = parser.parse_args(argv)
    if options.drift and options.offset is None:
        parser.error("--drift goes with --offset SECONDS: alone it says nothing")
    by_hand = None if options.offset is None else (options.offset, options.drift * 1e-6)
    low, high = AMBIENT_HPA
    if (hPa := options.ambient_hpa) is not None and not low <= hPa <= high:
        raise InputError(f"--ambient-hpa {hPa:g}: give an absolute pressure between {low:g} and {high:g} hPa")
    ambient = None if hPa is None else 100.0 * hPa
    setup = setup_of(options.system)
    check_folder(options.out)
    with Progress(f"ingesting {options.recording}") as progress:
        result = ingest(options.recording, setup, progress.say, by_hand, ambient)
        folder = _write(result.files, options.out / result.report.id, options.recording, force=options.force)
    told = f"wrote {folder}: " + "\n".join(sentences(result.report, setup))
    print(msgspec.json.encode(result.report).decode() if options.json else told)
    return 0


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    return value


def _write(files: dict[str, bytes], folder: Path, bench: Path, *, force: bool) -> Path:
    """The recording appears whole or not at all."""
    if folder.resolve() == bench.resolve():
        raise InputError(f"{folder}: would replace the bench recording itself; give another --out")
    if folder.exists() and not force:
        raise InputError(f"{folder}: exists; remove it or use --force")
    write_folder(folder, files)
    return folder

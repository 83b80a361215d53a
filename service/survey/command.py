"""Say what is in a log: channels, messages, senders, gaps, damage, and which signals of a DBC or a bundle."""

import argparse
from collections.abc import Mapping
from pathlib import Path

import msgspec

from faultline.options import Parser
from faultline.service.bundle.load import load_bundle
from faultline.service.core.errors import InputError
from faultline.service.logs import Log, open_any
from faultline.service.survey.columns import columns_of, signals_of
from faultline.service.survey.document import Survey, survey_of
from faultline.service.survey.signals import Traffic as Contents
from faultline.service.survey.signals import find_signals, load_dbc
from faultline.service.survey.text import text_of
from faultline.service.survey.traffic import Traffic

EXAMPLE = """example:
  faultline log drive.blf --dbc truck.dbc
  faultline log drive.mf4 --bundle out/demo/bundle --json

With --bundle it exits with 1 where a signal that the bundle needs is not in the log. Fields of the JSON: docs/logs.md.
"""


def main(argv: list[str]) -> int:
    """Run the command; return 1 where the log lacks a signal of the bundle, else 0.

    Raises:
        InputError: the log, the DBC or the bundle cannot be read.
    """
    parser = Parser(
        "faultline log", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path, help="a log file in any format, or a recording's folder")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--dbc", type=Path, help="which of this DBC's signals are there, and why not")
    which.add_argument("--bundle", type=Path, help="which of the signals that this bundle needs")
    parser.add_argument("--channel", help="the bus to take, of a log of several")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args(argv)
    dbc, units = _asked(options.dbc, options.bundle)
    log = open_any(options.log, options.channel)
    survey = survey_log(log, dbc, units)
    print(msgspec.json.encode(survey).decode() if options.json else text_of(survey))
    return int(options.bundle is not None and not all(each.is_there for each in survey.signals))


def survey_log(log: Log, dbc: Path | None, units: Mapping[str, str] | None) -> Survey:
    """What is in the log, and which signals of the DBC, or those that are wanted, are."""
    columns = [] if log.values is None else columns_of(log.values)
    if log.values is not None and not log.format.has_frames:
        found = [] if units is None else signals_of(log.values, units, columns)
        return survey_of(log, [], {}, [], columns, found)
    wanted = None if units is None else [*units]
    database = None if dbc is None else load_dbc(_read(dbc), str(dbc))
    traffic = Traffic(log.start_s, has_times=log.format.has_times)
    for batch in log.batches():
        traffic.add(batch)
    messages = sorted(traffic.messages.values(), key=lambda each: (each.channel, each.is_extended, each.identifier))
    names = [name or "the only one" for name in log.channels]
    elsewhere = {} if log.channel is None else {k: v for k, v in log.report.channels.items() if k != log.channel}
    signals = [] if database is None else find_signals(database, Contents(messages, elsewhere, names), wanted)
    return survey_of(log, messages, traffic.without_data, names, columns, signals)


def _asked(dbc: Path | None, bundle: Path | None) -> tuple[Path | None, Mapping[str, str] | None]:
    """The DBC, and the signals that are wanted of it with their units, None for all."""
    if bundle is None:
        return dbc, None
    manifest = load_bundle(bundle).manifest
    return bundle / manifest.dbc, {each.signal: each.unit for each in manifest.inputs}


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error

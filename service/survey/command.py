"""Say what is in a log: channels, messages, senders, gaps, damage, and which signals of a DBC or a bundle."""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec

from faultline.options import Parser
from faultline.service.bundle.load import load_bundle
from faultline.service.core.errors import InputError
from faultline.service.core.signals.dbc import NOBODY
from faultline.service.core.signals.dbc_messages import Described, describe_dbc
from faultline.service.core.signals.dbc_text import dbc_text
from faultline.service.logs import Log, open_any
from faultline.service.logs.recording import load_recording
from faultline.service.survey.columns import columns_of, signals_of
from faultline.service.survey.document import Survey, survey_of
from faultline.service.survey.signals import Contents, find_signals, parts_of
from faultline.service.survey.text import text_of
from faultline.service.survey.traffic import LogTraffic

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
    described, units = _asked(options.dbc, options.bundle, _senders(options.log))
    log = open_any(options.log, options.channel)
    survey = survey_log(log, described, units)
    print(msgspec.json.encode(survey).decode() if options.json else text_of(survey))
    return int(options.bundle is not None and not all(each.is_there for each in survey.signals))


def survey_log(log: Log, described: Sequence[Described] = (), units: Mapping[str, str] | None = None) -> Survey:
    """Return what is in the log, and which signals of these messages are, or those in `units` (name to unit)."""
    columns = [] if log.values is None else columns_of(log.values)
    given = [] if log.values is None or units is None else signals_of(log.values, units, columns)
    if not log.format.has_frames:
        return survey_of(log, [], {}, [], columns, given)
    traffic, parts = LogTraffic(log.start_s, has_times=log.format.has_times), parts_of(described)
    for batch in log.batches():
        traffic.add(batch)
        parts.add(batch)
    messages = sorted(traffic.messages.values(), key=lambda each: (each.channel, each.is_extended, each.identifier))
    names = [name or "the only one" for name in log.channels]
    elsewhere = {} if log.channel is None else {k: v for k, v in log.report.channels.items() if k != log.channel}
    beside = {each.signal: each for each in given if each.is_there}
    wanted = None if units is None else [name for name in units if name not in beside]
    signals = [*beside.values(), *find_signals(described, Contents(messages, parts, elsewhere, names), wanted)]
    return survey_of(log, messages, traffic.without_data, names, columns, signals)


def _senders(log: Path) -> Mapping[str, int]:
    """Return the source addresses that the log's recording chooses, as `diagnose` takes them."""
    can = load_recording(log).can if log.is_dir() else None
    return NOBODY if can is None else can.senders


def _asked(
    dbc: Path | None, bundle: Path | None, senders: Mapping[str, int]
) -> tuple[list[Described], Mapping[str, str] | None]:
    """Return the messages of the DBC, and the signals that are wanted with their units, None for all."""
    if bundle is None:
        return [] if dbc is None else describe_dbc(_read(dbc), str(dbc), senders=senders), None
    manifest = load_bundle(bundle).manifest
    units = {each.signal: each.unit for each in manifest.inputs}
    if manifest.dbc is None:
        return [], units
    path = bundle / manifest.dbc
    return describe_dbc(_read(path), str(path), [*units], {**manifest.senders, **senders}), units


def _read(path: Path) -> str:
    try:
        return dbc_text(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error

"""Say what is in a log: channels, messages, senders, gaps, damage, and which signals of a DBC or a bundle."""

import argparse
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import msgspec

from faultline.options import Parser, add_channels, channels_of
from faultline.service.bundle.load import load_bundle
from faultline.service.core.errors import InputError
from faultline.service.core.signals.dbc import NO_BUSES, NOBODY, OWN_NAMES
from faultline.service.core.signals.dbc_messages import Described, describe_dbc
from faultline.service.core.signals.dbc_text import dbc_text
from faultline.service.logs import Log, open_any
from faultline.service.logs.batch import Batch
from faultline.service.logs.recording import load_recording
from faultline.service.survey.columns import columns_of, signals_of
from faultline.service.survey.document import Survey, survey_of
from faultline.service.survey.signals import Contents, absent, find_signals, on_unknown_bus, parts_of
from faultline.service.survey.text import text_of
from faultline.service.survey.traffic import LogTraffic

EXAMPLE = """example:
  faultline log drive.blf --dbc truck.dbc
  faultline log drive.mf4 --bundle out/demo/bundle --json

To write a log in another format: faultline convert.
With --bundle it exits with 1 where a signal that the bundle needs is not in the log. Fields of the JSON: docs/logs.md.
"""


class Asked(NamedTuple):
    """What is asked of a log: messages of a DBC, signals by name with their units (None: all), buses of messages."""

    messages: Sequence[Described] = ()
    units: Mapping[str, str] | None = None
    buses: Mapping[str, str] = NO_BUSES


ALL = Asked()


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
    add_channels(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args(argv)
    channel, buses = channels_of(options.channel)
    asked = _asked(options.dbc, options.bundle, *_chosen(options.log))
    if unknown := [bus for bus in buses if bus not in asked.buses.values()]:
        names = f"the bundle {options.bundle} names" if options.bundle else "without --bundle there is"
        raise InputError(f"--channel {unknown[0]}={buses[unknown[0]]}: {names} no such bus")
    log = open_any(options.log, channel)
    survey = survey_log(replace(log, buses={**log.buses, **buses}), asked)
    print(msgspec.json.encode(survey).decode() if options.json else text_of(survey))
    return int(options.bundle is not None and not all(each.is_there for each in survey.signals))


def survey_log(log: Log, asked: Asked = ALL) -> Survey:
    """Return what is in the log, and which of the signals that were asked for."""
    units, described = asked.units, asked.messages
    columns = [] if log.values is None else columns_of(log.values)
    given = [] if log.values is None or units is None else signals_of(log.values, units, columns)
    if not log.format.has_frames:
        return survey_of(log, [], {}, [], columns, given)
    names = [name or "the only one" for name in log.channels]
    elsewhere = {} if log.channel is None else {k: v for k, v in log.report.channels.items() if k != log.channel}
    own = [each for each in described if each.name not in asked.buses]
    traffic, contents = _contents(log.batches(), LogTraffic(log.start_s, has_times=log.format.has_times), own)
    found = find_signals(own, contents._replace(elsewhere=elsewhere, names=names))
    messages = {**traffic.messages}
    for bus in dict.fromkeys(asked.buses.values()):
        of = [each for each in described if asked.buses.get(each.name) == bus]
        if bus in log.buses:
            there, contents = _contents(log.on_bus(bus), LogTraffic(0.0, has_times=log.format.has_times), of)
            found += find_signals(of, contents._replace(names=names))
            messages = {**there.messages, **messages}
        else:
            found += on_unknown_bus(of, bus)
    beside = {each.signal: each for each in given if each.is_there}
    signals = [*beside.values(), *(each for each in found if each.signal not in beside)]
    if units is not None:
        signals += absent(set(units) - {each.signal for each in signals})
    ordered = sorted(messages.values(), key=lambda each: (each.channel, each.is_extended, each.identifier))
    return survey_of(log, ordered, traffic.without_data, names, columns, signals)


def _contents(
    batches: Iterable[Batch], traffic: LogTraffic, described: Sequence[Described]
) -> tuple[LogTraffic, Contents]:
    """Return the messages of batches, with those of several frames among the ones described."""
    parts = parts_of(described)
    for batch in batches:
        traffic.add(batch)
        parts.add(batch)
    messages = sorted(traffic.messages.values(), key=lambda each: (each.channel, each.is_extended, each.identifier))
    return traffic, Contents(messages, parts, {}, [])


def _chosen(log: Path) -> tuple[Mapping[str, int], Mapping[str, str]]:
    """Return the source addresses and names of signals that the log's recording chooses, as `diagnose` takes them."""
    can = load_recording(log).can if log.is_dir() else None
    return (NOBODY, OWN_NAMES) if can is None else (can.senders, can.signals)


def _asked(dbc: Path | None, bundle: Path | None, senders: Mapping[str, int], signals: Mapping[str, str]) -> Asked:
    """Return what of a log is asked for: the signals of the DBC, or those that the bundle needs."""
    if bundle is None:
        return ALL if dbc is None else Asked(describe_dbc(_read(dbc), str(dbc), senders=senders))
    manifest = load_bundle(bundle).manifest
    units = {each.signal: each.unit for each in manifest.inputs}
    if manifest.dbc is None:
        return Asked(units=units)
    path = bundle / manifest.dbc
    chosen = {**manifest.senders, **senders}, {**manifest.signals, **signals}
    described = describe_dbc(_read(path), str(path), [*units], *chosen)
    return Asked(described, units, manifest.buses)


def _read(path: Path) -> str:
    try:
        return dbc_text(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error

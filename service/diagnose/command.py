"""Diagnose a log without a bus, as fast as it goes."""

import argparse
import sys
from collections.abc import Iterable
from contextlib import ExitStack
from math import inf
from pathlib import Path

from faultline.options import Parser, add_channels, add_senders, channels_of, senders_of
from faultline.service.bundle.load import Bundle, load_with_log
from faultline.service.core.errors import InputError
from faultline.service.core.j1939.log_context import LogContext
from faultline.service.core.monitor import Monitor
from faultline.service.core.records.context import Context
from faultline.service.core.records.line import encode
from faultline.service.core.verdict import Verdict, second_senders
from faultline.service.diagnose.tick_table import TickTable, events_path, tick_table
from faultline.service.logs import Log
from faultline.service.watching.records import describe, describe_context, meanings
from faultline.writing import check_file

EXAMPLE = """example:
  faultline diagnose out/demo/logs/validation-6-fA_du --bundle out/demo/bundle
  faultline diagnose out/demo/logs/* --bundle out/demo/bundle --out out/ticks.parquet

It exits with 1 where a fault was found, and with 0 where none was and every test could tell at some time. Where some
could not, or the log ends while something is suspected, or is damaged or cut off, that is no all-clear: it says so and
exits with 2. --partial accepts what could be read of a damaged log; the verdict names the span. Of several logs a fault
in one decides. --out needs the extra `columns`; what is in its files: docs/diagnose-out.md.
"""


def main(argv: list[str]) -> int:
    """Run the command; return 1 where a log ends with a fault or held one, 0 where none held one.

    Raises:
        InputError: no fault was found, but a log is damaged, or some test could never tell, or the log ends in a
            suspicion, so that "no fault" would be a guess.
    """
    options = _options(argv)
    found = False
    errors: list[InputError] = []
    with ExitStack() as stack:
        out: TickTable | None = None
        for path in options.log:
            try:
                log, bundle = _opened(path, options)
                if options.out is not None and out is None:
                    out = stack.enter_context(tick_table(options.out, bundle.manifest))
                found |= _diagnose(path, log, bundle, options, out)
            except InputError as error:
                errors.append(error)
                if len(options.log) > 1:
                    print(f"faultline diagnose: {error}", file=sys.stderr)
    if errors and not found:
        several = f"{len(errors)} of {len(options.log)} logs gave no verdict, and no fault was found in the others"
        raise errors[0] if len(options.log) == 1 else InputError(f"{several}; above is said what each needs")
    return 1 if found else 0


def _options(argv: list[str]) -> argparse.Namespace:
    parser = Parser("faultline diagnose", description=__doc__, epilog=EXAMPLE)
    parser.add_argument("log", type=Path, nargs="+", help="instrumented recordings (folders), or log files")
    parser.add_argument("--bundle", type=Path, required=True, help="the bundle folder")
    parser.add_argument("--partial", action="store_true", help="accept the span that was read of a damaged log")
    add_channels(parser)
    add_senders(parser)
    parser.add_argument("--out", type=Path, help="write samples, residuals and events of every tick here, as Parquet")
    parser.add_argument("--json", action="store_true", help="print the events as JSON lines")
    options = parser.parse_args(argv)
    if options.out is not None:
        import pyarrow  # noqa: F401  said before hours of a log are read

        for path in (options.out, events_path(options.out)):
            if path.is_dir() or any(path.exists() and each.exists() and path.samefile(each) for each in options.log):
                raise InputError(f"{path}: is a folder or a log; give another file with --out")
            check_file(path)
    return options


def _opened(path: Path, options: argparse.Namespace) -> tuple[Log, Bundle]:
    """Return the log and the bundle, which fit each other; print what was lost of the log where that is accepted."""
    channel, buses = channels_of(options.channel)
    bundle, log = load_with_log(options.bundle, path, channel, senders_of(options.sender), buses)
    if log.report.lost and (options.partial or not log.report.damaged):
        print(f"faultline diagnose: {path}: {log.report.summary()}", file=sys.stderr)
    return log, bundle


def _diagnose(path: Path, log: Log, bundle: Bundle, options: argparse.Namespace, out: TickTable | None) -> bool:
    """Print the events of a log and the verdict; return whether there was a fault.

    Raises:
        InputError: there was none, and that it has none cannot be said either.
    """
    accepted = options.partial or not log.report.damaged
    if len(options.log) > 1 and not options.json:
        print(f"{path}:")
    if out is not None:
        out.begin(log.id, str(path))
    watch = out.add if out is not None else None
    monitor = Monitor(bundle.manifest, bundle.bank(), bundle.table, log.id, bundle.id, watch)
    verdict = _printed(monitor, log, bundle, options.json, out)
    found = verdict.found(monitor.decision)
    if not (found or accepted):
        raise InputError(
            f"{path}: damaged, so no alarm is no all-clear: {log.report.summary()}; give a whole log, or accept "
            "with --partial what was read"
        )
    if not found and (why := verdict.why_open(monitor.decision, bundle.table)):
        raise InputError(f"{path}: {why}")
    for remark in ("" if accepted else log.report.summary(), second_senders(bundle.table), *bundle.table.remarks()):
        if remark:
            print(f"faultline diagnose: {path}: {remark}", file=sys.stderr)
    said = "a fault was found" if found else "no fault: every test could tell at some time, and none alarms"
    loss = ", as far as the damaged log could be read" if log.report.damaged else ""
    print(f"from {log.report.span}{loss}: {said}", file=sys.stderr if options.json else sys.stdout)
    return found


def _printed(monitor: Monitor, log: Log, bundle: Bundle, as_json: bool, out: TickTable | None) -> Verdict:
    """Print the events; return the verdict, in which what was decided last may be missing."""
    faults, equations = meanings(bundle.manifest)
    verdict = Verdict(bundle.manifest)
    context = LogContext(log.id, log.channels)
    for event in monitor.signals(log.signals(bundle.table, context.passing)):
        _print_context(context.until((monitor.origin_s or 0.0) + event.t_s, monitor.origin_s), as_json)
        verdict.add(event)
        if out is not None:
            out.add_event(event)
        if as_json:
            sys.stdout.buffer.write(encode(event))
        else:
            print(describe(event, faults, equations))
    _print_context(context.until(inf, monitor.origin_s), as_json)
    sys.stdout.flush()
    if losses := context.losses():
        print(f"faultline diagnose: {losses}", file=sys.stderr)
    return verdict


def _print_context(records: Iterable[Context], as_json: bool) -> None:
    for record in records:
        if as_json:
            sys.stdout.buffer.write(encode(record))
        else:
            print(describe_context(record))

"""Diagnose a log without a bus, as fast as it goes."""

import argparse
import sys
from pathlib import Path

from service.bundle import load_bundle, verify_golden
from service.core.errors import InputError
from service.core.events import encode
from service.core.monitor import Monitor
from service.logs import open_log
from service.watch import describe, meanings

EXAMPLE = """example:
  faultline diagnose out/demo/logs/validation-6-fA_du --bundle out/demo/bundle

It exits with 1 where a fault was found, and with 0 where none was and every test could tell at some time. Where some
could not, or the log ends while something is suspected, that is no all-clear: it says so and exits with 2.
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns 1 where the log ends with a fault or held one, 0 where it held none.

    Raises:
        InputError: no fault was found, but some test could never tell, or the log ends in a suspicion, so that "no
            fault" would be a guess.
    """
    parser = argparse.ArgumentParser(
        "faultline diagnose", description=__doc__, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("log", type=Path, help="an instrumented recording (folder), or a candump log")
    parser.add_argument("--bundle", type=Path, required=True, help="the bundle folder")
    parser.add_argument("--json", action="store_true", help="print the events as JSON lines")
    options = parser.parse_args(argv)
    bundle = load_bundle(options.bundle)
    verify_golden(bundle)
    log = open_log(options.log)
    log.check_dbc(bundle.manifest.files[bundle.manifest.dbc].sha256)
    if log.recording is not None:
        log.recording.check_sensors(options.log, bundle.manifest.sensor_set, f"the bundle {options.bundle}")
    if log.report.lost:
        print(f"faultline diagnose: {options.log}: {log.report.summary()}", file=sys.stderr)
    monitor = Monitor(bundle.manifest, bundle.bank(), bundle.table, log.id, bundle.id)
    faults, equations = meanings(bundle.manifest)
    found = False
    blind = {generator.test for generator in bundle.manifest.generators}
    for event in monitor.log(log.relative()):
        found = found or bool(event.diagnoses)
        blind &= set(event.cannot_tell)
        if options.json:
            sys.stdout.buffer.write(encode(event))
        else:
            print(describe(event, faults, equations))
    sys.stdout.flush()
    found = found or bool(monitor.decision.diagnoses)  # a log may end before what is decided is told
    if blind and not found:
        signals = ", ".join(channel.signal for channel in bundle.manifest.inputs)
        raise InputError(
            f"{options.log}: {' '.join(sorted(blind))} could never tell, so no alarm is no all-clear; "
            f"give a longer log that has {signals}, within their operating ranges"
        )
    if monitor.decision.suspected and not found:
        raise InputError(
            f"{options.log}: ends while something is suspected and not yet confirmed or dismissed; give a longer log"
        )
    if monitor.decision.alarm and not found:
        raise InputError(
            f"{options.log}: ends while {' '.join(monitor.decision.alarm)} alarms, which is taken for what this day is "
            "like: no fault was confirmed, and none is ruled out; record another drive"
        )
    return 1 if found else 0

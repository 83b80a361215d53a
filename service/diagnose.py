"""Diagnose a log without a bus, as fast as it goes."""

import argparse
import sys
from pathlib import Path

from service.bundle import Bundle, load_bundle, verify_golden
from service.core.errors import InputError
from service.core.events import encode
from service.core.monitor import Monitor
from service.logs import Log, open_log
from service.watch import describe

EXAMPLE = """example:
  faultline diagnose out/logs/bench-validation-s7-fA_du --bundle out/bundle
"""


def main(argv: list[str]) -> int:
    """Runs the command; returns 1 where the log ends with a fault or held one, 0 where it held none."""
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
    check_dbc(log, bundle, options.log)
    if log.report.lost:
        print(f"faultline diagnose: {options.log}: {log.report.summary()}", file=sys.stderr)
    monitor = Monitor(bundle.manifest, bundle.bank(), bundle.table, log.id, bundle.id)
    found = False
    for event in monitor.log(log.relative()):
        found = found or bool(event.diagnoses)
        if options.json:
            sys.stdout.buffer.write(encode(event))
        else:
            print(describe(event, {fault.name: fault for fault in bundle.manifest.faults}))
    sys.stdout.flush()
    return 1 if found else 0


def check_dbc(log: Log, bundle: Bundle, path: Path) -> None:
    """A recording made with another DBC than the bundle's must not be decoded with it.

    Raises:
        InputError: the recording names another DBC.
    """
    expected = bundle.manifest.files[bundle.manifest.dbc].sha256
    if log.dbc_sha256 is not None and log.dbc_sha256 != expected:
        raise InputError(
            f"{path}: recorded with DBC {log.dbc_sha256[:12]}, the bundle was made for {expected[:12]}; "
            "export a bundle for this vehicle's DBC"
        )

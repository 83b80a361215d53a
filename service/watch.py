"""Show a running service: a live screen on a terminal, else its events as they come, a line each."""

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

from faultline.options import Parser
from faultline.service.core.errors import InputError
from faultline.service.core.manifest import Equation, Fault
from faultline.service.protocol.client import subscribe
from faultline.service.watching.records import described, meanings

EXAMPLE = """The screen needs the control socket: --control, or control.sock beside the socket of
events. Keys: q ends, Tab shows the next system. Events are printed on a terminal too
with --lines, --json, --once or --after.

examples:
  faultline watch --socket /run/faultline/events.sock
  faultline watch --socket /run/faultline/events.sock --after 0
"""
CONTROL = "control.sock"
"""Of the control socket, where it is beside the other."""


def main(argv: list[str]) -> int:
    """Run the command; returns 0 at the end of the stream, 1 where `--once` found none to print."""
    parser = Parser("faultline watch", description=__doc__, epilog=EXAMPLE)
    parser.add_argument("--socket", type=Path, required=True, help="where `faultline run` serves its events")
    parser.add_argument("--json", action="store_true", help="print the events as they are, one line of JSON each")
    parser.add_argument("--after", type=int, metavar="SEQ", help="begin after this event (0: with the first there is)")
    parser.add_argument(
        "--wait", type=float, default=0.0, metavar="S", help="how long to wait for the socket to appear"
    )
    parser.add_argument("--screen", action="store_true", help="the live screen, though this may be no terminal")
    parser.add_argument("--lines", action="store_true", help="a line for each event, though this is a terminal")
    parser.add_argument("--control", type=Path, help="where `faultline run` answers questions, for the screen")
    parser.add_argument("--system", metavar="NAME", help="which system the screen shows first, of several")
    parser.add_argument("--once", action="store_true", help="end after one event")
    parser.add_argument("--bundle", type=Path, help="the bundle folder, to print what the faults' names mean")
    options = parser.parse_args(argv)
    faults, equations = _meanings(options.bundle) if options.bundle else ({}, {})
    if (control := _screens(options)) is not None:
        return _show(control, options.socket, options.system, faults, equations)
    for line in subscribe(options.socket, options.after, options.wait):
        if options.json:
            sys.stdout.buffer.write(line)
        else:
            print(described(line, options.socket, faults, equations))
        sys.stdout.flush()
        if options.once:
            return 0
    print("faultline watch: the service has ended", file=sys.stderr)
    return 1 if options.once else 0


def _screens(options: argparse.Namespace) -> Path | None:
    """Return the path of the control socket if a screen is to be shown; raises InputError where that makes no sense."""
    prints = options.lines or options.json or options.once or options.after is not None
    control: Path = options.control or options.socket.with_name(CONTROL)
    if options.screen and prints:
        raise InputError("--screen shows no lines: leave out --lines, --json, --once and --after")
    if options.screen:
        return control
    found = options.control is not None or control.is_socket()
    return control if found and not prints and sys.stdout.isatty() else None


def _show(
    control: Path, events: Path, system: str | None, faults: Mapping[str, Fault], equations: Mapping[str, Equation]
) -> int:
    from faultline.service.watching.live_client import LiveClient  # what only a screen needs
    from faultline.service.watching.show import show

    def in_one_line(line: bytes) -> str:
        parts = (part.strip() for part in described(line, events, faults, equations).splitlines())
        return "; ".join(parts).replace(":;", ":")

    return show(LiveClient(control, system, lambda after: subscribe(events, after), in_one_line))


def _meanings(folder: Path) -> tuple[dict[str, Fault], dict[str, Equation]]:
    from faultline.service.bundle.load import load_bundle  # with the inference library, which watching does without

    return meanings(load_bundle(folder).manifest)

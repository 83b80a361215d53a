"""Guide through an active test cycle, with a verdict and a printable report.

The technician, or a routine of the control unit, brings about what is asked for; the service hears it on the bus, and
this command hears the service. Nothing is sent to the vehicle.
"""

import argparse
import os
import re
import sys
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import msgspec

from faultline.options import Parser
from faultline.service.core.errors import InputError
from faultline.service.core.records.health import meaning
from faultline.service.core.records.line import encode
from faultline.service.pages import NoEngineError, check_engine
from faultline.service.protocol.answers import FaultList, ServiceState
from faultline.service.protocol.client import ControlClient
from faultline.service.protocol.errors import ProtocolError
from faultline.service.protocol.live import LiveTick, SystemDescription
from faultline.service.protocol.questions import Question
from faultline.service.workshop.cycle import Cycle, End
from faultline.service.workshop.hindrance import remedy
from faultline.service.workshop.listening import live_ticks
from faultline.service.workshop.plan import HOLD, PATIENCE, VISITS, plan
from faultline.service.workshop.report import page
from faultline.service.workshop.result import Frame, Result, result
from faultline.service.workshop.screen import Live, Plain, Screen, printable
from faultline.service.workshop.verdict import Kind, Seen
from faultline.service.workshop.words import HEADLINES, candidate_line, separation_line
from faultline.writing import check_file, write_file

EXAMPLE = """examples:
  faultline workshop
  faultline workshop --system NAME --note "after the repair" --report truck-17.html
  faultline workshop --json > truck-17.json

exit codes: 0 no fault found, 1 a fault, 2 cannot tell or bad input, 130 broken off (the report is written first)
"""

SOCKET = Path("/run/faultline/control.sock")
CODES: dict[Kind, int] = {"no-fault": 0, "fault": 1, "cannot-tell": 2}


class Begun(NamedTuple):
    """State of the service before the test."""

    state: ServiceState
    system: SystemDescription
    memory: FaultList


STATE, FAULTS = Question(ask="state"), Question(ask="faults")


def main(argv: list[str]) -> int:
    """Runs the command; returns 0 where no fault was found, 1 where one was, 2 where it cannot tell.

    Raises:
        InputError: the service does not answer, has no such system, or the report cannot be written.
        KeyboardInterrupt: a person broke it off; the report is written.
    """
    options = _options(argv)
    begun = _begin(options.control, options.system)
    now = _now()
    path, report = _report(options, begun, now)
    out = sys.stderr if options.json else sys.stdout
    for line in _said_before(begun, report):
        print(printable(line), file=out, flush=True)
    hold_s, patience_s = map(begun.system.time.seconds, (HOLD, PATIENCE))
    steps = plan(begun.system.steady, options.hold or hold_s, VISITS)
    cycle = Cycle(begun.system, steps, options.patience or patience_s)
    end = _observe(cycle, options.control, _screen(options))
    frame = Frame(state=begun.state, before=begun.memory.faults, begun=now, note=options.note)
    seen, end = _at_the_end(options.control, begun, end)
    found = msgspec.structs.replace(result(cycle, frame, end, _now(), seen), report=path and str(path))
    if options.json:  # first: a disk that is full takes no verdict away
        sys.stdout.buffer.write(encode(found))
        sys.stdout.flush()
    else:
        print("\n".join(printable(line) for line in [*_said(found), f"report: {report}"]), flush=True)
    if path is not None:
        _write(path, page(found, begun.system, cycle.trace.samples), replace=options.force)
    if end == "interrupted":
        raise KeyboardInterrupt
    return CODES[found.verdict.kind]


def _options(argv: list[str]) -> argparse.Namespace:
    parser = Parser("faultline workshop", description=(__doc__ or "").partition("\n")[0], epilog=EXAMPLE)
    parser.add_argument("--control", type=Path, default=SOCKET, help=f"the service's control socket ({SOCKET})")
    parser.add_argument("--system", help="which one, where the service watches several")
    parser.add_argument(
        "--report", type=Path, metavar="FILE.html", help="default: named after vehicle, system and time"
    )
    parser.add_argument("--force", action="store_true", help="replace a report that is already there")
    parser.add_argument("--note", metavar="TEXT", help="of the technician, for the report")
    parser.add_argument(
        "--hold", type=_seconds, metavar="S", help=f"of each step ({HOLD.settlings:.0f} settling times)"
    )
    parser.add_argument(
        "--patience", type=_seconds, metavar="S", help=f"without progress ({PATIENCE.settlings:.0f} settling times)"
    )
    parser.add_argument("--plain", action="store_true", help="a line per change instead of one screen")
    parser.add_argument("--json", action="store_true", help="print the result for programs; progress on standard error")
    return parser.parse_args(argv)


def _seconds(text: str) -> float:
    value = float(text)
    if not 1.0 <= value <= 86_400.0:
        raise argparse.ArgumentTypeError(f"{text}: give 1 to 86400 s")
    return value


def _begin(path: Path, name: str | None) -> Begun:
    with ControlClient(path) as control:
        state = control.ask(STATE, ServiceState)
        if state.is_recording:
            raise InputError(f"{path}: serves a recording; the test needs a service that listens to a vehicle")
        there = [each.name for each in state.systems]
        if not there:
            raise InputError(f"{path}: the service watches no system; see `faultline bundle install`, then its log")
        if name is None and len(there) > 1:
            raise InputError(f"{path}: watches {', '.join(there)}; say which one by --system")
        if name is not None and name not in there:
            raise InputError(f"{path}: watches no system {name!r}; give --system one of {', '.join(there)}")
        system = control.ask(Question(ask="system", name=name or there[0]), SystemDescription)
        return Begun(state, system, control.ask(FAULTS, FaultList))


def _report(options: argparse.Namespace, begun: Begun, now: str) -> tuple[Path | None, str]:
    """Return where the report will be written, and that in words: nowhere where its engine is not installed.

    Raises:
        InputError: it could not be written there, or is asked for and cannot be made.
    """
    try:
        check_engine()
    except NoEngineError as error:
        if options.report is not None:
            raise
        return None, f"none, {error}"
    path = options.report or _default(begun, now)
    _check(path, replace=options.force)
    return path, str(path)


def _said_before(begun: Begun, report: str) -> list[str]:
    state, system = begun.state, begun.system
    remembered = sum(each.system == system.name for each in begun.memory.faults)
    return [
        f"{state.source}: {system.name}, {len(system.tests)} tests, bundle {system.bundle[:12]}",
        *(f"first: {each.of} {meaning(each.kind)}: {remedy(each.kind)}" for each in state.conditions),
        f"remembered faults: {remembered}; report: {report}; Ctrl-C ends the test early",
    ]


def _screen(options: argparse.Namespace) -> Screen:
    out = sys.stderr if options.json else sys.stdout
    if options.plain or options.json or "NO_COLOR" in os.environ or not out.isatty():
        return Plain(out)
    return Live(out)


def _observe(cycle: Cycle, path: Path, screen: Screen) -> End:
    """Run the cycle to its end."""
    try:
        for came, is_behind in live_ticks(path, cycle.system.name):
            if isinstance(came, LiveTick):
                if not came.fits(cycle.system):
                    return "begun-anew"
                cycle.take(came)
            else:
                cycle.silent(came)
            ended = cycle.ended
            if ended is not None or not is_behind:
                screen.show(cycle)
            if ended is not None:
                return ended
    except KeyboardInterrupt:
        return "interrupted"
    finally:
        screen.close()
    return "service-ended"


def _at_the_end(path: Path, begun: Begun, end: End) -> tuple[Seen, End]:
    """Return the remembered faults and conditions now; those before the test if the service is gone."""
    try:
        with ControlClient(path) as control:
            state, memory = control.ask(STATE, ServiceState), control.ask(FAULTS, FaultList)
    except ProtocolError:
        seen = Seen(begun.memory.faults, begun.state.conditions)
        return seen, "interrupted" if end == "interrupted" else "service-ended"
    same = any(each.name == begun.system.name and each.bundle == begun.system.bundle for each in state.systems)
    return Seen(memory.faults, state.conditions), end if same or end == "interrupted" else "begun-anew"


def _said(found: Result) -> list[str]:
    """Return the verdict for a terminal."""
    verdict = found.verdict
    there = "" if verdict.kind != "fault" else ", it is there now" if verdict.present else ", not there any more"
    history = [each for each in found.remembered if not each.during_test]
    return [
        "",
        f"{HEADLINES[verdict.kind]}{there}",
        *(f"   {candidate_line(each)}" for each in verdict.candidates),
        *(f"   {reason}" for reason in verdict.reasons),
        *(f"   told apart by: {separation_line(each)}" for each in verdict.separating),
        *([f"remembered from before: {len(history)}{', see the report' if found.report else ''}"] if history else []),
    ]


def _default(begun: Begun, now: str) -> Path:
    name = f"faultline-workshop-{begun.state.source}-{begun.system.name}-{now[:19].replace(':', '')}"
    return Path(re.sub(r"[^A-Za-z0-9._-]", "_", name)[:200] + ".html")


def _check(path: Path, *, replace: bool) -> None:
    """Raise InputError or OSError if the report could not be written after a test of ten minutes."""
    if not path.parent.is_dir():  # a typing error shall make no folder
        raise InputError(f"{path}: cannot be written there; give --report a file in a folder that is there")
    check_file(path)
    if path.exists() and not replace:
        raise InputError(f"{path}: is already there; give another --report, or --force to replace it")


def _write(path: Path, text: str, *, replace: bool) -> None:
    if path.exists() and not replace:
        raise InputError(f"{path}: somebody has written it meanwhile; give another --report")
    try:
        write_file(path, text.encode(errors="replace"))
    except OSError as error:
        why = error.strerror or error
        raise InputError(f"{path}: the report could not be written: {why}; the verdict is what was printed") from error


def _now() -> str:
    return datetime.now().astimezone().isoformat(timespec="seconds")

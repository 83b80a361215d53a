"""Show, export and erase the remembered faults of a running service; let it learn its baseline anew."""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import msgspec

from faultline.options import Parser
from faultline.service.core.decision.relearning import VISITS
from faultline.service.core.errors import InputError
from faultline.service.core.records.event import Diagnosis
from faultline.service.core.records.fault import Fault
from faultline.service.core.records.freeze_frame import FreezeFrame
from faultline.service.protocol.client import ControlClient
from faultline.service.protocol.errors import ProtocolError

EXAMPLE = """examples:
  faultline faults list
  faultline faults show 3
  faultline faults export > faults.json
  faultline faults clear 3
  faultline faults relearn
"""

SOCKET = Path("/run/faultline/control.sock")
PAGE = 500


def main(argv: list[str]) -> int:
    """Runs the command; `list` returns 1 where a fault is there now, `clear` where it could not be kept."""
    parser = Parser("faultline faults", description=__doc__, epilog=EXAMPLE)
    commands = parser.add_subparsers(dest="command", required=True, metavar="list|show|export|clear|relearn")
    each = {name: commands.add_parser(name, help=text, description=text) for name, text in TEXTS.items()}
    for sub in each.values():
        sub.add_argument("--control", type=Path, default=SOCKET, help=f"the service's control socket ({SOCKET})")
    for name in ("list", "show"):
        each[name].add_argument("--json", action="store_true", help="for programs")
    each["show"].add_argument("number", type=int, help="of the fault, as `list` says")
    which = each["clear"].add_mutually_exclusive_group(required=True)
    which.add_argument("number", type=int, nargs="?", help="of the fault, as `list` says")
    which.add_argument("--all", action="store_true", help="all of them")
    each["relearn"].add_argument("system", nargs="?", help="its name, where the service watches several")
    options = parser.parse_args(argv)
    with ControlClient(options.control) as control:
        try:
            return COMMANDS[options.command](control, options)
        except msgspec.ValidationError as error:
            raise InputError(f"{options.control}: answers as another version of faultline: {error}") from error


def _list(control: ControlClient, options: argparse.Namespace) -> int:
    answer = control.ask_json("faults")
    faults = msgspec.convert(answer["faults"], list[Fault])
    if options.json:
        _print(answer)
    elif not faults:
        print("no fault is remembered")
    else:
        for fault in faults:
            print("\n   ".join(_summary(fault)))
    if answer["overflow"] and not options.json:
        print("some were displaced for want of room since all were erased last")
    return 1 if any(fault.status.test_failed for fault in faults) else 0


def _show(control: ControlClient, options: argparse.Namespace) -> int:
    answer = control.ask_json("fault", number=options.number)
    if options.json:
        _print(answer)
        return 0
    fault = msgspec.convert(answer["fault"], Fault)
    print("\n   ".join([*_summary(fault), *_history(fault)]))
    for which, frame in answer["frames"].items():
        if frame is not None:
            print(f"\n{'when it was told first' if which == 'first' else 'the last time'}:")
            print("\n".join(_frame(msgspec.convert(frame, FreezeFrame))))
    return 0


def _export(control: ControlClient, _options: argparse.Namespace) -> int:
    """Print one JSON document: the state, the faults with their freeze frames, and all records in the store."""
    answer = control.ask_json("faults")
    faults = [control.ask_json("fault", number=fault["number"]) for fault in answer["faults"]]
    records: list[Any] = []
    after = 0
    while True:
        try:
            page = control.ask_json("records", after=after, count=PAGE)["records"]
        except ProtocolError as error:
            if error.code != "busy":
                raise
            print(f"faultline faults: {error}; exported without what was told", file=sys.stderr)
            break
        if not page:
            break
        records, after = records + page, page[-1]["seq"]
    _print(
        {
            "schema": "faultline.export/1",
            "state": control.ask_json("state"),
            "overflow": answer["overflow"],
            "faults": faults,
            "records": records,
        }
    )
    return 0


def _clear(control: ControlClient, options: argparse.Namespace) -> int:
    try:
        answer = control.ask_json("clear", number=options.number)
    except ProtocolError as error:
        if error.code != "not-kept":
            raise
        print(f"faultline faults: {error}", file=sys.stderr)
        return 1
    cleared = ", ".join(map(str, answer["cleared"]))
    print(f"erased: {cleared}" if cleared else "nothing was remembered")
    return 0


def _relearn(control: ControlClient, options: argparse.Namespace) -> int:
    """After a repair: what the system's residuals are without a fault is learnt anew."""
    answer = control.ask_json("relearn", name=options.system)
    modes = ", ".join(answer["baseline"]["wanting"])
    print(
        f"{answer['system']}: learns its baseline anew, and finds no fault until then. Operate it in each mode "
        f"({modes}), {VISITS} times at least. Remembered faults stay: see `faultline faults clear`"
    )
    return 0


TEXTS = {
    "list": "What is remembered; exit code 1 where a fault is there now.",
    "show": "One fault, with what was seen when it was told.",
    "export": "Everything, as one JSON document.",
    "clear": "Erases one fault, or all; what is still there is told anew.",
    "relearn": "After a repair or with another sensor: learns anew what is usual without a fault.",
}
COMMANDS = {"list": _list, "show": _show, "export": _export, "clear": _clear, "relearn": _relearn}


def _print(answer: object) -> None:
    print(json.dumps(answer, indent=1, ensure_ascii=False))


def _summary(fault: Fault) -> list[str]:
    """Return the lines of a fault: system, status, candidates, occurrences."""
    codes = ", ".join(f"SPN {code.spn} FMI {code.fmi}" for code in fault.dtcs) or "no J1939 code"
    return [
        f"{fault.number}. {fault.system}: {fault.status.words}, status 0x{fault.mask:02X}, {codes}",
        *(_candidate(each) for each in fault.diagnoses),
        f"seen {fault.occurrences} {'time' if fault.occurrences == 1 else 'times'}, first {_when(fault.first.wall)}, "
        f"last {_when(fault.latest.wall)}",
    ]


def _candidate(diagnosis: Diagnosis) -> str:
    likelihood = "" if diagnosis.p is None else f", p = {diagnosis.p:.3f}"
    near = f" near {', '.join(diagnosis.near)}" if diagnosis.near else ""
    return f"{diagnosis.rank}. {' and '.join(diagnosis.faults) or f'unknown{near}'}{likelihood}"


def _when(wall: str | None) -> str:
    return wall or "at an unknown time"


def _history(fault: Fault) -> list[str]:
    return [
        f"components: {', '.join(fault.components) or 'none that the model knows'}",
        f"fired: {' '.join(fault.tests)}; seen in the modes: {' '.join(fault.modes) or 'none'}",
        f"operation cycles in a row with it {fault.trips}, without it {fault.healing}, then {fault.aging}; "
        f"last in cycle {fault.latest.cycle}",
        f"bundle {fault.bundle[:12]}",
    ]


def _frame(frame: FreezeFrame) -> list[str]:
    """Return the lines of a freeze frame."""
    return [
        f"  {_when(frame.wall)}, {frame.t_s:g} s into the drive, mode {frame.mode}, event {frame.event}",
        *(
            f"  {each.signal:<10} {_number(each.value)} {each.unit:<6} {each.quality}"
            + (f", {each.age_s:g} s old" if each.age_s else "")
            for each in frame.inputs
        ),
        *(
            f"  {each.generator:<10} residual {each.residual:+.4g} of {each.predicts} {each.predicted:.5g}, "
            f"sum {each.sum:+.2f} of the threshold, {each.verdict}"
            for each in frame.tests
        ),
        f"  conditions: {', '.join(frame.conditions) or 'none'}",
    ]


def _number(value: float | None) -> str:
    return f"{'never':>12}" if value is None else f"{value:12.6g}"

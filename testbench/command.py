"""The test rig: simulate a urea dosing system, with a fault if wanted, and write a bench recording of it."""

import argparse
import json
import math
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import get_args

from rich.console import Console
from rich.progress import Progress

from testbench.bus import load_dbc
from testbench.can_logger import FORMATS
from testbench.cycles import CYCLES, cycle
from testbench.effects import EFFECTS, PROFILES, checked
from testbench.errors import RigError
from testbench.faults import FAULTS, Course, Fault
from testbench.recording import Request, default_name, record
from testbench.second_logger import RANGES, SecondLogger
from testbench.sizes import frozen
from testbench.vehicles import VEHICLES, vehicle

SIZES = ("small", "large")

EXAMPLES = """examples:
  faultline rig list
  faultline rig record --cycle training --seed 1 --out recordings --truth truth
  faultline rig record --cycle drive --seed 2 --out recordings --truth truth
  faultline rig record --cycle validation --fault fA_du --size 0.65 --onset 200 --seed 3 --out recordings --truth truth
  faultline rig record --cycle drive --vehicle truck-7 --effect leak=0.2 --effect sensor_lag --out recs --truth truth
  faultline rig record --cycle drive --logger starts_s=-87.3 --logger drift_ppm=150 --out recordings --truth truth
"""


def main(argv: list[str]) -> int:
    """Runs `faultline rig ARGV`; returns 0, or 2 after an error in one line on stderr."""
    arguments = _parser().parse_args(argv)
    try:
        return _list(arguments) if arguments.action == "list" else _record(arguments)
    except RigError as error:
        print(f"faultline rig: error: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="faultline rig",
        description=__doc__,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    actions = parser.add_subparsers(dest="action", required=True)
    show = actions.add_parser("list", help="print cycles, vehicles and faults")
    show.add_argument("--json", action="store_true", help="for a program to read")
    make = actions.add_parser(
        "record",
        help="write a bench recording and, apart from it, its truth",
        description="Write a bench recording to OUT/<id>/ and its truth to TRUTH/<id>.toml.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    make.add_argument("--cycle", required=True, help=f"one of {', '.join(CYCLES)}, or a file *.toml")
    make.add_argument("--vehicle", default="bench", help="default: bench")
    make.add_argument(
        "--fault", action="append", default=[], help="name of a fault (again for another); without it there is none"
    )
    make.add_argument("--size", action="append", default=[], type=_size, help="of each fault: a number, small or large")
    make.add_argument(
        "--onset", action="append", default=[], type=_number, help="s after the first frame from which it is present"
    )
    make.add_argument(
        "--course", action="append", default=[], choices=get_args(Course), help="of each fault (default: abrupt)"
    )
    make.add_argument(
        "--profile", default="realistic", choices=list(PROFILES), help="which effects are always there (realistic)"
    )
    make.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME[=SIZE]",
        help="a hidden effect (default: its typical size)",
    )
    make.add_argument(
        "--logger",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="of the second logger: " + ", ".join(f"{n} {a:g}..{b:g}" for n, (a, b) in RANGES.items()),
    )
    make.add_argument("--seed", type=_seed, default=0, help="of noise, clocks and random cycles (default: 0)")
    make.add_argument("--duration", type=_number, default=480.0, help="s (default: 480)")
    make.add_argument("--id", type=_identifier, help="name of the recording (default: VEHICLE-CYCLE-sSEED[-FAULT])")
    make.add_argument("--out", type=Path, required=True, help="folder of the recordings")
    make.add_argument("--truth", type=Path, required=True, help="another folder, of the truths")
    make.add_argument("--format", default="log", choices=FORMATS, help="of the CAN log (default: log, candump's text)")
    make.add_argument("--dbc", type=Path, help="DBC to encode with (default: the one that comes with faultline)")
    make.add_argument("--force", action="store_true", help="replace what is already there")
    return parser


def _list(arguments: argparse.Namespace) -> int:
    tables: dict[str, dict[str, str]] = {
        "cycles": {name: entry.text for name, entry in CYCLES.items()},
        "vehicles": {name: entry.text for name, entry in VEHICLES.items()},
        "faults": {
            name: f"{text}; {size}" + (", small {:g}, large {:g}".format(*frozen()[name]) if name in frozen() else "")
            for name, (text, size) in FAULTS.items()
        },
        "effects": {name: f"{e.text}; {e.typical:g} {e.unit}, set {e.set}" for name, e in EFFECTS.items()},
    }
    if arguments.json:
        print(json.dumps({"schema": 1, **tables}, indent=2))
        return 0
    for title, table in tables.items():
        print(title)
        for name, text in table.items():
            print(f"  {name:<18}  {text}")
    return 0


def _record(arguments: argparse.Namespace) -> int:
    faults = _faults(arguments)
    chosen = cycle(arguments.cycle)
    name = arguments.id or default_name(
        arguments.vehicle, chosen.name, arguments.seed, [fault.name for fault in faults]
    )
    request = Request(
        name,
        vehicle(arguments.vehicle),
        chosen,
        faults,
        arguments.seed,
        arguments.duration,
        PROFILES[arguments.profile] | _effects(arguments.effect),
        arguments.format,
        _logger(arguments.logger),
    )
    dbc = load_dbc(arguments.dbc)
    with _progress(name) as progress:
        folder, truth = record(request, dbc, arguments.out, arguments.truth, force=arguments.force, progress=progress)
    print(f"recording {folder}\ntruth     {truth}")
    return 0


def _faults(arguments: argparse.Namespace) -> tuple[Fault, ...]:
    """The faults that the options ask for; name, size and onset of each belong together."""
    names, sizes, onsets = arguments.fault, arguments.size, arguments.onset
    courses = arguments.course or ["abrupt"] * len(names)
    if not len(names) == len(sizes) == len(onsets) == len(courses):
        raise RigError(
            "--fault, --size and --onset belong together; give all three for each fault, --course too or never"
        )
    return tuple(
        Fault(name, _absolute(name, size), onset, course)
        for name, size, onset, course in zip(names, sizes, onsets, courses, strict=True)
    )


def _absolute(name: str, size: float | str) -> float:
    """A size by number, or by its name in the frozen list."""
    if isinstance(size, float):
        return size
    if name not in frozen():
        raise RigError(f"there is no small or large {name!r}; choose one of {', '.join(frozen())}")
    return frozen()[name][SIZES.index(size)]


def _effects(words: list[str]) -> dict[str, float]:
    """Names with sizes; the typical one where none is said."""
    found: dict[str, float] = {}
    for word in words:
        name, equals, size = word.partition("=")
        if name in found:
            raise RigError(f"--effect {word}: {name} comes twice; give it once")
        if name not in EFFECTS:
            raise RigError(f"there is no effect {name!r}; choose one of {', '.join(EFFECTS)}")
        try:
            found[name] = float(size) if equals else EFFECTS[name].typical
        except ValueError as error:
            raise RigError(f"--effect {word}: {size!r} is no size; write it like leak=0.2") from error
    return checked(found)


def _logger(words: list[str]) -> SecondLogger:
    """The second logger as the options set it."""
    given: dict[str, float] = {}
    for word in words:
        name, _, text = word.partition("=")
        if name not in RANGES:
            raise RigError(f"--logger {word}: there is no {name!r}; choose one of {', '.join(RANGES)}")
        if name in given:
            raise RigError(f"--logger {word}: {name} comes twice; give it once")
        try:
            given[name] = float(text)
        except ValueError as error:
            raise RigError(f"--logger {word}: {text!r} is no number; write it like drift_ppm=150") from error
    return SecondLogger(**given)


@contextmanager
def _progress(name: str) -> Iterator[Callable[[float], None]]:
    """A progress bar on stderr, moved by the function it gives; none where stderr is not a terminal."""
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task(name, total=1.0)
        yield lambda part: bars.update(task, completed=part)


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    return value


def _size(text: str) -> float | str:
    return text if text in SIZES else _number(text)


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 on")
    return int(text)


def _identifier(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", text):
        raise argparse.ArgumentTypeError(f"{text!r} is no name for a folder; use letters, digits, . _ -")
    return text

"""The test rig: simulate a urea dosing system, with a fault if wanted, and record it or play it onto a bus."""

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import get_args

from rich.console import Console
from rich.progress import Progress

from faultline.options import Parser
from faultline.testbench import tanks
from faultline.testbench.bus import load_dbc
from faultline.testbench.can_logger import FORMATS
from faultline.testbench.cycles import CYCLES, check_duration
from faultline.testbench.effects import EFFECTS, PROFILE_TEXTS
from faultline.testbench.errors import RigError
from faultline.testbench.families.circuit import HIDDEN
from faultline.testbench.families.draw import FAMILIES, plant_of
from faultline.testbench.families.recording import record as record_family
from faultline.testbench.families.recording import truth
from faultline.testbench.faults import FAULTS
from faultline.testbench.options import add_logger, add_run, number, numbers, requested
from faultline.testbench.recording import record, truth_of
from faultline.testbench.request import Kind
from faultline.testbench.sizes import frozen
from faultline.testbench.tanks import FAULTS as TANK_FAULTS
from faultline.testbench.vehicles import VEHICLES
from faultline.writing import write_file

EXAMPLES = """examples:
  faultline rig list
  faultline rig record --cycle training --seed 1 --out recordings --truth truth
  faultline rig record --cycle drive --seed 2 --out recordings --truth truth
  faultline rig record --cycle validation --fault fA_du --size 0.65 --onset 200 --seed 3 --out recordings --truth truth
  faultline rig record --cycle drive --vehicle truck-7 --effect leak=0.2 --effect sensor_lag --out recs --truth truth
  faultline rig record --cycle drive --kind instrumented --profile everyday --seed 2 --out logs --truth truth
  faultline rig play --cycle drive --vehicle truck --bus udp_multicast:239.74.163.2:43113 --speed 20
  faultline rig picture recordings/bench-training-s1 --truth truth/bench-training-s1.toml --out training.png
  faultline rig family slow --number 3 --effect air=5e-6 --out other --truth truth
  faultline rig tanks --out tanks/leak --seed 7 --fault f_leak2 --size 5e-6 --onset 240
  faultline rig record --cycle drive --logger starts_s=-87.3 --logger drift_ppm=150 --out recordings --truth truth
"""


def main(argv: list[str]) -> int:
    """Runs `faultline rig ARGV`; returns 0, or 2 after an error in one line on stderr."""
    arguments = _parser().parse_args(argv)
    try:
        return ACTIONS[arguments.action](arguments)
    except RigError as error:
        print(f"faultline rig: error: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="faultline rig",
        description=__doc__,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    actions = parser.add_subparsers(dest="action", required=True)

    def action(name: str, about: str, description: str) -> argparse.ArgumentParser:
        form = argparse.RawDescriptionHelpFormatter
        return actions.add_parser(name, help=about, description=description, epilog=EXAMPLES, formatter_class=form)

    show = action(
        "list", "print cycles, vehicles, faults, profiles, effects", "Print what the other actions can be given."
    )
    show.add_argument("--json", action="store_true", help="for a program to read")
    make = action(
        "record",
        "write a recording and, apart from it, its truth",
        "Write a recording to OUT/<id>/ and its truth to TRUTH/<id>.toml.",
    )
    add_run(make)
    add_logger(make)
    make.add_argument(
        "--kind",
        default="bench",
        choices=get_args(Kind),
        help="instrumented: everything on CAN; production: without the added sensors (default: bench)",
    )
    make.add_argument("--out", type=Path, required=True, help="folder of the recordings")
    make.add_argument("--truth", type=Path, required=True, help="another folder, of the truths")
    make.add_argument("--format", default="log", choices=FORMATS, help="of the CAN log (default: log, candump's text)")
    make.add_argument("--force", action="store_true", help="replace what is already there")
    live = action(
        "play",
        "play an instrumented vehicle live onto a bus",
        "Play an instrumented vehicle onto a bus while it is simulated. Ctrl-C ends it.",
    )
    add_run(live)
    live.add_argument("--bus", required=True, help="socketcan:NAME or udp_multicast:GROUP:PORT; it must be there")
    live.add_argument("--speed", type=number, default=1.0, help="how many times real time (default: 1)")
    live.add_argument("--truth", type=Path, help="file to write the truth to")
    other = action(
        "tanks", "another system: three tanks", "Write a log of a bench of three tanks (docs/your-system.md)."
    )
    _add_tanks(other)
    _add_family(action("family", "plants of other structures", "Write two recordings of a plant of another structure."))
    drawn = action("picture", "draw a recording", "Draw a recording's signals on their loggers' own clocks.")
    drawn.add_argument("recording", type=Path, help="its folder")
    drawn.add_argument("--out", type=Path, required=True, help="PNG file to write")
    drawn.add_argument("--truth", type=Path, help="its truth, to shade the faults")
    return parser


def _add_tanks(other: argparse.ArgumentParser) -> None:
    other.add_argument("--out", type=Path, required=True, help="folder to write log.csv into")
    other.add_argument("--can", action="store_true", help="write can.log and tanks.dbc instead")
    other.add_argument("--seed", type=int, default=1, help="of the commands and the noise (1)")
    other.add_argument("--duration", type=number, default=480.0, help="s (480)")
    other.add_argument("--fault", choices=TANK_FAULTS, help="without one there is none")
    other.add_argument(
        "--size", type=number, help="of the fault: " + "; ".join(f"{k}: {v}" for k, v in TANK_FAULTS.items())
    )
    other.add_argument("--onset", type=number, help="s after which it is there (half of the duration)")
    other.add_argument("--truth", type=Path, metavar="DIR", help="write there what was wrong, for `faultline evaluate`")
    other.add_argument("--force", action="store_true", help="replace what is already there")


def _add_family(other: argparse.ArgumentParser) -> None:
    other.add_argument("family", choices=FAMILIES, help="; ".join(f"{k}: {v.text}" for k, v in FAMILIES.items()))
    other.add_argument("--number", type=int, default=1, help="of the plant (1)")
    hidden = "; ".join(f"{name}: {text}" for name, text in HIDDEN.items())
    other.add_argument("--effect", action="append", default=[], metavar="NAME=SIZE", help=f"hidden in it: {hidden}")
    other.add_argument("--duration", type=number, default=480.0, help="s (480)")
    other.add_argument("--out", type=Path, required=True, help="folder of the recordings training and held-out")
    other.add_argument("--truth", type=Path, required=True, help="another folder, of what is hidden and its values")


def _list(arguments: argparse.Namespace) -> int:
    tables: dict[str, dict[str, str]] = {
        "cycles": {name: entry.text for name, entry in CYCLES.items()},
        "vehicles": {name: entry.text for name, entry in VEHICLES.items()},
        "faults": {
            name: f"{text}; {size}" + (", small {:g}, large {:g}".format(*frozen()[name]) if name in frozen() else "")
            for name, (text, size) in FAULTS.items()
        },
        "profiles": PROFILE_TEXTS,
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
    request = requested(arguments, arguments.kind, arguments.logger, arguments.format)
    dbc = load_dbc(arguments.dbc)
    with _progress(request.name) as progress:
        folder, truth = record(request, dbc, arguments.out, arguments.truth, force=arguments.force, progress=progress)
    print(f"recording {folder}\ntruth     {truth}")
    return 0


def _play(arguments: argparse.Namespace) -> int:
    from faultline.testbench.live_bus import on_bus  # python-can takes a quarter of a second to load
    from faultline.testbench.play import live, play

    request = requested(arguments, "instrumented")
    if not arguments.speed > 0.0:
        raise RigError(f"--speed {arguments.speed:g} is not above zero")
    if arguments.truth and arguments.truth.exists():
        raise RigError(f"{arguments.truth} exists; remove it or give --truth another name")
    dbc = load_dbc(arguments.dbc)
    with on_bus(arguments.bus) as send:
        if arguments.truth:
            write_file(arguments.truth, truth_of(request))
        played = play(live(request, dbc), send, arguments.speed, _say)
    _say(
        f"{played.frames} frames of {played.time_s:.1f} s in {played.wall_s:.1f} s, "
        f"the latest {1e3 * played.worst_s:.1f} ms behind its time"
    )
    return 0


def _picture(arguments: argparse.Namespace) -> int:
    from faultline.testbench.picture import draw  # matplotlib takes a second to load
    from faultline.testbench.recorded import read_recording

    draw(read_recording(arguments.recording), arguments.truth, arguments.out)
    print(f"picture   {arguments.out}")
    return 0


def _say(text: str) -> None:
    print(f"faultline rig: {text}", file=sys.stderr, flush=True)


def _tanks(arguments: argparse.Namespace) -> int:
    if (arguments.fault is None) != (arguments.size is None):
        raise RigError("--fault and --size go together; give both or none")
    if arguments.out.exists() and not arguments.force:
        raise RigError(f"{arguments.out} exists; give another folder or --force")
    onset_s = arguments.duration / 2 if arguments.onset is None else arguments.onset
    fault = None if arguments.fault is None else tanks.Fault(arguments.fault, arguments.size, onset_s)
    if arguments.truth is not None:
        write_file(arguments.truth / f"{arguments.out.name}.toml", tanks.truth(arguments.out.name, fault))
    for path in tanks.write(arguments.out, tanks.run(arguments.seed, arguments.duration, fault), can=arguments.can):
        print(path)
    return 0


def _family(arguments: argparse.Namespace) -> int:
    check_duration(arguments.duration)
    effects = numbers("--effect", arguments.effect, HIDDEN, "air=5e-6")
    plant = plant_of(arguments.family, arguments.number, effects)
    write_file(arguments.truth / f"{plant.name}.toml", truth(plant))
    for k, name in enumerate(("training", "held-out")):
        seed, title = 2 * arguments.number + k, f"{plant.name}-{name}"
        print(record_family(plant, title, seed, arguments.duration, load_dbc(), arguments.out))
    return 0


ACTIONS: dict[str, Callable[[argparse.Namespace], int]] = {
    "list": _list, "record": _record, "play": _play, "picture": _picture, "tanks": _tanks, "family": _family,
}  # fmt: skip


@contextmanager
def _progress(name: str) -> Iterator[Callable[[float], None]]:
    """A progress bar on stderr, moved by the function it gives; none where stderr is not a terminal."""
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task(name, total=1.0)
        yield lambda part: bars.update(task, completed=part)

"""The options that say what is asked of the rig, and the request that they make."""

import argparse
import math
import re
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import get_args

from faultline.testbench.cycles import CYCLES, cycle
from faultline.testbench.day import day_of
from faultline.testbench.effects import EFFECTS, PROFILES, checked
from faultline.testbench.errors import RigError
from faultline.testbench.faults import Course, Fault
from faultline.testbench.request import Kind, Request, default_name
from faultline.testbench.second_logger import RANGES, SecondLogger
from faultline.testbench.sizes import frozen
from faultline.testbench.vehicles import vehicle

SIZES = ("small", "large")


def add_run(parser: argparse.ArgumentParser) -> None:
    """What `record` and `play` have in common."""
    add = parser.add_argument
    add("--cycle", required=True, help=f"one of {', '.join(CYCLES)}, or a file *.toml")
    add("--vehicle", default="bench", help="default: bench")
    add("--fault", action="append", default=[], help="name of a fault (again for another); without it there is none")
    add("--size", action="append", default=[], type=_size, help="of each --fault in turn: a number, small or large")
    add("--onset", action="append", default=[], type=number, help="s after the first frame from which it is present")
    courses = get_args(Course)
    add("--course", action="append", default=[], choices=courses, help="of each fault (default: abrupt)")
    add("--profile", default="realistic", choices=list(PROFILES), help="what is always there (realistic)")
    add(
        "--effect",
        action="append",
        default=[],
        metavar="NAME[=SIZE]",
        help="a hidden effect (default: its typical size)",
    )
    add("--seed", type=_seed, default=0, help="of noise, clocks and random cycles (default: 0)")
    add("--duration", type=number, help="s (default: 480, or to the end of the cycle in a file)")
    add("--id", type=_identifier, help="name of the recording (default: VEHICLE-CYCLE-sSEED[-FAULT])")
    add("--dbc", type=Path, help="DBC to encode with (default: the one that comes with faultline)")


def add_logger(parser: argparse.ArgumentParser) -> None:
    """How the second logger is set."""
    ranges = ", ".join(f"{name} {low:g}..{high:g}" for name, (low, high) in RANGES.items())
    parser.add_argument(
        "--logger", action="append", default=[], metavar="NAME=VALUE", help=f"of the second logger: {ranges}"
    )


def requested(arguments: argparse.Namespace, kind: Kind, words: Sequence[str] = (), form: str = "log") -> Request:
    """What the options of `add_run` ask for, with the second logger as `words` set it.

    Raises:
        RigError: something is unknown, out of range or contradictory.
    """
    faults, chosen = _faults(arguments), cycle(arguments.cycle)
    name = default_name(arguments.vehicle, chosen.name, arguments.seed, [fault.name for fault in faults])
    return Request(
        arguments.id or name,
        vehicle(arguments.vehicle),
        chosen,
        faults,
        arguments.seed,
        chosen.usual_s if arguments.duration is None else arguments.duration,
        PROFILES[arguments.profile] | _effects(arguments.effect),
        form,
        kind,
        SecondLogger(**numbers("--logger", words, RANGES, "drift_ppm=150")),
        day_of(arguments.profile, arguments.seed, chosen.name),
    )


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
    """Effects with sizes; the typical one where none is said."""
    filled = [word if "=" in word or word not in EFFECTS else f"{word}={EFFECTS[word].typical!r}" for word in words]
    return checked(numbers("--effect", filled, EFFECTS, "leak=0.2"))


def numbers(option: str, words: Sequence[str], known: Collection[str], example: str) -> dict[str, float]:
    """The words NAME=NUMBER of a repeated option."""
    found: dict[str, float] = {}
    for word in words:
        name, _, text = word.partition("=")
        if name not in known:
            raise RigError(f"{option} {word}: there is no {name!r}; choose one of {', '.join(known)}")
        if name in found:
            raise RigError(f"{option} {word}: {name} comes twice; give it once")
        try:
            found[name] = float(text)
        except ValueError as error:
            raise RigError(f"{option} {word}: {text!r} is no number; write it like {example}") from error
    return found


def number(text: str) -> float:
    """An option's finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a finite number")
    return value


def _size(text: str) -> float | str:
    return text if text in SIZES else number(text)


def _seed(text: str) -> int:
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 on")
    return int(text)


def _identifier(text: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", text):
        raise argparse.ArgumentTypeError(f"{text!r} is no name for a folder; use letters, digits, . _ -")
    return text

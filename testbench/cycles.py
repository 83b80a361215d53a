"""Cycles: what is asked of the rig over time, as in thesis 5.7.1.

Every cycle stands still first (the external sensors' zero), then builds pressure, and doses only from `DOSING_FROM` on.
"""

import re
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import cycle as repeat
from pathlib import Path

import numpy as np

from faultline.testbench.errors import RigError
from faultline.testbench.units import BAR

STANDING = 15.0  # s, pump off at atmospheric pressure: 150 samples, a zero to a tenth of the noise
DOSING_FROM = 40.0  # s, ten after the pressure has settled at 10 bar
SYSTEM = 10 * BAR  # Pa absolute
SHORTEST = 60.0  # s, room for some dosing
_RANGES = {"duration_s": (0.1, 36_000.0), "setpoint_bar": (1.5, 13.0), "duty": (0.0, 1.0)}  # of a written segment
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


@dataclass(frozen=True)
class Segment:
    """`duration` [s] at pressure `setpoint` [Pa absolute, None: pump off] and dose `duty` [0..1]."""

    duration: float
    setpoint: float | None
    duty: float = 0.0


@dataclass(frozen=True)
class Cycle:
    """A named cycle: `body(duration, rng)` yields what follows the start; it may yield more than fits.

    `usual_s` is how long a recording of it is where nothing else is asked for.
    """

    name: str
    text: str
    body: Callable[[float, np.random.Generator], Iterator[Segment]]
    usual_s: float = 480.0

    def segments(self, duration: float, rng: np.random.Generator) -> list[Segment]:
        """Segments that fill exactly `duration` [s]; raises `RigError` if that is too short."""
        check_duration(duration)
        start = [Segment(STANDING, None), Segment(DOSING_FROM - STANDING, SYSTEM)]
        left = duration - DOSING_FROM
        for segment in self.body(left, rng):
            if segment.duration >= left:
                return [*start, Segment(left, segment.setpoint, segment.duty)]
            start.append(segment)
            left -= segment.duration
        return [*start, Segment(left, SYSTEM)]


# (duration [s], duty). Idle and maximum come back within every 60 to 90 s in both tables; the values between differ.
_TRAINING = (
    (12, 0.10), (14, 0.30), (16, 1.0), (13, 0.0), (10, 0.60), (14, 0.20), (9, 0.80), (15, 1.0), (12, 0.0), (8, 0.45),
    (14, 0.70), (11, 0.05), (15, 1.0), (14, 0.90), (13, 0.0), (16, 0.50), (12, 0.25), (14, 1.0), (10, 0.15), (12, 0.0),
)  # fmt: skip
_VALIDATION = (
    (16, 0.40), (15, 1.0), (14, 0.0), (18, 0.75), (14, 1.0), (12, 0.15), (15, 0.0), (17, 0.55), (16, 1.0), (15, 0.35),
    (14, 0.0), (16, 0.85), (13, 0.08), (15, 1.0), (16, 0.0), (18, 0.25), (14, 0.65), (16, 1.0), (15, 0.0),
)  # fmt: skip
_LADDER = (8.0, 6.0, 7.0, 9.0, 11.0, 12.0, 10.0)  # bar absolute
_EXCITING = (7.5, 12.0)  # bar absolute
_LADDER_SHARE = 0.3  # of the time after the start: seven rungs of 19 s in 480 s, each several time constants


def _training(duration: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Dose steps of many sizes, then a pressure ladder without dosing; the same for every seed."""
    del rng
    left = (1 - _LADDER_SHARE) * duration
    for length, duty in repeat(_TRAINING):
        yield Segment(min(length, left), SYSTEM, duty)
        left -= length
        if left <= 0:
            break
    for level in _LADDER:
        yield Segment(_LADDER_SHARE * duration / len(_LADDER), level * BAR)


def _validation(duration: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Other dose steps at other times, in the same range; the same for every seed."""
    del duration, rng
    for length, duty in repeat(_VALIDATION):
        yield Segment(length, SYSTEM, duty)


def _maximum(duration: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Long sections of maximum dose between idle and half dose; the same for every seed."""
    del duration, rng
    for length, duty in repeat(((60, 1.0), (20, 0.0), (45, 1.0), (25, 0.5))):
        yield Segment(length, SYSTEM, duty)


def _drive(duration: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Doses as a road might ask for: a quarter idle, some at maximum, the rest anything between."""
    del duration
    while True:
        length = rng.uniform(4, 25)
        yield Segment(length, SYSTEM, _asked(rng))


def _excite(duration: float, rng: np.random.Generator) -> Iterator[Segment]:
    """Random pressures and doses, which change one without the other or both at once; other ones for every seed."""
    del duration
    setpoint, dose = SYSTEM, 0.0
    while True:
        changes = rng.random()
        if changes < 0.7:
            setpoint = rng.uniform(*_EXCITING) * BAR
        if changes > 0.3:
            dose = _asked(rng)
        yield Segment(rng.uniform(4, 16), setpoint, dose)


def _asked(rng: np.random.Generator) -> float:
    """A dose as a road might ask for it."""
    kind, duty = rng.random(), rng.uniform(0.05, 0.95)
    return 0.0 if kind < 0.25 else 1.0 if kind > 0.85 else float(duty)


CYCLES = {
    "training": Cycle("training", "dose steps of many sizes, then a pressure ladder from 6 to 12 bar", _training),
    "validation": Cycle(
        "validation", "other dose steps; idle, partial and maximum dose within every 90 s", _validation
    ),
    "maximum": Cycle("maximum", "long sections of maximum dose", _maximum),
    "drive": Cycle("drive", "random doses, other ones for every seed", _drive),
    "excite": Cycle(
        "excite", "random pressures and doses, apart and together: networks learn the plant, not the loop", _excite
    ),
}


def check_duration(duration: float) -> None:
    """Raises `RigError` if `duration` [s] leaves no room to dose."""
    if duration < SHORTEST:
        raise RigError(f"duration {duration:g} s is too short for a cycle; give at least {SHORTEST:g}")


def cycle(name: str) -> Cycle:
    """The cycle called `name`, or that in the file of this name (*.toml); raises `RigError` if there is none."""
    if name.endswith(".toml"):
        return read_cycle(Path(name))
    if name not in CYCLES:
        raise RigError(f"there is no cycle {name!r}; choose one of {', '.join(CYCLES)}, or give a file *.toml")
    return CYCLES[name]


def read_cycle(path: Path) -> Cycle:
    """A cycle written down: what follows the start, from the time `DOSING_FROM` on.

        schema = 1
        name = "half-dose"
        text = "what it is for"
        [[segment]]
        duration_s = 30.0
        setpoint_bar = 10.0    # absolute; none: the pump is off; below 7 the controller does not dose
        duty = 0.5             # of the dosing valve, 0..1; 0 if absent

    A recording ends with the last segment; in a longer one the pressure is held without dosing.

    Raises:
        RigError: it cannot be read, or something in it is unknown, missing or out of range.
    """
    try:
        data = tomllib.loads(path.read_text())
    except (OSError, UnicodeDecodeError) as error:
        raise RigError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}") from error
    except tomllib.TOMLDecodeError as error:
        raise RigError(f"{path}: not TOML: {error}") from error
    if data.get("schema") != 1:
        raise RigError(f"{path}: schema: must be 1, not {data.get('schema')!r}")
    name, text, tables = data.get("name"), data.get("text", ""), data.get("segment")
    _only(data, ("schema", "name", "text", "segment"), str(path))
    if not isinstance(name, str) or not _NAME.fullmatch(name):
        raise RigError(f"{path}: name: {name!r} is no name for a folder; use letters, digits, . _ -")
    if not isinstance(text, str) or not isinstance(tables, list) or not tables:
        raise RigError(f"{path}: segment: needs at least one [[segment]], and text to be a text")
    segments = [_segment(table, f"{path}: segment[{k}]") for k, table in enumerate(tables)]
    whole_s = DOSING_FROM + sum(segment.duration for segment in segments)
    return Cycle(name, text, partial(_written, segments), max(whole_s, SHORTEST))


def _written(segments: list[Segment], duration: float, rng: np.random.Generator) -> Iterator[Segment]:
    del duration, rng
    return iter(segments)


def _segment(table: object, place: str) -> Segment:
    if not isinstance(table, dict):
        raise RigError(f"{place}: must be a table")
    _only(table, tuple(_RANGES), place)
    for key, (low, high) in _RANGES.items():
        value = table.get(key)
        if value is None and key != "duration_s":
            continue
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
            raise RigError(f"{place}.{key}: must be a number from {low:g} to {high:g}, not {value!r}")
    setpoint = table.get("setpoint_bar")
    if setpoint is None and table.get("duty"):
        raise RigError(f"{place}.duty: nothing is dosed while the pump is off; give a setpoint_bar")
    return Segment(
        float(table["duration_s"]), None if setpoint is None else setpoint * BAR, float(table.get("duty", 0.0))
    )


def _only(table: dict[str, object], allowed: tuple[str, ...], place: str) -> None:
    for key in table:
        if key not in allowed:
            raise RigError(f"{place}: {key}: unknown key; allowed here are {', '.join(allowed)}")

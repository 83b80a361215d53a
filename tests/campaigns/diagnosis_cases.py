"""What the diagnosis campaign records: vehicles, hidden effects, faults, sizes and pairs, all declared here by number.

Numbers of vehicles are new: 1 to 8 are those that the decision was chosen on, 201 to 208 and 301 have been looked at.
Nothing here was chosen by what a decision said.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np

from faultline.testbench.cycles import CYCLES
from faultline.testbench.day import day_of
from faultline.testbench.effects import PROFILES
from faultline.testbench.faults import Fault, limit
from faultline.testbench.request import Request
from faultline.testbench.sizes import frozen
from faultline.testbench.vehicles import vehicle

Set = Literal["A", "B", "C", "none"]
Kind = Literal["free", "single", "curve", "pair"]

VEHICLES = tuple(range(401, 421))
VEHICLES_C = tuple(range(801, 821))
PLANTS: dict[int, tuple[str, int]] = {
    815: ("counted", 61),
    816: ("counted", 62),
    817: ("swinging", 63),
    818: ("swinging", 64),
    819: ("seldom", 65),
    820: ("seldom", 66),
}
"""Vehicles of set C that are plants of other structures (`faultline.testbench.families`), by family and number."""
BACKLASH = 5
"""Every fifth truck of set C has a sensor with backlash, of which few visits to a mode say little."""
REFERENCE = tuple(range(451, 459))
"""Vehicles of which only fault-free drives are ever seen: what other vehicles' thresholds come from."""

PROFILES_OF: dict[Set, str] = {"A": "everyday", "B": "everyday", "C": "everyday", "none": "realistic"}
"""Every recording has a day of its own, but where nothing is hidden either: what the frozen sizes are small against."""

HIDDEN: dict[Set, dict[str, float]] = {
    "A": {
        "laminar_filters": 0.2,
        "full_lift": 0.05,
        "stiff_hose": 0.35,
        "incomplete_filling": 0.03,
        "pump_slip": 0.05,
        "suction_pulsation": 10.0,
    },
    # Half of what logs plainly show. Not here: what is a fault of the list under another name (leak, worn_return,
    # nozzle_deposit), and a blocked vent, which clogs the suction side as the tank filter does.
    "B": {
        "creeping_hose": 0.3,
        "back_pressure": 0.15,
        "falling_level": 10.0,
        "inlet_spring": 0.05,
        "sensor_gain": 0.01,
        "sensor_backlash": 0.05,
        "speed_scale": 0.015,
    },
    "none": {},
}
HIDDEN["C"] = {**HIDDEN["A"], **HIDDEN["B"]}
"""Modest sizes. Set A is for development; sets B and C are each run once, after a commit that says so."""

FREE, FREE_S = 4, 900.0
"""Fault-free drives of each vehicle, and how long each is [s]."""
FAULTY_S = 900.0
"""So that 300 s of exciting operation and the 300 s after a diagnosis fit behind the onset [s]."""
ONSETS_S = (120.0, 200.0)
"""Between these; each recording has its own."""

CURVE = (0.5, 2.0, 4.0)
"""Parts of the large size, on every `CURVE_EVERY`-th vehicle."""
CURVE_EVERY = 5

_PAIRED = [name for name in frozen() if name not in ("fA_p", "leak_ap")]
PAIRS = (*combinations(_PAIRED, 2), ("fA_t", "fA_p"), ("fA_p", "fy_p_tp"))
"""Thirty: all pairs of the faults that are large in every vehicle, and two with the pump filter."""


@dataclass(frozen=True)
class Case:
    """A recording to be judged: `faults` with their sizes, all from `onset_s` [s] on; `label` is the size in words."""

    number: int
    effects_set: Set
    kind: Kind
    label: str
    faults: tuple[tuple[str, float], ...]
    seed: int
    seconds: float

    @property
    def name(self) -> str:
        """Of the recording."""
        return "-".join([f"truck-{self.number}", self.kind, str(self.seed % 1000), *(f for f, _ in self.faults)])

    @property
    def onset_s(self) -> float:
        """The same for the same seed [s]."""
        return round(float(np.random.default_rng([self.seed, 3]).uniform(*ONSETS_S)), 1)

    @property
    def request(self) -> Request:
        """What is asked of the rig."""
        return replace(self.healthy, faults=tuple(Fault(name, size, self.onset_s) for name, size in self.faults))

    @property
    def healthy(self) -> Request:
        """The same drive without the fault."""
        return request(self.number, self.effects_set, "drive", self.seed, self.seconds)


def hidden(number: int, effects_set: Set) -> dict[str, float]:
    """One or two effects of the set, by the vehicle's number; none for a reference vehicle or a plant of a family."""
    if number in REFERENCE or number in PLANTS or not HIDDEN[effects_set]:
        return {}
    rng = np.random.default_rng([number, 11])
    sizes = HIDDEN[effects_set]
    chosen = [str(name) for name in rng.permutation([*sizes])[: rng.integers(1, 3)]]
    if effects_set == "C" and number % BACKLASH == 0:
        chosen = ["sensor_backlash", *(name for name in chosen[1:] if name != "sensor_backlash")]
    return {name: sizes[name] for name in chosen}


def request(
    number: int,
    effects_set: Set,
    cycle: str,
    seed: int,
    seconds: float,
) -> Request:
    """A fault-free recording of a vehicle, in profile `everyday` on a day of its own."""
    profile = PROFILES_OF[effects_set]
    return Request(
        name=f"truck-{number}-{cycle}-{seed % 1000}",
        vehicle=vehicle(f"truck-{number}"),
        cycle=CYCLES[cycle],
        faults=(),
        seed=seed,
        duration=seconds,
        effects={**PROFILES[profile], **hidden(number, effects_set)},
        kind="instrumented",
        day=day_of(profile, seed, cycle),
    )


def seed_of(number: int, k: int) -> int:
    """The seed of a vehicle's recording `k` (0..999)."""
    return 1000 * number + k


def cases(number: int, effects_set: Set) -> list[Case]:
    """All recordings of a vehicle that are judged."""
    return [*_cases(number, effects_set)]


def _cases(number: int, effects_set: Set) -> Iterator[Case]:
    def case(kind: Kind, k: int, label: str = "", *faults: tuple[str, float], seconds: float = FAULTY_S) -> Case:
        return Case(number, effects_set, kind, label, faults, seed_of(number, k), seconds)

    for k in range(FREE):
        yield case("free", 10 + k, seconds=FREE_S)
    sizes: Mapping[str, tuple[float, float]] = frozen()
    for row, (fault, both) in enumerate(sizes.items()):
        for column, label in enumerate(("small", "large")):
            yield case("single", 100 + 2 * row + column, label, (fault, both[column]))
    if number % CURVE_EVERY == 1 and effects_set != "C":
        for row, (fault, (_, large)) in enumerate(sizes.items()):
            for column, part in enumerate(CURVE):
                if part * large <= limit(fault):
                    yield case("curve", 200 + 10 * row + column, f"{part:g}", (fault, part * large))
    first = number - (VEHICLES_C if effects_set == "C" else VEHICLES)[0]
    for k in range(first % len(VEHICLES), len(PAIRS), len(VEHICLES)):
        one, other = PAIRS[k]
        yield case("pair", 400 + k, "large", (one, sizes[one][1]), (other, sizes[other][1]))

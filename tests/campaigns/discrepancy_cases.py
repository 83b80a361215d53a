"""What the discrepancy campaign hides: cases by number, each with the entry of the library that would be right.

Forms are the rig's own, which differ from the library's. Sizes are converted to the library's parameter, so that what
recordings can show at all (the sensitivities' smallest visible size) is known before anything is searched.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations

from testbench.effects import EFFECTS

VALVE_PERIOD_S = 0.3

SIZES = (0.3, 0.6, 1.0, 2.0)
"""Of an effect's typical size; what is beyond its largest is its largest."""

STRONG = 1.0


@dataclass(frozen=True)
class Truth:
    """The library's `entry` for an effect of the rig, `scale` times the rig's size in its unit; where it acts.

    `also` are entries that describe a part of the same effect; `equations` those of uds4 that it changes.
    """

    entry: str
    scale: float
    equations: tuple[str, ...]
    also: tuple[str, ...] = ()


TRUTHS: dict[str, Truth] = {
    "laminar_filters": Truth("laminar_filters", 1.0, ("e05", "e06", "e07"), ("laminar_bores",)),
    "full_lift": Truth("full_open_gain", 1.0, ("e04",)),
    "opening_delay": Truth("valve_opens_late", 1.0 / VALVE_PERIOD_S, ("e04",)),
    "closing_delay": Truth("valve_shuts_late", 1.0 / VALVE_PERIOD_S, ("e04",)),
    "entrained_air": Truth("entrained_air", 1e-6, ("e10",)),
    "stiff_hose": Truth("stiff_hose", 1.0, ("e10",)),
    "pump_slip": Truth("pump_slip", 1e-6, ("e01", "e02")),
    "incomplete_filling": Truth("incomplete_filling", 30.0 / 33.0, ("e01",)),
    "relief_valve": Truth("relief_valve", 1e-11, ("e10", "e01")),
    "viscosity_drift": Truth("viscosity_drift", 1.0, ("e02",)),
    "cake_growth": Truth("du_filter_cake", 1.0, ("e07",)),
    "sensor_lag": Truth("lag_p_du", 1.0, ("e16",)),
    "leak": Truth("leak_orifice", 1e-6 / 42.0 / 0.7, ("e10",), ()),
    "back_pressure": Truth("nozzle_back_pressure", 1e5, ("e04",)),
    "falling_level": Truth("tank_level_falls", 200.0, ("e05",)),
    "blocked_vent": Truth("tank_vent_blocked", 1000.0, ("e05",)),
    "inlet_spring": Truth("du_inlet_spring", 1e5, ("e07",)),
    "sensor_gain": Truth("gain_p_ap", 1.0, ("e18",)),
    "worn_return": Truth("return_orifice_wears", 1.0, ("e03",)),
    "nozzle_deposit": Truth("nozzle_deposit", 10.0, ("e04",)),
}
"""By the rig's name. A faster pump than it says cannot be told from a larger one: it has no entry, and needs none."""

OUTSIDE: dict[str, tuple[str, ...]] = {
    "creeping_hose": ("e10",),
    "sensor_backlash": ("e16",),
    "log_delay": ("e16", "e17", "e18"),
}
"""Effects that no entry describes, with where they act."""


@dataclass(frozen=True)
class Case:
    """One record of the campaign: `kind` is hidden, nothing, outside or two."""

    name: str
    kind: str
    effects: Mapping[str, float]
    vehicle: str
    seed: int


def cases(set_name: str) -> Iterator[Case]:
    """All cases of the rig's effect set A or B; those with nothing hidden belong to both."""
    first = {"A": 0, "B": 500}[set_name]
    hidden = [name for name in TRUTHS if EFFECTS[name].set == set_name]
    number = first
    for size in SIZES:
        for seed in range(-(-100 // (len(SIZES) * len(hidden)))):
            for name in hidden:
                number += 1
                yield _case(f"{name}-x{size:g}-{seed}", "hidden", {name: _size(name, size)}, number)
    outside = [name for name in OUTSIDE if EFFECTS[name].set == set_name]
    for size in (0.6, 1.0, 2.0):
        for seed in range(5 if outside else 0):
            for name in outside:
                number += 1
                yield _case(f"{name}-x{size:g}-{seed}", "outside", {name: _size(name, size)}, number)
    pairs = [pair for pair in combinations(hidden, 2) if not set(pair) & _ALIKE]
    for k in range(10):
        first_name, second_name = pairs[(k * 7 + 3) % len(pairs)]
        number += 1
        both = {first_name: _size(first_name, 1.0), second_name: _size(second_name, 1.0)}
        yield _case(f"{first_name}+{second_name}", "two", both, number)
    for k in range(150):
        number += 1
        yield _case(f"nothing-{set_name}{k}", "nothing", {}, number)


_ALIKE = {"falling_level", "blocked_vent"}  # together one is hardly an effect beside the other


def _case(name: str, kind: str, effects: Mapping[str, float], number: int) -> Case:
    return Case(f"{number:03d}-{name}", kind, effects, f"truck-{1000 + number}", 20_000 + 7 * number)


def _size(name: str, share: float) -> float:
    return min(share * EFFECTS[name].typical, EFFECTS[name].largest)

"""Sensor placement against the thesis's model and brute force, for all causalities, with and without faulty sensors."""

import itertools
from collections.abc import Sequence
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_diagnosability import INTERPRETATIONS, made, structures

from faultline.analysis.model import ModelError, load_model
from faultline.analysis.structure import Structure, structure_of
from faultline.analysis.structure.diagnosability import Interpretation, detectability, isolability_of
from faultline.analysis.structure.placement import Goal, SensorSet, place_sensors
from faultline.analysis.structure.sensors import add_sensors, drop_sensors

BARE = drop_sensors(structure_of(load_model("uds")), ["y_p_tp", "y_p_ap"])
PRESSURES = ["p_tp", "p_bp", "p_ap", "p_du"]
FLOWS = ["q_pump", "q_ori", "q_dos", "q_filt_t", "q_filt_p", "q_filt_du"]
STEADY = settings(derandomize=True, deadline=None, max_examples=120)


def sets(found: Sequence[SensorSet]) -> set[tuple[str, ...]]:
    return {tuple(sorted(s.sensors)) for s in found}


@pytest.mark.parametrize("faulty", [False, True])
@pytest.mark.parametrize(
    ("positions", "expected"),
    [
        (PRESSURES, {("p_tp",)}),
        (
            [*PRESSURES, *FLOWS],
            {("p_tp", "q_dos"), ("p_tp", "q_ori"), ("q_dos", "q_filt_t"), ("q_filt_t", "q_ori")},
        ),
    ],
)
def test_the_thesis_model_needs_a_pressure_and_a_flow(
    positions: list[str], expected: set[tuple[str, ...]], faulty: bool
) -> None:
    assert sets(place_sensors(BARE, positions, "mixed", faulty=faulty)) == expected
    assert place_sensors(BARE, positions, "mixed", goal="detectability", faulty=faulty) == [SensorSet((), 0.0)]


def test_all_15_unknowns_as_positions_give_the_known_six_sets() -> None:
    found = place_sensors(BARE, BARE.unknowns, "mixed")
    expected = {(p, q) for p in ("p_tp", "q_filt_t", "dp_tp") for q in ("q_ori", "q_dos")}
    assert sets(found) == {tuple(sorted(s)) for s in expected}


def test_the_second_pressure_sensor_buys_integral_isolability() -> None:
    """Of the thesis's two sensors one is enough with mixed causality; residuals that integrate need both."""
    assert place_sensors(BARE, ["p_tp", "p_ap"], "mixed") == [SensorSet(("p_tp",), 1.0)]
    assert place_sensors(BARE, ["p_tp", "p_ap"], "integral") == [SensorSet(("p_tp", "p_ap"), 2.0)]


@pytest.mark.parametrize("faulty", [False, True])
@pytest.mark.parametrize("causality", ["integral", "derivative"])
@pytest.mark.parametrize("positions", [PRESSURES, ["p_tp", "p_ap", "q_ori", "q_filt_t", "dp_tp"]])
def test_causality_decides_which_sensors_the_thesis_model_needs(
    positions: list[str], causality: Interpretation, faulty: bool
) -> None:
    found = place_sensors(BARE, positions, causality, faulty=faulty)
    assert sets(found) == sets(brute(BARE, positions, causality, "isolability", faulty=faulty))
    if causality == "integral":
        assert sets(found) != sets(place_sensors(BARE, positions, "mixed", faulty=faulty))


def reached(structure: Structure, causality: Interpretation, goal: Goal) -> set[tuple[str, str | None]]:
    """Pairs of a detectable fault and None, or another that it is isolable from."""
    found: set[tuple[str, str | None]] = {(fault, None) for fault in detectability(structure, causality)}
    if goal == "isolability":
        for fault, others in isolability_of(structure, causality).items():
            found |= {(fault, other) for other in structure.faults if other != fault and other not in others}
    return found


def brute(
    structure: Structure, positions: Sequence[str], causality: Interpretation, goal: Goal, *, faulty: bool
) -> list[SensorSet]:
    """All sets of up to two sensors a position, whose faults must reach among themselves what they do with all."""
    best = reached(add_sensors(structure, [p for p in positions for _ in range(2)], faulty), causality, goal)
    good: list[tuple[int, ...]] = []
    for counts in sorted(itertools.product(range(3), repeat=len(positions)), key=sum):
        if any(all(a <= b for a, b in zip(smaller, counts, strict=True)) for smaller in good):
            continue
        chosen = [p for p, count in zip(positions, counts, strict=True) for _ in range(count)]
        complete = add_sensors(structure, chosen, faulty)
        wanted = {(f, o) for f, o in best if f in complete.faults and (o is None or o in complete.faults)}
        if wanted <= reached(complete, causality, goal):
            good.append(counts)
    return [
        SensorSet(
            tuple(p for p, count in zip(positions, counts, strict=True) for _ in range(count)), float(sum(counts))
        )
        for counts in good
    ]


@pytest.mark.parametrize("causality", INTERPRETATIONS)
@pytest.mark.parametrize("goal", get_args(Goal))
@pytest.mark.parametrize("faulty", [False, True])
@STEADY
@given(structure=structures())
def test_minimal_sets_are_those_of_brute_force(
    causality: Interpretation, goal: Goal, faulty: bool, structure: Structure
) -> None:
    positions = structure.unknowns[:4]
    found = place_sensors(structure, positions, causality, goal, faulty=faulty)
    assert len(found) == len(sets(found))
    assert {s.sensors for s in found} == {
        s.sensors for s in brute(structure, positions, causality, goal, faulty=faulty)
    }


def nearly_determined(seed: int) -> tuple[Structure, list[str], Interpretation]:
    """A structure whose algebraic equations determine nearly all but the states, four positions, and a causality."""
    rng = np.random.default_rng(seed)
    states = [f"x{i}" for i in range(rng.integers(3))]
    unknowns = [*states, *(f"d{s}" for s in states), *(f"a{i}" for i in range(rng.integers(2, 6)))]
    number = max(1, len(unknowns) - len(states) - int(rng.integers(2)))
    drawn = [rng.integers(len(unknowns), size=rng.integers(1, 4)).tolist() for _ in range(number)]
    contents = [sum(1 << x for x in {*row}) for row in drawn]
    faulty = rng.integers(number, size=rng.integers(1, 5)).tolist()
    positions = [unknowns[x] for x in rng.permutation(len(unknowns))[:4]]
    return made(contents, unknowns, [(s, f"d{s}") for s in states], faulty), positions, INTERPRETATIONS[seed % 3]


def test_what_the_fault_of_one_sensor_requires_is_not_asked_of_sets_without_it() -> None:
    doubled = 0
    for seed in [*range(300), 634, 819]:  # 251, 293, 634 and 819 are such cases, of every causality
        structure, positions, causality = nearly_determined(seed)
        found = [s.sensors for s in place_sensors(structure, positions, causality, faulty=True)]
        expected = [s.sensors for s in brute(structure, positions, causality, "isolability", faulty=True)]
        assert sorted(found) == sorted(expected), f"seed {seed}"
        doubled += any(len({*sensors}) < len(sensors) for sensors in found)
    assert doubled > 100


@pytest.mark.parametrize("causality", INTERPRETATIONS)
@STEADY
@given(structure=structures(), data=st.data())
def test_a_sensor_without_fault_never_takes_isolability_away(
    causality: Interpretation, structure: Structure, data: st.DataObject
) -> None:
    added = add_sensors(structure, data.draw(st.lists(st.sampled_from(structure.unknowns), max_size=3)))
    assert reached(structure, causality, "isolability") <= reached(added, causality, "isolability")


def test_a_faulty_sensor_may_have_to_be_checked_by_a_second() -> None:
    """A leak in the only equation of a: one sensor detects it, two tell it from the sensor's own fault."""
    structure = made([0b1], ["a"], [], [0])
    assert place_sensors(structure, ["a"], "mixed") == [SensorSet(("a",), 1.0)]
    assert place_sensors(structure, ["a"], "mixed", faulty=True) == [SensorSet(("a", "a"), 2.0)]
    assert place_sensors(structure, ["a"], "mixed", goal="detectability", faulty=True) == [SensorSet(("a",), 1.0)]


def test_cheap_sets_come_first_then_small_ones() -> None:
    flows = {"q_filt_t": 0.25, "q_dos": 0.25}
    found = place_sensors(BARE, [*PRESSURES, *FLOWS], "mixed", costs=flows)
    assert [s.cost for s in found] == [0.5, 1.25, 1.25, 2.0]
    assert sets(found[:1]) == {("q_dos", "q_filt_t")}
    assert sets(found[-1:]) == {("p_tp", "q_ori")}


def test_no_positions_need_no_sensors() -> None:
    assert place_sensors(BARE, [], "integral") == [SensorSet((), 0.0)]


def test_wrong_positions_costs_and_goals_are_refused() -> None:
    with pytest.raises(ModelError, match=r"^p_x: no unknown, so no sensor can measure it"):
        place_sensors(BARE, ["p_x"], "mixed")
    with pytest.raises(ModelError, match=r"^p_tp: twice among the positions"):
        place_sensors(BARE, ["p_tp", "p_tp"], "mixed")
    with pytest.raises(ModelError, match=r"^costs: p_ap is no position; those are p_tp$"):
        place_sensors(BARE, ["p_tp"], "mixed", costs={"p_ap": 1.0})
    with pytest.raises(ModelError, match=r"^costs: -1 for p_tp is no cost"):
        place_sensors(BARE, ["p_tp"], "mixed", costs={"p_tp": -1.0})
    with pytest.raises(ModelError, match=r"^best: no goal of sensor placement; those are isolability, detectability$"):
        place_sensors(BARE, ["p_tp"], "mixed", goal="best")  # type: ignore[arg-type]

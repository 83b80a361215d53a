"""The search over a small library: nothing, one, two, what looks alike, what is in no entry."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from made_study import LIBRARY, Inline, study

from faultline.analysis.discrepancy.name.attempt import Attempt, Begin, Glance, Judge, Study, baseline_of
from faultline.analysis.discrepancy.name.contest import LEAST, Outcome, contest
from faultline.analysis.discrepancy.name.sensitivity import alike, chance, smallest_sizes
from faultline.analysis.discrepancy.name.work import Crew, Order

ENTRIES = ("full_open_gain", "stiff_hose", "offset_p_du", "offset_p_ap", "lag_p_du")


def searched(sizes: Mapping[str, float], entries: tuple[str, ...] = ENTRIES, seed: int = 1) -> tuple[Study, Outcome]:
    found = study(entries, sizes, seed)
    baseline = baseline_of(found)
    judge = Judge(found, baseline)
    nominal = judge.attempt(())
    crew = Crew(Inline(), found, baseline, None)

    def unbent() -> Begin | None:
        location = judge.locate(nominal)
        return Begin(nominal.unknowns, location.x) if location.members else None

    return found, contest(crew, [*found.library], nominal, 0.0, unbent, lambda *_: None)


def test_where_nothing_is_missing_nothing_is_named() -> None:
    _, outcome = searched({})
    assert outcome.places == ()
    assert outcome.chosen is outcome.nominal


@pytest.mark.parametrize(
    ("sizes", "beside"),
    [
        ({"full_open_gain": 0.1}, ("offset_p_du", "valve_opens_late")),
        ({"lag_p_du": 0.4}, ("full_open_gain", "offset_p_du")),
        ({"stiff_hose": 1.0}, ("full_open_gain", "offset_p_du")),
    ],
    ids=["full_open_gain", "lag_p_du", "stiff_hose"],
)
def test_one_effect_is_named(sizes: dict[str, float], beside: tuple[str, ...]) -> None:
    _, outcome = searched(sizes, (*beside, *sizes))
    assert [place.rivals for place in outcome.places] == [tuple(sizes)]
    [(name, size)] = sizes.items()
    parameter = next(iter(LIBRARY[name].strengths))
    chosen = outcome.chosen
    assert abs(chosen.values[parameter] - size) < 4.0 * chosen.spreads[parameter]


def test_two_effects_are_both_found() -> None:
    _, outcome = searched({"full_open_gain": 0.15, "lag_p_du": 1.0}, ("full_open_gain", "lag_p_du", "stiff_hose"))
    assert {place.rivals for place in outcome.places} == {("full_open_gain",), ("lag_p_du",)}
    assert {*outcome.chosen.effects} == {"full_open_gain", "lag_p_du"}
    assert outcome.gain > max(place.gain for place in outcome.places)


def test_what_looks_alike_is_said_to_be_one_of_several() -> None:
    """Two sensors of one pressure: which of them shows too much, their difference does not tell."""
    found, outcome = searched({"offset_p_du": 4000.0}, ("offset_p_du", "offset_p_ap", "full_open_gain"))
    [place] = outcome.places
    assert {*place.rivals} == {"offset_p_du", "offset_p_ap"}
    judge = Judge(found, baseline_of(found))
    directions = [judge.direction(name) for name in found.library]
    assert alike(directions)["offset_p_du"] == ("offset_p_ap",)


def test_what_can_be_seen_is_known_beforehand() -> None:
    few = ("full_open_gain", "offset_p_du")
    found = study(few, {})
    judge = Judge(found, baseline_of(found))
    directions = [judge.direction(name) for name in found.library]
    assert 0.0 <= chance(directions, *judge.left(judge.attempt(()))) < LEAST
    sizes = smallest_sizes(directions, LEAST)
    _, below = searched({"full_open_gain": 0.3 * sizes["full_open_gain"]}, few)
    assert below.places == ()
    _, above = searched({"full_open_gain": 3.0 * sizes["full_open_gain"]}, few)
    assert [place.rivals[0] for place in above.places] == ["full_open_gain"]


class Scripted:
    """A crew whose attempts have the evidence that a table says, by the letters of their effects."""

    def __init__(self, evidence: Mapping[str, float], dispersion: float = 1.0) -> None:
        self._evidence, self._dispersion = {frozenset(key): nats for key, nats in evidence.items()}, dispersion

    def attempt(self, effects: Sequence[str], begin: float = 0.0) -> Attempt:
        nats, unknowns = self.evidence(frozenset(effects), begin), None
        made: dict[str, Any] = {"unknowns": unknowns, "x": np.array([nats]), "curvature": np.eye(1), "promised": 0.0}
        return Attempt(
            effects=tuple(effects),
            inside=np.ones(1, dtype=bool),
            cost=-nats,
            training=nats,
            predicted=0.0,
            blocks=np.zeros(4),
            dispersion=self._dispersion,
            **made,
        )

    def attempts(self, orders: Sequence[Order], _: Callable[[int, int], None]) -> list[Attempt]:
        return [self.attempt(order.effects, float(order.begin.x[0])) for order in orders]

    def evidence(self, effects: frozenset[str], _: float) -> float:
        return self._evidence[effects]

    def glances(self, orders: Sequence[Order], _: Callable[[int, int], None]) -> list[Glance]:
        found = self.attempts(orders, _)
        return [Glance(a.effects, a.unknowns, a.x, a.cost, a.promised) for a in found]


class Winding(Scripted):
    """A crew that comes to the optimum of a and b only from where c took it."""

    def evidence(self, effects: frozenset[str], begin: float) -> float:
        there = begin >= self._evidence[frozenset("abc")] and effects >= {*"ab"}
        return 300.0 if there else super().evidence(effects, begin)


def test_an_effect_that_was_no_more_than_the_way_to_a_better_optimum_is_dropped() -> None:
    """The wound: an effect of size zero was named, with the evidence of where it had led."""
    evidence = {"": 0.0, "a": 100.0, "b": 50.0, "c": 60.0, "ab": 130.0, "ac": 110.0, "bc": 90.0, "abc": 150.0}
    crew: Any = Winding(evidence)
    outcome = contest(crew, ["a", "b", "c"], crew.attempt(""), 0.0, None, lambda *_: None)
    assert {place.rivals[0]: place.gain for place in outcome.places} == {"a": 250.0, "b": 200.0}
    assert {*outcome.chosen.effects} == {"a", "b"}


def scripted(
    evidence: Mapping[str, float], law: float = 0.0, dispersion: float = 1.0, missing: float = 0.0
) -> dict[str, float]:
    """The gain of every effect that is chosen."""
    crew: Any = Scripted(evidence, dispersion)
    names = sorted({letter for key in evidence for letter in key})
    outcome = contest(crew, names, crew.attempt(""), law, None, lambda *_: None, missing=missing)
    gains = {place.rivals[0]: place.gain for place in outcome.places}
    assert {*gains} == {*outcome.chosen.effects}
    return gains


def test_no_second_effect_is_looked_for_where_the_first_is_a_small_part_of_what_is_missing() -> None:
    evidence = {"": 0.0, "a": 100.0, "b": 50.0, "ab": 160.0}
    assert {*scripted(evidence, missing=900.0)} == {"a", "b"}
    assert {*scripted(evidence, missing=1100.0)} == {"a"}


def test_an_effect_that_stood_in_for_two_is_dropped_and_the_others_are_weighed_without_it() -> None:
    evidence = {"": 0.0, "a": 100.0, "b": 50.0, "c": 60.0, "ab": 170.0, "ac": 165.0, "bc": 300.0, "abc": 301.0}
    assert scripted(evidence) == {"b": 240.0, "c": 250.0}


@pytest.mark.parametrize(("law", "dispersion"), [(25.0, 1.0), (0.0, 2.5)])
def test_every_effect_needs_more_than_chance_brings_with_the_noise_that_is_left(law: float, dispersion: float) -> None:
    evidence = {"": 0.0, "a": 100.0, "b": 20.0, "ab": 120.0}
    assert scripted(evidence) == {"a": 100.0, "b": 20.0}
    assert scripted(evidence, law, dispersion) == {"a": 100.0}
    assert scripted({"": 0.0, "a": 20.0}, law, dispersion) == {}
    assert scripted({"": 0.0, "a": LEAST + 0.1}) == {"a": LEAST + 0.1}
    assert scripted({"": 0.0, "a": LEAST - 0.1}) == {}

"""The search over a small library: nothing, one, two, what looks alike, what is in no entry."""

from collections.abc import Mapping

import pytest
from made_study import LIBRARY, Inline, study

from analysis.discrepancy.name.attempt import Begin, Judge, Study, baseline_of
from analysis.discrepancy.name.contest import Outcome, contest
from analysis.discrepancy.name.sensitivity import LEAST, alike, chance, smallest_sizes
from analysis.discrepancy.name.work import Crew

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

    return found, contest(crew, [*found.library], nominal, LEAST, unbent, lambda *_: None)


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
    assert LEAST <= chance(directions, *judge.left(judge.attempt(()))) < 3 * LEAST
    sizes = smallest_sizes(directions, LEAST)
    _, below = searched({"full_open_gain": 0.3 * sizes["full_open_gain"]}, few)
    assert below.places == ()
    _, above = searched({"full_open_gain": 3.0 * sizes["full_open_gain"]}, few)
    assert [place.rivals[0] for place in above.places] == ["full_open_gain"]

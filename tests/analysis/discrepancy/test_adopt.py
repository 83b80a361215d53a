"""An effect that is taken into a model stays in its file, names the recordings that it was found in, and comes out."""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cache

import pytest

from faultline.analysis.calibration.provenance import recordings_of, vehicle_of
from faultline.analysis.discrepancy.add.adopt import adopted, undone
from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.model import Model, ModelError, dump_model, load_model, parse_model
from faultline.analysis.model.file import SYSTEMS

LIBRARY = load_library(SYSTEMS / "uds")
FACTS: Mapping[str, object] = {
    "recordings": ("1" * 64, "2" * 64),
    "held_out": ["3" * 64],
    "vehicle": "bench 7",
    "evidence": {"gain": 321.5, "rivals": ["valve_opens_late"], "said": 'one line\nanother, "quoted"\\ and \x7f'},
}


@cache
def calibrated() -> Model:
    entry = {"command": "calibrate", "recordings": ["1" * 64, "0" * 64], "vehicle": "bench 6"}
    return load_model("uds").with_parameters({"C_v": 1.9e-9}, entry)


def values_for(model: Model, effects: Sequence[str]) -> dict[str, float]:
    """Every calibrated parameter at another value, the effects' as large as would be seen well."""
    found = {name: 1.01 * model.parameters[name].value for name in model.calibrated}
    for name in effects:
        effect = LIBRARY[name]
        found |= {
            effect.prefixed(own): p.spread or p.value for own, p in effect.parameters.items() if p.spread or p.prior
        }
    return found


def with_effects(model: Model, *effects: str) -> Model:
    return adopted(model, [LIBRARY[name] for name in effects], values_for(model, effects), FACTS)


@pytest.mark.parametrize(
    "effects",
    [
        ("full_open_gain",),
        ("lag_p_du",),
        ("nozzle_deposit", "pump_slip"),
        ("offset_p_du", "lag_p_du", "du_filter_cake"),
    ],
)
def test_what_was_adopted_survives_its_file_and_is_undone_to_the_byte(effects: tuple[str, ...]) -> None:
    before = calibrated()
    after = with_effects(before, *effects)
    text = dump_model(after)
    again = parse_model(text, "adopted.toml")
    assert again == after
    assert dump_model(again) == text
    assert after.parameters["C_v"].value == values_for(before, effects)["C_v"]
    assert undone(again) == before
    assert dump_model(undone(again)) == dump_model(before)


def test_the_entry_says_what_was_done_and_what_was_there() -> None:
    entry = with_effects(calibrated(), "lag_p_du").provenance[-1]
    assert entry["command"] == "discover"
    assert entry["effects"] == ["lag_p_du"]
    assert entry["recordings"] == ["1" * 64, "2" * 64]
    assert entry["evidence"] == FACTS["evidence"]
    was = entry["was"]
    assert isinstance(was, dict)
    assert was["expr"] == {"e16": calibrated().equations["e16"].text}
    assert was["enters"] == {"e16": "p_du -> p_du + fy_p_du"}
    assert was["value"]["C_v"] == 1.9e-9
    assert was["added"]["parameter"] == ["lag_p_du_tau"]
    assert was["added"]["differential"] == ["lag_p_du_d"]


def test_recordings_that_were_fitted_or_held_out_are_used_up() -> None:
    """`tune` and `evaluate` refuse what these name; those of the calibration before are among them, once."""
    after = with_effects(calibrated(), "full_open_gain")
    assert recordings_of(after) == [digit * 64 for digit in "1023"]
    assert vehicle_of(after) == "bench 7"
    assert recordings_of(undone(after)) == ["1" * 64, "0" * 64]
    assert vehicle_of(undone(after)) == "bench 6"


def test_the_last_of_two_discoveries_is_undone_first() -> None:
    once = with_effects(calibrated(), "full_open_gain")
    twice = with_effects(once, "valve_opens_late")
    assert undone(twice) == once
    assert undone(undone(twice)) == calibrated()


def test_a_value_that_rounding_carries_beyond_a_bound_is_at_the_bound() -> None:
    values = values_for(calibrated(), ["full_open_gain"])
    effect = LIBRARY["full_open_gain"]
    after = adopted(calibrated(), [effect], {**values, "full_open_gain_g": 0.6 * (1 + 1e-15)}, FACTS)
    assert after.parameters["full_open_gain_g"].value == 0.6
    with pytest.raises(ModelError, match=r"parameter.full_open_gain_g: value 0.61 is outside \[0, 0.6\]"):
        adopted(calibrated(), [effect], {**values, "full_open_gain_g": 0.61}, FACTS)


def test_a_parameter_that_was_not_fitted_is_named() -> None:
    values = values_for(calibrated(), ["full_open_gain"])
    del values["C_v"]
    with pytest.raises(ModelError, match=r"^uds: parameter\.C_v: was not fitted; give values of C_v$"):
        adopted(calibrated(), [LIBRARY["full_open_gain"]], values, FACTS)


def test_a_fact_that_no_file_can_hold_is_refused() -> None:
    with pytest.raises(ModelError, match=r"^provenance: None cannot be written to TOML"):
        adopted(calibrated(), [], values_for(calibrated(), []), {**FACTS, "evidence": {"gain": None}})


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ((), "uds: provenance: is empty, there is nothing to undo; give"),
        (({"command": "calibrate"},), "provenance[0]: is of 'calibrate', and only a discovery that came last can"),
        (({"command": "discover"},), "provenance[0].was: is missing; give the model file as `faultline discover`"),
        (({"command": "discover", "was": 3},), "provenance[0].was: must be a table, not 3"),
        (({"command": "discover", "was": {"value": {}}},), "provenance[0].was.expr: is missing; give the model"),
        (
            ({"command": "discover", "was": {"value": {"C_x": 1.0}, "expr": {}, "enters": {}, "added": {}}},),
            "provenance[0].was.value.C_x: unknown key; allowed here are ",
        ),
    ],
)
def test_what_cannot_be_undone_is_refused(entries: tuple[Mapping[str, object], ...], message: str) -> None:
    with pytest.raises(ModelError) as caught:
        undone(dataclasses.replace(load_model("uds"), provenance=entries))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)

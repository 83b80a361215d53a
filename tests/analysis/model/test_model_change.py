"""Other parameters, and the way back to a file."""

import datetime
import math

import numpy as np
import pytest

from faultline.analysis.model import ModelError, dump_model, load_model, parse_model

UDS4 = load_model("uds")


def test_what_is_written_reads_back_as_the_same_model() -> None:
    again = parse_model(dump_model(UDS4), "again")
    assert again == UDS4
    assert dump_model(again) == dump_model(UDS4)
    for part in ("known", "unknown", "parameters", "equations"):
        assert list(getattr(again, part)) == list(getattr(UDS4, part))


def test_calibrated_values_and_provenance_survive_to_the_last_digit() -> None:
    entry = {"command": "calibrate", "recordings": ["0a", "1b"], "blocks": 12, "rms": 0.1 + 0.2, "fine": True}
    changed = UDS4.with_parameters({"A_t": math.pi * 1e-6, "C_q": np.float64(0.65)}, entry)
    assert changed.parameters["A_t"].value == math.pi * 1e-6
    assert changed.parameters["A_t"].prior == UDS4.parameters["A_t"].prior
    assert changed.provenance == (entry,)
    again = parse_model(dump_model(changed), "again")
    assert again == changed
    assert again.with_parameters({}, {"command": "twice"}).provenance == (entry, {"command": "twice"})
    assert UDS4.provenance == ()


def test_any_provenance_that_toml_can_hold_is_kept() -> None:
    entry = {
        'quoted "key"': 'back\\slash, "quotes", \x7f, \x01, ü, new\nline',
        "when": datetime.datetime(2026, 1, 1, tzinfo=datetime.UTC),
        "nested": {"a": [1, 2.5, [True]], "b c": {}},
        "small": 1e-300,
        "endless": math.inf,
    }
    changed = UDS4.with_parameters({}, entry)
    assert parse_model(dump_model(changed), "again") == changed


def test_provenance_that_toml_cannot_hold_is_refused() -> None:
    with pytest.raises(ModelError, match=r"^provenance: None cannot be written to TOML"):
        dump_model(UDS4.with_parameters({}, {"list": [None]}))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"A_x": 1.0}, "uds: A_x is no parameter; those are eps_p, D_p, "),
        ({"A_t": 1.0}, "uds: parameter.A_t: value 1 is outside [1e-07, 0.0001] m2"),
        ({"A_t": math.nan}, "uds: parameter.A_t: value nan is outside"),
        ({"C_q": math.inf}, "uds: parameter.C_q: value inf is outside [-inf, inf] 1"),
    ],
)
def test_values_that_mean_nothing_are_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(ModelError) as error:
        UDS4.with_parameters(values, {})
    assert str(error.value).startswith(message)

"""Which network takes what: the table of the thesis' computational graphs."""

import pytest

from faultline.analysis.model import load_model
from faultline.service.core.errors import InputError
from faultline.training.layout import layout_of

TABLE = {
    "t02": {"p_du": "p_du y_p_ap dc_dose", "h": "p_du"},
    "t06": {"p_bp": "p_bp p_ap y_p_tp n_p", "p_ap": "p_bp p_ap y_p_du n_p", "h": "p_ap"},
    "t08": {"p_tp": "p_tp p_bp", "p_bp": "p_tp p_bp y_p_ap n_p", "h": "p_tp"},
    "t09": {"p_tp": "p_tp p_bp", "p_bp": "p_tp p_bp p_ap n_p", "p_ap": "p_bp p_ap y_p_du n_p", "h": "p_ap"},
    "t10": {"p_tp": "p_tp p_bp", "p_bp": "p_tp p_bp p_ap n_p", "p_ap": "p_bp p_ap y_p_du n_p", "h": "p_tp"},
    "t12": {"p_bp": "p_bp p_ap y_p_tp n_p", "p_ap": "p_bp p_ap p_du n_p", "p_du": "p_ap p_du dc_dose", "h": "p_ap"},
    "t13": {"p_bp": "p_bp p_ap y_p_tp n_p", "p_ap": "p_bp p_ap p_du n_p", "p_du": "p_ap p_du dc_dose", "h": "p_du"},
    **{
        test: {
            "p_tp": "p_tp p_bp",
            "p_bp": "p_tp p_bp p_ap n_p",
            "p_ap": "p_bp p_ap p_du n_p",
            "p_du": "p_ap p_du dc_dose",
            "h": output,
        }
        for test, output in (("t19", "p_ap"), ("t20", "p_tp"), ("t21", "p_du"))
    },
}
"""By backtracking every test's computational graph (thesis 3.3 and 5.10); the input is the duty cycle here."""


def test_every_function_has_the_arguments_of_the_computational_graph() -> None:
    layout = layout_of(load_model("uds"))
    names = [name.split(".")[1] for name in layout.states] + [*layout.signals]
    found: dict[str, dict[str, str]] = {test.name: {} for test in layout.tests}
    for f, name in enumerate(layout.states):
        test, state = name.split(".")
        assert layout.tests[layout.owner[f]].name == test
        used = [column for column in layout.rates[f] if column != layout.padding]
        assert all(column >= len(layout.states) or layout.owner[column] == layout.owner[f] for column in used)
        found[test][state] = " ".join(names[column] for column in used)
    for t, each in enumerate(layout.tests):
        found[each.name]["h"] = " ".join(names[c] for c in layout.outputs[t] if c != layout.padding)
        assert layout.signals[layout.predicts[t]] == each.predicts
    assert found == TABLE


def test_a_state_begins_with_the_tests_own_signals_and_is_sensed_by_any() -> None:
    layout = layout_of(load_model("uds"), ["t02", "t21"])
    assert [test.name for test in layout.tests] == ["t02", "t21"]
    place = {name: f for f, name in enumerate(layout.states)}
    assert layout.starts[place["t21.p_ap"]].gain == {"y_p_du": 1.0}
    assert layout.starts[place["t21.p_tp"]].gain == {}
    assert layout.starts[place["t21.p_tp"]].offset == 101325.0
    assert layout.sensed[place["t21.p_ap"]] == "y_p_ap"
    assert layout.sensed[place["t21.p_bp"]] is None  # what it begins with is near it, but is not it


def test_h_that_is_a_state_is_known_as_one() -> None:
    assert layout_of(load_model("uds"), ["t02"]).direct(0) == 0
    assert layout_of(load_model("rc")).direct(0) is None


def test_what_cannot_be_a_network_is_refused_with_the_reason() -> None:
    with pytest.raises(InputError, match=r"--tests t01: cannot be a network: no residual equation has integral caus"):
        layout_of(load_model("uds"), ["t01"])
    with pytest.raises(InputError, match=r"--tests t99: uds has no such test; it has t01, t02"):
        layout_of(load_model("uds"), ["t99"])

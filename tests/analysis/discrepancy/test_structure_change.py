"""What an effect does to the tests of a model, on effects whose consequences were worked out by hand."""

import dataclasses
from collections.abc import Mapping
from functools import cache

import msgspec
import numpy as np
import pytest

from faultline.analysis.calibration.problem import unknowns_of
from faultline.analysis.discrepancy.add.changed_tests import ChangedTest
from faultline.analysis.discrepancy.add.structure_change import Diagnosed, StructureChange, structure_change
from faultline.analysis.discrepancy.effects.library import load_library
from faultline.analysis.discrepancy.effects.rewrite import rewritten
from faultline.analysis.discrepancy.name.attempt import Attempt
from faultline.analysis.model import Model, load_model
from faultline.analysis.model.file import SYSTEMS
from faultline.analysis.simulation import system_of

UDS4 = load_model("uds")
NOTHING = Diagnosed((), (), (), ())
LIBRARY = load_library(SYSTEMS / "uds")
WELL = 0.1
"""Standard deviation of what the data tell, of the prior's."""


def attempt(model: Model, spreads: Mapping[str, float], at_bound: tuple[str, ...] = ()) -> Attempt:
    """One in which parameters have these standard deviations, of their prior's."""
    unknowns = unknowns_of(system_of(model, model.calibrated), (), 1, ())
    sd = np.array([spreads.get(name, WELL) for name in unknowns.parameters] + [1.0] * len(unknowns.zeros))
    inside = np.array([name not in at_bound for name in unknowns.parameters] + [True] * len(unknowns.zeros))
    return Attempt(
        effects=("made",),
        unknowns=unknowns,
        x=np.zeros(unknowns.size),
        curvature=np.diag(sd**-2),
        inside=inside,
        cost=0.0,
        promised=0.0,
        training=0.0,
        predicted=0.0,
        blocks=np.zeros(1),
        dispersion=1.0,
    )


@cache
def changed(effect: str) -> StructureChange:
    model = rewritten(UDS4, LIBRARY[effect])
    return structure_change(UDS4, model, attempt(model, {}))


def test_what_only_scales_a_flow_changes_no_test() -> None:
    found = changed("full_open_gain")
    assert found.changed == ()
    assert all(diagnosed == NOTHING for diagnosed in found.diagnosed.values())
    assert found.sentences() == [
        "the model has 26 minimal over-determined sets and 21 tests, as before",
        "10 of 21 tests can be run as before",
        "detectability and isolability are unchanged",
    ]


def test_a_test_that_needs_a_sensors_pressure_cannot_use_one_that_lags() -> None:
    """p_du is not what the sensor shows any more: the tests that took it from there would have to differentiate."""
    found = changed("lag_p_du")
    assert (found.tests, found.run) == ((21, 21), (10, 7))
    assert [test.name for test in found.changed] == ["t06", "t09", "t10"]
    assert all(test.ran and not test.runs and not test.gained and not test.lost for test in found.changed)
    assert found.diagnosed["mixed"] == NOTHING
    assert ("fA_du", "fA_dos") in found.diagnosed["integral"].mixed_up
    assert found.diagnosed["integral"] == found.diagnosed["run"]
    assert found.sentences()[1:4] == [
        "7 of 21 tests can be run; 10 of 21 before",
        "t06, t09, t10 cannot be run any more: no residual equation has integral causality",
        "fA_du cannot be told any more from fA_dos, fA_ori, with integral causality and the tests that can be run",
    ]


def test_a_cake_that_grows_with_the_flow_brings_the_dosing_valve_into_tests() -> None:
    """Its resistance needs the dosed volume, so a test of the filter sees the valve's faults; tests get new numbers."""
    found = changed("du_filter_cake")
    assert (found.msos, found.tests, found.run) == ((26, 38), (21, 26), (10, 7))
    [t06] = [test for test in found.changed if test.name == "t06"]
    assert t06 == ChangedTest("t06", "t08", ("fA_dos",), (), True, False, "no residual equation has integral causality")
    assert sum(test.name is None for test in found.changed) == 5
    assert ("fA_dos", "fA_ori") in found.diagnosed["mixed"].told
    assert "t06 (now t08) is sensitive to fA_dos too" in found.sentences()


def test_an_equation_that_cannot_be_solved_leaves_the_structure_and_takes_the_tests() -> None:
    found = changed("du_inlet_spring")
    assert found.run == (10, 1)
    assert found.diagnosed["mixed"] == NOTHING
    assert found.diagnosed["integral"] == NOTHING
    assert set(found.diagnosed["run"].lost) == {"fA_ori", "fA_dos", "fA_du", "fy_p_du"}
    sentences = found.sentences()
    assert any("e07 cannot be solved for q_filt_du with one solution only" in sentence for sentence in sentences)
    assert "fA_ori, fA_dos, fA_du, fy_p_du cannot be detected any more, with the tests that can be run" in sentences
    assert not any(sentence.startswith("fA_dos cannot be told") for sentence in sentences)


def test_parameters_that_the_recordings_do_not_tell_are_named() -> None:
    model = rewritten(UDS4, LIBRARY["nozzle_back_pressure"])
    p_e = "nozzle_back_pressure_p_e"
    told = structure_change(UDS4, model, attempt(model, {"C_q": 0.99}))
    assert (told.new, told.untold, told.at_bound) == ((p_e,), (), ())
    untold = structure_change(UDS4, model, attempt(model, {p_e: 0.9}))
    assert untold.sentences()[-1] == f"the recordings do not tell {p_e}: the prior decides"
    at_bound = structure_change(UDS4, model, attempt(model, {}, (p_e,)))
    assert at_bound.untold == ()
    assert at_bound.sentences()[-1] == f"at the end of what is possible: {p_e}"


def test_the_way_back_is_the_change_the_other_way_round() -> None:
    there, model = changed("lag_p_du"), rewritten(UDS4, LIBRARY["lag_p_du"])
    back = structure_change(model, UDS4, attempt(UDS4, {}))
    assert [(test.ran, test.runs) for test in back.changed] == [(test.runs, test.ran) for test in there.changed]
    assert back.diagnosed["integral"].told == there.diagnosed["integral"].mixed_up
    assert "t06 can be run now" in back.sentences()


def test_a_test_that_is_there_no_more_is_gone() -> None:
    """Without the sensor between the filters every test that has its equation is another or none."""
    bare = dataclasses.replace(
        UDS4,
        known={name: known for name, known in UDS4.known.items() if name != "y_p_tp"},
        equations={name: e for name, e in UDS4.equations.items() if name != "e17"},
    )
    found = structure_change(UDS4, bare, attempt(UDS4, {}))
    gone = [test for test in found.changed if test.now is None]
    assert len(gone) == found.tests[0] - found.tests[1]
    assert any("there is no such test now" in sentence for sentence in found.sentences())
    assert found.diagnosed["run"].lost == ("fy_p_tp",)


@pytest.mark.parametrize("effect", ["lag_p_du", "du_filter_cake"])
def test_it_can_be_written_as_json(effect: str) -> None:
    assert msgspec.json.decode(msgspec.json.encode(changed(effect)), type=StructureChange) == changed(effect)

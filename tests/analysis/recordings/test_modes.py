"""What a model says of its modes, as the vehicle follows them."""

import dataclasses

import numpy as np

from faultline.analysis.graph.bank import build_bank
from faultline.analysis.model import Mode, Model, OperatingModes, load_model
from faultline.analysis.model.model import ONE_MODE
from faultline.analysis.recordings.modes import modes_of, stand_ins, time_of
from faultline.service.core.signals.modes import EDGE, ModeTracker

UDS4 = load_model("uds")
IDLE, PARTIAL = 1, 2


def followed(model: Model, doses: list[float], usable: bool = True) -> list[int]:
    """The modes of ticks with these doses, all else constant."""
    tracker = ModeTracker(modes_of(model), build_bank(model).inputs, model.period_s)
    z = np.array([1e5, 1e6, 1e6, 25.0, 0.0])
    return [tracker.update(np.array([*z[:4], dose]), np.array([True, True, True, True, usable])) for dose in doses]


def test_the_urea_dosing_systems_modes_are_those_of_its_file() -> None:
    modes = modes_of(UDS4)
    assert modes.names == ("edge", "idle", "partial", "maximum")
    assert (modes.edges, modes.settle_s, time_of(UDS4)) == ({"dc_dose": 0.03, "n_p": 4.0}, 8.0, (0.2, 20.0))
    assert stand_ins(UDS4) == (0, 1, 2, 3)
    assert followed(UDS4, [0.0] * 40 + [0.0, 0.02, 0.02, 0.5]) == [EDGE] * 39 + [IDLE, IDLE, PARTIAL, PARTIAL, EDGE]
    assert followed(UDS4, [0.0] * 40 + [0.02, 0.04]) == [EDGE] * 39 + [IDLE, PARTIAL, EDGE]  # a step of two ticks


def test_without_edges_the_mode_for_the_rest_stands_for_them() -> None:
    model = dataclasses.replace(UDS4, modes=dataclasses.replace(UDS4.modes, edges={}, settle_s=0.0))
    assert stand_ins(model) == (2, 1, 2, 3)


def test_a_model_without_modes_has_one_even_where_its_signal_is_lost() -> None:
    model = dataclasses.replace(UDS4, modes=ONE_MODE)
    assert stand_ins(model) == (1, 1)
    assert set(followed(model, [0.0, 1.0, 0.5, 0.0])) == {1}
    assert set(followed(model, [float("nan")] * 3, usable=False)) == {1}


def test_a_tracker_sees_where_nothing_moves_what_the_model_says_of_the_levels() -> None:
    """Five modes, bounded by two signals and overlapping: the first that holds counts."""
    steady = (
        Mode(name="stopped", where={"n_p": (None, 5.0)}),
        Mode(name="fast, dosing", where={"n_p": (40.0, None), "dc_dose": (0.1, None)}),
        Mode(name="else", where={}),
        Mode(name="dosing", where={"dc_dose": (0.1, 0.9)}),
        Mode(name="open", where={"dc_dose": (0.8, None)}),
    )
    modes = OperatingModes(steady=steady, edges={}, settle_s=0.0)
    model = dataclasses.replace(UDS4, modes=modes)
    rng = np.random.default_rng(3)
    z = np.tile([1e5, 1e6, 1e6, 0.0, 0.0], (400, 1))
    z[:, 3], z[:, 4] = rng.uniform(0.0, 60.0, 400), rng.choice([0.0, 0.1, 0.5, 0.85, 0.9, 1.0], 400)
    tracker = ModeTracker(modes_of(model), build_bank(model).inputs, model.period_s)
    seen = [tracker.update(row, np.ones(5, dtype=np.bool_)) for row in z]
    assert seen == modes.at({"n_p": z[:, 3], "dc_dose": z[:, 4]}, 400).tolist()
    assert {*seen} == {1, 2, 3, 4, 5}

"""What a model says of its modes, as the vehicle follows them; modes that a system has not."""

import dataclasses

import numpy as np
import pytest

from faultline.analysis.graph.bank import build_bank
from faultline.analysis.model import Model, OperatingModes, load_model
from faultline.analysis.recordings.modes import modes_of, stand_ins
from faultline.service.core.manifest import Modes
from faultline.service.core.signals.modes import EDGE, IDLE, MAXIMUM, PARTIAL, ModeTracker

UDS4 = load_model("uds")


def without(**parts: object) -> Model:
    assert UDS4.modes is not None
    return dataclasses.replace(UDS4, modes=dataclasses.replace(UDS4.modes, **parts))  # type: ignore[arg-type]


def followed(model: Model, doses: list[float], usable: bool = True) -> list[int]:
    """The modes of ticks with these doses, all else constant."""
    tracker = ModeTracker(modes_of(model), build_bank(model).inputs)
    z = np.array([1e5, 1e6, 1e6, 25.0, 0.0])
    return [tracker.update(np.array([*z[:4], dose]), np.array([True, True, True, True, usable])) for dose in doses]


def test_the_urea_dosing_systems_modes_are_those_of_its_file() -> None:
    assert modes_of(UDS4) == Modes(
        signal="dc_dose",
        idle_below=0.02,
        maximum_above=0.98,
        edges={"dc_dose": 0.03, "n_p": 4.0},
        settle_ticks=40,
    )
    assert stand_ins(UDS4) == (IDLE, PARTIAL, MAXIMUM, EDGE)
    assert followed(UDS4, [0.0] * 40 + [0.0, 0.02, 0.04, 0.5]) == [EDGE] * 39 + [IDLE, IDLE, PARTIAL, PARTIAL, EDGE]


@pytest.mark.parametrize(
    ("parts", "described", "seen"),
    [
        ({"idle_below": None}, (PARTIAL, PARTIAL, MAXIMUM, EDGE), {PARTIAL, MAXIMUM}),
        ({"maximum_above": None}, (IDLE, PARTIAL, PARTIAL, EDGE), {IDLE, PARTIAL}),
        ({"idle_below": None, "maximum_above": None}, (PARTIAL, PARTIAL, PARTIAL, EDGE), {PARTIAL}),
    ],
)
def test_a_mode_without_a_limit_is_never_entered_and_partial_stands_for_it(
    parts: dict[str, object], described: tuple[int, ...], seen: set[int]
) -> None:
    model = without(**parts)
    assert stand_ins(model) == described
    assert set(followed(model, [0.0] * 50 + list(np.linspace(0.0, 1.0, 200)))) - {EDGE} == seen


def test_a_model_without_modes_has_one_even_where_its_signal_is_lost() -> None:
    model = dataclasses.replace(UDS4, modes=None)
    assert stand_ins(model) == (PARTIAL,) * 4
    assert set(followed(model, [0.0, 1.0, 0.5, 0.0])) == {PARTIAL}
    assert set(followed(model, [float("nan")] * 3, usable=False)) == {PARTIAL}


def test_a_system_of_two_levels_has_an_idle_mode_and_another() -> None:
    modes = OperatingModes(signal="dc_dose", idle_below=0.5, maximum_above=None, edges={}, settle_s=0.0)
    model = dataclasses.replace(UDS4, modes=modes)
    assert followed(model, [0.0, 1.0, 0.0]) == [IDLE, PARTIAL, IDLE]
    assert stand_ins(model) == (IDLE, PARTIAL, PARTIAL, PARTIAL)

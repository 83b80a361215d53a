"""A right model is as far from the measurements as it says, a wrong one farther."""

import dataclasses

import numpy as np
import pytest
from made_drive import DELAY_S, Errors, drawn, frames, log_sections

from faultline.analysis.calibration.problem import Nuisance
from faultline.analysis.calibration.validate import STEADY, Validation, validate
from faultline.analysis.model import load_model
from faultline.analysis.simulation import system_of

UDS1 = load_model("uds/production")
SYSTEM = system_of(UDS1, UDS1.calibrated)
SPEED = (20.0, 22.0, 24.0, 28.0, 30.0, 27.0) * 3
DOSE = (0.0, 0.3, 0.4, 1.0, 0.7, 0.0) * 3
ZERO = {"y_p_tp": 60.0, "y_p_ap": -120.0, "y_p_du": 90.0}


ALL = Errors(wander=0.0)
"""A speed that is held: where it wanders, the pressure's own movement counts as its floor."""


def validated(errors: Errors, changed: float = 1.0, seed: int = 1) -> Validation:
    """Six minutes' worth of holds, thrice, with the true parameters but `changed` times the orifice."""
    true = drawn(UDS1, 3)
    log = frames(UDS1, true, seed, delay_s=DELAY_S, errors=errors, speed=SPEED, dose=DOSE, zero=ZERO)
    values = {name: true[name] * (changed if name == "A_ori" else 1.0) for name in SYSTEM.parameters}
    return validate(SYSTEM, log_sections(UDS1, SYSTEM, log), values, [Nuisance(ZERO, {}, {"dc_dose": DELAY_S})])


def test_the_true_model_is_as_far_off_as_expected() -> None:
    """The inputs' errors are few and slow: their mean square needs several drives."""
    found = [validated(ALL, seed=seed).agreement for seed in range(5)]
    for name, by_mode in found[0].items():
        assert list(by_mode) == ["idle", "partial", "maximum", "edge", STEADY]
        for mode in by_mode:
            there = [agreement[name][mode] for agreement in found]
            ratio = np.sqrt(sum(a.rms**2 * a.samples for a in there) / sum(a.expected**2 * a.samples for a in there))
            assert 0.8 < ratio < 1.2, (name, mode, ratio)
            assert 0.7 < np.sqrt(np.mean([a.normalised**2 for a in there])) < 1.3, (name, mode)


def test_jumps_of_the_speed_excuse_nothing_between_them() -> None:
    """With a few intervals in which nobody knows the speed, the mean of what is expected says little of the rest."""
    true = drawn(UDS1, 3)
    [section] = log_sections(UDS1, SYSTEM, frames(UDS1, true, 1, delay_s=DELAY_S, errors=ALL, zero=ZERO))
    often = np.array([[at, at + 0.2, 15.0, k] for k, at in enumerate((72.0, 73.0, 134.0))])
    values = {name: true[name] * (1.01 if name == "A_ori" else 1.0) for name in SYSTEM.parameters}
    nuisance = [Nuisance(ZERO, {}, {"dc_dose": DELAY_S})]
    wrong, right = (
        validate(SYSTEM, [dataclasses.replace(section, uncertain={"n_p": often})], theta, nuisance).agreement["y_p_ap"]
        for theta in (values, {name: true[name] for name in SYSTEM.parameters})
    )
    assert wrong["partial"].rms < 2.0 * wrong["partial"].expected
    assert wrong["partial"].normalised > 3.0
    assert right["partial"].normalised < 1.5


def test_edges_are_expected_to_be_worse() -> None:
    agreement = validated(ALL).agreement
    for name in ("y_p_ap", "y_p_du"):
        assert agreement[name]["edge"].expected > 1.5 * agreement[name]["idle"].expected, name


def test_the_floor_is_the_sensors_noise() -> None:
    for name, by_mode in validated(ALL).agreement.items():
        for mode in ("idle", "partial", "maximum"):
            assert by_mode[mode].floor == pytest.approx(UDS1.known[name].noise, rel=0.15), (name, mode)


def test_steady_is_all_but_edges() -> None:
    for by_mode in validated(ALL).agreement.values():
        parts = [by_mode[mode] for mode in ("idle", "partial", "maximum")]
        steady = by_mode[STEADY]
        assert steady.samples == sum(a.samples for a in parts)
        assert steady.rms**2 * steady.samples == pytest.approx(sum(a.rms**2 * a.samples for a in parts))
        assert steady.bias * steady.samples == pytest.approx(sum(a.bias * a.samples for a in parts), abs=1.0)


def test_a_wrong_parameter_shows() -> None:
    right, wrong = validated(ALL).agreement, validated(ALL, changed=1.02).agreement
    for name in ("y_p_ap", "y_p_du"):
        for mode in ("idle", "partial"):
            a = wrong[name][mode]
            assert a.rms / a.expected > 3.0, (name, mode)
            assert a.normalised > 3.0, (name, mode)
            assert a.bias > 0.8 * a.rms  # it runs too low
            assert a.floor == right[name][mode].floor
    assert wrong["y_p_tp"]["idle"].rms / wrong["y_p_tp"]["idle"].expected < 1.2  # the flow is the pump's all the same


def test_a_zero_error_that_is_not_told_is_a_bias() -> None:
    true = drawn(UDS1, 3)
    log = frames(UDS1, true, 1, zero={"y_p_tp": 2000.0}, speed=SPEED, dose=DOSE)
    values = {name: true[name] for name in SYSTEM.parameters}
    found = validate(SYSTEM, log_sections(UDS1, SYSTEM, log), values, [Nuisance({}, {}, {})]).agreement
    assert found["y_p_tp"][STEADY].bias == pytest.approx(2000.0, abs=50.0)

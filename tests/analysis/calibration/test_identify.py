"""What the data tell of each parameter, and what scales them all."""

import dataclasses

import numpy as np
import pytest
from made_drive import calibrated, freed

from faultline.analysis.calibration.fit import Fit, fit
from faultline.analysis.calibration.identify import QUANTILE, identify
from faultline.analysis.simulation import system_of

SCALED = ("A_t", "A_du", "A_ori", "A_dos", "B_du")
"""Pressures tell the ratios of these to the flow."""


def fixed_scale() -> Fit:
    case = calibrated("uds/production", 0)
    names = [name for name in case.system.parameters if name != "D_p"]
    model = freed(case.model.with_parameters({"D_p": case.true["D_p"]}, {}), names)
    system = system_of(model, names)
    return fit(system, case.sections, lambda _: None, 1)


def test_the_displacement_is_the_anchor_of_the_flow() -> None:
    found = identify(calibrated("uds/production", 0).fit)
    assert found.anchors == {"D_p": SCALED}
    assert not found.estimates["D_p"].told
    assert found.estimates["D_p"].relative_spread == 0.0


def test_in_four_states_it_is_the_same() -> None:
    found = identify(calibrated("uds", 0, 4).fit)
    assert list(found.anchors) == ["D_p"]
    assert set(found.anchors["D_p"]) == {"A_t", "A_du", "A_ori", "A_dos", "B_ap"}
    assert not found.estimates["A_p"].told


def test_the_pump_filter_is_not_told() -> None:
    """No sensor is behind it: its area has no effect on what is measured but through the leak."""
    found = identify(calibrated("uds/production", 0).fit)
    prior = calibrated("uds/production", 0).model.parameters["A_p"].prior
    assert not found.estimates["A_p"].told
    assert found.estimates["A_p"].spread == pytest.approx(prior, rel=0.01)
    assert all(found.estimates[name].told for name in (*SCALED, "C_v"))


def test_relative_to_the_anchor_much_more_is_known() -> None:
    found = identify(calibrated("uds/production", 0).fit)
    anchor = found.estimates["D_p"].spread
    for name in SCALED:
        estimate = found.estimates[name]
        assert estimate.relative_spread < 0.3 * anchor, name
        assert estimate.spread**2 == pytest.approx(anchor**2 + estimate.relative_spread**2, rel=0.1), name


def test_without_a_prior_of_the_displacement_nothing_needs_an_anchor() -> None:
    found = identify(fixed_scale())
    whole = identify(calibrated("uds/production", 0).fit)
    assert found.anchors == {}
    assert "D_p" not in found.estimates
    for name in SCALED:
        estimate = found.estimates[name]
        assert estimate.told, name
        assert estimate.spread == pytest.approx(estimate.relative_spread)
        assert 0.5 < estimate.spread / whole.estimates[name].relative_spread < 2.0, name  # a jackknife of few blocks


def test_leak_and_orifice_are_hard_to_tell_apart() -> None:
    pairs = {
        (first, second): value for first, second, value in identify(calibrated("uds/production", 0).fit).correlated
    }
    assert -1.0 < pairs.pop(("C_v", "A_ori")) < -0.9
    assert all(abs(value) < 0.9 for value in pairs.values())


def test_an_interval_is_of_the_logarithm() -> None:
    estimate = identify(calibrated("uds/production", 0).fit).estimates["B_du"]
    low, high = estimate.interval(0.1)
    assert low * high == pytest.approx(estimate.value**2)
    assert np.log(high / low) == pytest.approx(2 * QUANTILE * 0.1)
    assert estimate.interval(0.0) == (estimate.value, estimate.value)


def test_a_parameter_that_may_be_zero_has_an_interval_in_its_unit() -> None:
    """The wound: 0 % was printed of a parameter that is zero in the file."""
    fit = calibrated("uds/production", 0).fit
    k = fit.unknowns.parameters.index("B_du")
    priors, spreads, values = fit.unknowns.priors.copy(), fit.unknowns.spreads.copy(), fit.unknowns.values.copy()
    priors[k], spreads[k], values[k] = 0.0, 3.0, 0.0
    moved = dataclasses.replace(fit, unknowns=fit.unknowns._replace(priors=priors, spreads=spreads, values=values))
    estimate, before = identify(moved).estimates["B_du"], identify(fit).estimates["B_du"]
    assert estimate.absolute
    assert not before.absolute
    assert estimate.spread == pytest.approx(3.0 * before.spread / fit.unknowns.priors[k])
    low, high = estimate.interval(estimate.spread)
    assert (high + low) / 2 == pytest.approx(estimate.value)
    assert (high - low) / 2 == pytest.approx(QUANTILE * estimate.spread)


def test_without_data_the_priors_are_all_there_is() -> None:
    given = calibrated("uds/production", 0).fit
    n = len(given.x)
    nothing = dataclasses.replace(given, x=np.zeros(n), covariance=np.eye(n), information=np.zeros((n, n)))
    found = identify(nothing)
    assert not any(estimate.told for estimate in found.estimates.values())
    for name, estimate in found.estimates.items():
        assert estimate.spread == pytest.approx(given.system.model.parameters[name].prior), name

"""The fit is asked for parameters that were changed in the made vehicle."""

import dataclasses

import numpy as np
import numpy.typing as npt
import pytest
from made_drive import DELAY_S, Case, Errors, calibrated, drawn, frames, freed, log_sections, silent

from faultline.analysis.calibration.fit import fit
from faultline.analysis.model import load_model
from faultline.analysis.simulation import system_of
from faultline.service.core.errors import InputError

Array = npt.NDArray[np.float64]
UDS1 = load_model("uds/production")
SEEDS = range(4)


def relative_z(case: Case) -> dict[str, float]:
    """By parameter the error in standard errors, given the error of the anchor, D_p; that one's own by itself."""
    unknowns = case.fit.unknowns
    names = unknowns.parameters
    n, a = len(names), names.index("D_p")
    error = np.log([case.fit.values[name] / case.true[name] for name in names]) / unknowns.priors
    C = case.fit.covariance[:n, :n]
    rest = error - C[:, a] / C[a, a] * error[a]
    left = np.diag(C) - C[:, a] ** 2 / C[a, a]
    rest[a], left[a] = error[a], C[a, a]
    return dict(zip(names, (rest / np.sqrt(left)).tolist(), strict=True))


def quiet_speed(seed: int) -> Case:
    """A speed sensor with a third of the noise that the model states."""
    system = system_of(UDS1, UDS1.calibrated)
    true = drawn(UDS1, seed)
    log = frames(UDS1, true, seed, delay_s=DELAY_S, errors=Errors(speed=0.3))
    found = log_sections(UDS1, system, log)
    return Case(UDS1, system, true, found, fit(system, found, silent, 1))


def test_parameters_are_found_and_the_stated_errors_are_honest() -> None:
    cases = [quiet_speed(seed) for seed in SEEDS]
    z = [relative_z(case) for case in cases]
    for seed, found in zip(SEEDS, z, strict=True):
        for name, value in found.items():
            assert abs(value) < 3.5, (seed, name)
    rms = np.sqrt(np.mean([value**2 for found in z for value in found.values()]))
    assert 0.5 < rms < 1.6, rms


def test_with_all_the_noise_that_the_model_states() -> None:
    """The noise of the speed biases the hose by some percent: what it makes within a cell is not in the weights."""
    cases = [calibrated("uds/production", seed) for seed in SEEDS]
    z = [relative_z(case) for case in cases]
    rms = np.sqrt(np.mean([value**2 for found in z for value in found.values()]))
    assert 0.5 < rms < 2.0, rms
    for seed, case, found in zip(SEEDS, cases, z, strict=True):
        for name, value in found.items():
            limit = 6.0 if name in {"B_du", "C_v"} else 3.5
            assert abs(value) < limit, (seed, name)
        ratio = {name: case.fit.values[name] / case.true[name] for name in found}
        assert ratio["B_du"] * ratio["D_p"] == pytest.approx(1.0, abs=0.04), seed
        assert ratio["A_dos"] / ratio["D_p"] == pytest.approx(1.0, abs=0.015), seed
        assert ratio["A_ori"] / ratio["D_p"] == pytest.approx(1.0, abs=0.04), seed


def test_the_command_s_delay_is_found() -> None:
    """Four steps, each up to 0.2 s early or late: their mean is known to 0.06 s, and no better is claimed."""
    errors = []
    for seed in SEEDS:
        case = calibrated("uds/production", seed)
        place = case.fit.unknowns.own.stop
        stated = 0.3 * np.sqrt(case.fit.covariance[place, place])
        assert 0.05 < stated < 0.12, seed
        errors.append(case.fit.unknowns.delay(case.fit.x)["dc_dose"] - DELAY_S)
        assert abs(errors[-1]) < 3.5 * stated, seed
    assert abs(np.mean(errors)) < 3.5 * 0.06 / np.sqrt(len(errors))


def test_zero_errors_are_found_against_each_other() -> None:
    """Two sensors see the same pressure but for a filter: their difference is known, their mean is not."""
    true = drawn(UDS1, 1)
    system = system_of(UDS1, ["A_du"])
    model = freed(UDS1, ["A_du"])
    values = {name: true[name] if name == "A_du" else p.value for name, p in UDS1.parameters.items()}
    zero = {"y_p_ap": 150.0, "y_p_du": -150.0, "y_p_tp": 60.0}
    section = log_sections(model, system, frames(UDS1, values, 1, zero=zero, delay_s=DELAY_S))
    found = fit(system, section, silent, 1)
    told = found.unknowns.zero(found.x)
    n = len(found.unknowns.parameters)
    for name, offset in zero.items():
        k = n + list(told).index(name)
        sd = found.unknowns.zeros[name] * np.sqrt(found.covariance[k, k])
        assert abs(told[name] - offset) < 3.5 * sd, name
    error = np.log(found.values["A_du"] / true["A_du"]) / found.unknowns.priors[0]
    assert abs(error) < 3.5 * np.sqrt(found.covariance[0, 0])
    assert abs(error) < 0.2


def test_what_no_sensor_tells_stays_at_the_datasheet() -> None:
    """The search has to know the priors: from another start the pump filter's area comes back."""
    found = calibrated("uds", 0, 4).fit
    assert found.values["A_p"] == pytest.approx(load_model("uds").parameters["A_p"].value, rel=0.05)
    assert abs(found.x[found.unknowns.parameters.index("D_p")]) < 0.5


def test_searches_from_all_starts_agree() -> None:
    """And the model of four states finds what that of one does on a vehicle with the same errors."""
    four, one = calibrated("uds", 0, 4).fit, calibrated("uds/production", 0).fit
    assert four.starts == (4, 4)
    assert one.starts == (1, 1)
    for name in ("A_t", "A_du", "A_ori", "A_dos"):
        assert four.values[name] == pytest.approx(one.values[name], rel=0.01), name


def test_a_bound_that_excludes_the_truth_is_told() -> None:
    case = calibrated("uds/production", 0)
    assert case.fit.at_bound == ()
    name = "A_dos"
    parameters = dict(UDS1.parameters)
    limit = 0.97 * UDS1.parameters[name].value
    parameters[name] = dataclasses.replace(parameters[name], min=0.5 * limit, value=0.9 * limit, max=limit)
    model = freed(dataclasses.replace(UDS1, parameters=parameters), ["A_dos", "A_ori", "B_du"])
    true = {name: p.value for name, p in UDS1.parameters.items()}
    system = system_of(model, ["A_ori", "A_dos", "B_du"])
    found = fit(system, log_sections(model, system, frames(UDS1, true, 1)), silent, 2)
    assert found.at_bound == ("A_dos",)
    assert found.values["A_dos"] == pytest.approx(limit, rel=1e-3)
    assert found.values["A_dos"] <= limit


def test_a_model_that_runs_from_no_start_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise InputError("uds: no free run is found")

    case = calibrated("uds/production", 0)
    monkeypatch.setattr("faultline.analysis.calibration.problem.run", fails)
    with pytest.raises(InputError, match="no free run is found"):
        fit(case.system, case.sections, silent, 2)


def test_the_same_data_give_the_same_numbers() -> None:
    case = calibrated("uds/production", 0)
    again = fit(case.system, case.sections, silent, 1)
    assert (again.x == case.fit.x).all()
    assert (again.covariance == case.fit.covariance).all()

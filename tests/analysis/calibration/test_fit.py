"""The fit is asked for parameters that were changed in the made vehicle."""

import math

import numpy as np
import pytest
from made_drive import freed, samples, ticks

from analysis.calibration.fit import MINIMUM_BLOCKS, fit
from analysis.graph.bank import Bank, build_bank
from analysis.model import load_model
from service.core.errors import InputError
from service.core.observer import Tick

UDS4 = load_model("uds4")
FREE = ("D_p", "A_du", "A_ori")


@pytest.fixture(scope="module")
def vehicle() -> Bank:
    return build_bank(UDS4)


@pytest.fixture(scope="module")
def bank() -> Bank:
    """What is calibrated: three parameters, so that flow ratios have their absolute scale from the fixed ones."""
    return build_bank(freed(UDS4, FREE))


@pytest.fixture(scope="module")
def nominal(vehicle: Bank) -> list[Tick]:
    return ticks(vehicle, samples(vehicle, {}, seed=1))


def silent(_: str) -> None:
    """Progress that nobody watches."""


def test_changed_parameters_are_found_from_independent_tests(vehicle: Bank, bank: Bank) -> None:
    """t12, t13, t19 and t21 see one and the same thing; four times would look four times as sure."""
    factors = {"D_p": 0.95, "A_du": 1.2, "A_ori": 0.9}
    true = {name: UDS4.parameters[name].value * factors[name] for name in FREE}
    said: list[str] = []
    found = fit(bank, ticks(vehicle, samples(vehicle, true, seed=2)), "made", said.append)
    assert list(found.values) == list(found.spread) == list(FREE)
    assert found.blocks >= MINIMUM_BLOCKS
    for name in FREE:
        error = math.log(found.values[name] / true[name])
        assert abs(error) < 4 * found.spread[name], name
        assert abs(error) < 0.03, name
        prior = UDS4.parameters[name].prior
        assert prior is not None
        assert 0 < found.spread[name] < prior / 5, name
    assert 2 <= len(found.rms) < 6
    assert next(iter(found.rms)) == "t02"
    assert all(rms < 1000.0 for rms in found.rms.values())  # what is left is noise: a sample's is 400 to 1000 Pa
    assert any(line.startswith("second fit: cost ") for line in said)


def test_a_short_recording_is_refused(bank: Bank, nominal: list[Tick]) -> None:
    with pytest.raises(InputError, match=r"^my log: only \d+ steady blocks of 5 s; record some minutes within"):
        fit(bank, nominal[:400], "my log", silent)


@pytest.mark.parametrize("broken", ["silent", "empty", "restless"])
def test_a_recording_without_steady_samples_is_refused(bank: Bank, nominal: list[Tick], broken: str) -> None:
    mute = np.zeros(5, dtype=np.bool_)
    recordings = {
        "silent": [tick._replace(usable=mute) for tick in nominal],
        "empty": [],
        "restless": [tick._replace(mode=(tick.number // 20) % 2) for tick in nominal],
    }
    with pytest.raises(InputError, match="only 0 steady blocks of 5 s"):
        fit(bank, recordings[broken], "my log", silent)


def test_a_model_without_priors_is_refused(nominal: list[Tick]) -> None:
    with pytest.raises(InputError, match="uds4: no parameter has a prior; give `prior` to those that shall be"):
        fit(build_bank(freed(UDS4, ())), nominal, "made", silent)

"""The dosing valve's pulses are found in the rig's recordings, and whether they help is told test by test."""

from pathlib import Path

import numpy as np
import pytest

from faultline.analysis.graph.bank import Bank, build_bank
from faultline.analysis.model import load_model
from faultline.analysis.recordings.bench import setup_of
from faultline.analysis.recordings.observe import observe
from faultline.analysis.recordings.pulse import Pulse, PulseError, estimate_pulse
from faultline.analysis.recordings.pulse_input import _choice, choose_input
from faultline.analysis.recordings.track import Track, tracks_of
from faultline.service.core.signals.dbc import compile_dbc
from faultline.service.core.signals.received import Signals
from faultline.service.logs import open_log
from faultline.testbench.bus import load_dbc
from faultline.testbench.cycles import CYCLES
from faultline.testbench.recording import record
from faultline.testbench.request import Request
from faultline.testbench.simulation import MARGIN
from faultline.testbench.valve import FREQUENCY
from faultline.testbench.vehicles import vehicle

DURATION = 300.0
SETUP = setup_of("uds")


@pytest.fixture(scope="module")
def bank() -> Bank:
    return build_bank(load_model("uds"))


@pytest.fixture(scope="module")
def seen(bank: Bank, tmp_path_factory: pytest.TempPathFactory) -> Signals:
    """A fault-free drive of an instrumented bench."""
    folder: Path = tmp_path_factory.mktemp("rig")
    asked = Request("pulse", vehicle("bench"), CYCLES["validation"], (), 4, DURATION, kind="instrumented")
    path, _ = record(asked, load_dbc(), folder / "out", folder / "truth", force=False, progress=lambda _: None)
    log = open_log(path)
    table = compile_dbc(log.dbc, {channel.signal: channel.unit for channel in bank.inputs}, "uds.dbc")
    return log.signals(table)


@pytest.fixture(scope="module")
def tracks(seen: Signals) -> dict[str, Track]:
    return tracks_of(seen, ["y_p_ap", "y_p_du", "y_p_tp", "dc_dose"])


def test_frequency_and_phase_of_the_rigs_valve_are_given_back(tracks: dict[str, Track]) -> None:
    pulse = estimate_pulse(tracks["y_p_ap"], tracks["y_p_du"], tracks["dc_dose"], SETUP)
    assert pulse.frequency_hz == pytest.approx(FREQUENCY, abs=0.002)
    middle = 0.5 * DURATION
    off = pulse.frequency_hz * middle + pulse.phase - FREQUENCY * (middle + MARGIN)
    assert (off + 0.5) % 1.0 - 0.5 == pytest.approx(0.0, abs=0.04)  # 12 ms
    assert pulse.explained > 0.5


def test_a_frequency_that_is_known_is_taken(tracks: dict[str, Track]) -> None:
    p_ap, p_du, dose = (tracks[name] for name in ("y_p_ap", "y_p_du", "dc_dose"))
    assert estimate_pulse(p_ap, p_du, dose, SETUP, FREQUENCY).frequency_hz == FREQUENCY
    with pytest.raises(PulseError, match=r"2\.000 Hz explains . % of y_p_ap's ripple"):
        estimate_pulse(p_ap, p_du, dose, SETUP, 2.0)


def test_the_valve_is_open_for_the_duty_of_every_pulse() -> None:
    """Pulses of 1 s from t = 0.25 s on; a new duty waits for the next pulse."""
    pulse = Pulse(1.0, 0.75, 1.0)
    dose = Track(np.array([0.0, 2.4]), np.array([0.5, 1.0]))
    t = np.array([1.25, 1.5, 1.75, 2.0, 2.5, 3.25, 3.5, 4.5])
    open_share = [0.0, 1.0, 1.0, 0.0, 1.0, 0.0, 1.0, 1.0]
    assert np.allclose(pulse.share(dose, t, 0.25), open_share)
    assert np.allclose(pulse.share(dose, np.array([1.375]), 0.25), 0.5)


def test_on_average_the_valve_is_open_for_the_dose(tracks: dict[str, Track]) -> None:
    dose = tracks["dc_dose"]
    share = Pulse(FREQUENCY, 0.3, 1.0).share(dose, dose.t[1:], 0.2)
    assert share.min() >= 0.0
    assert share.max() <= 1.0
    assert float(share.mean()) == pytest.approx(float(dose.value.mean()), abs=0.01)


def test_where_nothing_is_dosed_no_pulses_are_made_up(tracks: dict[str, Track]) -> None:
    idle = tracks["dc_dose"]._replace(value=np.zeros_like(tracks["dc_dose"].value))
    with pytest.raises(PulseError, match="0 s of it between off and full, 20 s are needed"):
        estimate_pulse(tracks["y_p_ap"], tracks["y_p_du"], idle, SETUP)


def test_noise_has_no_pulses(tracks: dict[str, Track]) -> None:
    rng = np.random.default_rng(1)
    noise = [
        tracks[name]._replace(value=1e3 * rng.standard_normal(len(tracks[name].t))) for name in ("y_p_ap", "y_p_du")
    ]
    with pytest.raises(PulseError, match=r"Hz explains [01]?\d % of y_p_ap's ripple"):
        estimate_pulse(noise[0], noise[1], tracks["dc_dose"], SETUP)


def test_on_the_rig_the_pulses_are_the_better_input_of_what_predicts_the_rippled_pressures(
    bank: Bank, seen: Signals, tracks: dict[str, Track]
) -> None:
    """Other than in the thesis (5.9): here the estimate is right to 12 ms and in step with the predicted sensor."""
    pulse = estimate_pulse(tracks["y_p_ap"], tracks["y_p_du"], tracks["dc_dose"], SETUP)
    choices = {choice.test: choice for choice in choose_input(bank, observe(bank, seen), pulse, tracks, "dc_dose")}
    assert list(choices) == [g.test for g in bank.generators if "dc_dose" in g.inputs]
    for test in ("t12", "t13", "t19", "t21"):
        assert choices[test].better == "pulses"
        assert choices[test].variance_ratio < 0.7
    assert choices["t20"].better == "neither"  # predicts y_p_tp, where the pulses hardly arrive
    for choice in choices.values():
        assert choice.variance_ratio == pytest.approx((choice.rms_pulses / choice.rms_duty) ** 2)


def test_pulses_out_of_step_are_worse_than_the_duty_cycle(bank: Bank, seen: Signals, tracks: dict[str, Track]) -> None:
    pulse = estimate_pulse(tracks["y_p_ap"], tracks["y_p_du"], tracks["dc_dose"], SETUP)
    choices = choose_input(bank, observe(bank, seen), pulse._replace(phase=pulse.phase + 0.5), tracks, "dc_dose")
    assert {choice.test for choice in choices if choice.better == "duty cycle"} >= {"t12", "t13", "t19", "t21"}


def test_without_partial_dose_the_inputs_are_not_compared(bank: Bank, seen: Signals, tracks: dict[str, Track]) -> None:
    ticks = [tick for tick in observe(bank, seen) if tick.t_s < 40.0]
    with pytest.raises(PulseError, match="the inputs cannot be compared: 0 s of mode partial"):
        choose_input(bank, ticks, Pulse(FREQUENCY, 0.3, 1.0), tracks, "dc_dose")


def test_the_better_input_is_named_where_the_difference_is_clear() -> None:
    rng = np.random.default_rng(2)
    small, large = rng.standard_normal(1000), 1.5 * rng.standard_normal(1000)
    assert _choice("t", "y", large, small).better == "pulses"
    assert _choice("t", "y", small, large).better == "duty cycle"
    assert _choice("t", "y", small, small + 1.0).better == "neither"  # a constant is no ripple

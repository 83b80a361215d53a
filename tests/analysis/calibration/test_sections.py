"""Where a recording is cut, and which samples count."""

import dataclasses
from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from made_drive import DOSE, ECU, ECU_S, HOLD_S, LATE_S, SENSORS, SPEED, UDS4, UDS4_SYSTEM, Errors, frames, log_sections

from faultline.analysis.calibration.inputs import is_command
from faultline.analysis.calibration.sections import (
    BLIND,
    GAP,
    LONGEST,
    SHORTEST,
    Section,
    fitting,
)
from faultline.analysis.calibration.sections import cut as divided
from faultline.analysis.simulation import System
from faultline.service.core.errors import InputError
from faultline.service.logs import Frame

WARM_UP_S = UDS4.warm_up_s
BLIND_S, GAP_S = BLIND * UDS4.period_s, GAP * UDS4.period_s
LONGEST_S, SHORTEST_S = LONGEST * UDS4.period_s, SHORTEST * UDS4.period_s

LOG = frames(UDS4, {}, seed=1)


def cut(log: list[Frame]) -> list[Section]:
    return log_sections(UDS4, UDS4_SYSTEM, log)


def spans(found: list[Section]) -> list[tuple[float, float]]:
    return [(section.start_s, section.start_s + float(section.t[-1])) for section in found]


def without(low: float, high: float, can_id: int) -> list[Frame]:
    return [frame for frame in LOG if frame.can_id != can_id or not low < frame.t < high]


def with_pressure(change: Callable[[float], int | None]) -> list[Frame]:
    """The pressure after the pump replaced where `change` of the time says so [50 Pa]."""
    found = []
    for frame in LOG:
        raw = change(frame.t) if frame.can_id == SENSORS else None
        data = frame.data if raw is None else frame.data[:2] + raw.to_bytes(2, "little") + frame.data[4:]
        found.append(frame._replace(data=data))
    return found


def test_an_undisturbed_log_is_one_section() -> None:
    [section] = cut(LOG)
    assert section.start_s == pytest.approx(0.03)  # when the ECU has told, too
    assert section.start_s + section.t[-1] == pytest.approx(LOG[-1].t, abs=0.3)
    assert list(section.samples) == ["y_p_tp", "y_p_ap", "y_p_du"]
    assert section.drive.inputs.shape == (len(section.t), 2)
    assert section.drive.guess.shape == (len(section.t), 4)
    assert (section.drive.start == section.drive.guess[0]).all()


def test_inputs_are_those_of_the_bus() -> None:
    [section] = cut(LOG)
    middles = np.arange(15.0, 180.0, 30.0)
    dose = np.interp(middles, section.start_s + section.t, section.drive.inputs[:, 1])
    assert dose == pytest.approx(DOSE)
    speed = np.interp(middles, section.start_s + section.t, section.drive.inputs[:, 0])
    assert np.abs(speed - (20.0, 20.0, 24.0, 28.0, 30.0, 22.0)).max() < 1.0


def test_the_states_start_where_the_sensors_are() -> None:
    [section] = cut(LOG)
    p_tp, p_bp, p_ap, p_du = section.drive.start
    assert p_tp == p_bp
    assert p_tp == pytest.approx(100.5e3, abs=2e3)
    assert p_ap == pytest.approx(p_du, abs=10e3)
    assert p_ap != p_du


def test_a_gap_of_an_input_cuts() -> None:
    found = cut(without(80.0, 80.5 + GAP_S, ECU))
    assert len(found) == 2
    (_, end), (start, _) = spans(found)
    assert end == pytest.approx(80.0, abs=0.3)
    assert start == pytest.approx(80.5 + GAP_S, abs=0.3)


def test_a_short_gap_does_not() -> None:
    assert len(cut(without(80.0, 80.7, ECU))) == 1


def test_a_gap_of_an_output_only_takes_its_samples() -> None:
    [section] = cut(without(80.0, 90.0, SENSORS))
    there = section.start_s + section.samples["y_p_ap"].t
    assert not ((there > 80.0) & (there < 90.0)).any()
    assert ((there > 70.0) & (there < 80.0)).sum() > 90
    du = section.start_s + section.samples["y_p_du"].t
    assert ((du > 80.0) & (du < 90.0)).any()


def test_an_output_out_of_range_cuts() -> None:
    """4 bar: there the hose is soft."""
    found = cut(with_pressure(lambda t: 8000 if 99.95 < t < 100.05 else None))
    (_, end), (start, _) = spans(found)
    assert end == pytest.approx(100.0, abs=0.06)
    assert start == pytest.approx(100.0, abs=0.06)


def test_an_error_code_is_no_value() -> None:
    """Not available, 0xFFFF, would be 32 bar."""
    [section] = cut(with_pressure(lambda t: 0xFFFF if 99.95 < t < 100.05 else None))
    [other] = cut(LOG)
    assert len(section.samples["y_p_ap"].t) == len(other.samples["y_p_ap"].t) - 1


def test_a_long_stretch_is_cut_into_equal_pieces() -> None:
    log = frames(UDS4, {}, seed=1, speed=(24.0, 26.0) * 6, dose=(0.0, 0.4, 0.6) * 4)
    found = cut(log)
    assert len(found) == 2
    lengths = [end - start for start, end in spans(found)]
    assert max(lengths) < LONGEST_S
    assert lengths[0] == pytest.approx(180.0, abs=0.3)
    assert lengths[1] == pytest.approx(180.0, abs=0.3)


@pytest.mark.parametrize("warm_up_s", [150.0, 280.0, 320.0])
def test_sections_are_as_long_as_a_slow_system_needs(warm_up_s: float) -> None:
    """The log of six minutes was cut into two of three, or one of five at most, which is no longer than the warm-up."""
    log = frames(UDS4, {}, seed=1, speed=(24.0, 26.0) * 6, dose=(0.0, 0.4, 0.6) * 4)
    found = log_sections(dataclasses.replace(UDS4, warm_up_s=warm_up_s), UDS4_SYSTEM, log)
    assert found
    assert all(end - start >= warm_up_s + SHORTEST_S for start, end in spans(found))


def test_a_log_that_is_shorter_than_the_warm_up_is_told_so() -> None:
    with pytest.raises(InputError, match=r"in no 530 s on end \(the model's warm_up_s of 500 s and 30 s more\)"):
        log_sections(dataclasses.replace(UDS4, warm_up_s=500.0), UDS4_SYSTEM, LOG)


def test_a_model_without_an_input_is_refused() -> None:
    system = SimpleNamespace(inputs=())
    with pytest.raises(InputError, match="the model uds has no input, and a free run without one says nothing"):
        divided(UDS4, cast(System, system), {}, "a")


def test_the_warm_up_of_every_section_does_not_count() -> None:
    for section in cut(without(80.0, 82.0, ECU)):
        for name, s in section.samples.items():
            assert WARM_UP_S <= s.t[0] < WARM_UP_S + 0.3 + BLIND_S, name
            assert s.t[-1] <= section.t[-1], name


def test_samples_near_a_step_of_the_command_do_not_count() -> None:
    """Nor the sample before: it may show the step already."""
    [section] = cut(LOG)
    steps = [30.0 * k for k in range(1, 6) if DOSE[k] != DOSE[k - 1]]
    for name, s in section.samples.items():
        t = section.start_s + s.t
        for step in steps:  # logged 0.03 s later, by the ECU's next frame
            assert not ((t > step - 0.15) & (t < step + BLIND_S)).any(), (name, step)
            assert ((t > step - 0.5) & (t < step - 0.18)).any(), (name, step)
            assert ((t > step + BLIND_S) & (t < step + BLIND_S + 0.3)).any(), (name, step)


def test_a_command_holds_still_between_its_steps() -> None:
    rng = np.random.default_rng(1)
    assert is_command(np.repeat([0.0, 0.4, 1.0], 50))
    assert not is_command(rng.normal(25.0, 0.05, 150))
    assert not is_command(np.round(rng.normal(25.0, 0.05, 1500) / 0.002) * 0.002)  # as coarse as the bus
    assert is_command(np.full(10, 25.0))


def test_where_the_speed_jumps_between_samples_its_mean_is_not_known() -> None:
    """A step of J anywhere in an interval leaves J / sqrt(12); of its neighbours' third differences it is half."""
    jumping = frames(UDS4, {}, seed=1, errors=Errors(jumps=True, wander=0.0))
    [section], [smooth] = cut(jumping), cut(LOG)
    begin, end, deviation, _ = section.uncertain["n_p"].T
    assert (end - begin) == pytest.approx(np.full(len(begin), ECU_S), abs=1e-3)
    for k in range(1, len(SPEED)):
        height = abs(SPEED[k] - SPEED[k - 1])
        logged = HOLD_S * k + LATE_S - section.start_s
        near = np.abs(begin - logged) < 1.5 * ECU_S
        expected = height * np.array([0.5, 1.0, 0.5]) / np.sqrt(12.0)
        assert deviation[near] == pytest.approx(expected if height else [], abs=0.1), k
    assert len(begin) < 3 * 4 + 0.01 * len(section.t)
    assert len(smooth.uncertain["n_p"]) < 0.01 * len(smooth.t)  # where it moves for two seconds, its noise says enough
    assert "dc_dose" not in section.uncertain  # a command's steps have a time of their own


def test_a_section_for_another_system_has_its_jumps() -> None:
    [section] = cut(frames(UDS4, {}, seed=1, errors=Errors(jumps=True)))
    assert fitting(section, UDS4_SYSTEM).uncertain is section.uncertain


def test_a_signal_that_never_tells_is_named() -> None:
    silent = [frame for frame in LOG if frame.can_id != SENSORS]
    with pytest.raises(InputError, match=r"^made: y_p_tp, y_p_ap never tells; calibrate on a recording that has all"):
        cut(silent)
    with pytest.raises(InputError, match=r"^made: y_p_tp, y_p_ap, y_p_du, n_p, dc_dose never tells"):
        cut([])


def test_a_short_log_is_refused() -> None:
    enough = WARM_UP_S + SHORTEST_S
    short = [frame for frame in LOG if frame.t < enough - 1.0]
    with pytest.raises(InputError, match=r"^made: in no 50 s on end .*do all inputs tell and all signals keep within"):
        cut(short)
    assert len(cut([frame for frame in LOG if frame.t < enough + 1.0])) == 1


def test_pieces_that_are_each_too_short_are_refused() -> None:
    often = with_pressure(lambda t: 8000 if t % 40.0 < 0.05 else None)
    with pytest.raises(InputError, match="in no 50 s on end"):
        cut(often)


def test_samples_know_their_operating_mode() -> None:
    """As the vehicle follows them: eight seconds of edge after a step, then by the dose."""
    [section] = cut(LOG)
    for name, s in section.samples.items():
        t, mode = section.start_s + s.t, np.array(UDS4.modes.names)[s.mode]
        for k, dose in enumerate(DOSE):
            settled = (t > 30.0 * k + 10.0) & (t < 30.0 * k + 29.5)
            expected = "idle" if dose < 0.02 else "maximum" if dose > 0.98 else "partial"
            assert set(mode[settled]) <= {expected}, (name, k)
            if k and DOSE[k - 1] != dose:
                assert set(mode[(t > 30.0 * k + BLIND_S) & (t < 30.0 * k + 7.5)]) == {"edge"}, (name, k)


def test_a_state_that_no_sensor_sees_needs_an_initial_expression() -> None:
    unknown = dict(UDS4.unknown)
    unknown["p_bp"] = dataclasses.replace(unknown["p_bp"], initial=())
    model = dataclasses.replace(UDS4, unknown=unknown)
    with pytest.raises(InputError, match=r"^uds: unknown.p_bp.initial: no expression uses only sensors' signals"):
        log_sections(model, dataclasses.replace(UDS4_SYSTEM, model=model), LOG)


def test_frames_that_are_older_than_the_last_are_left_out() -> None:
    again = sorted([*LOG, *(frame for frame in LOG if 50.0 < frame.t < 51.0)], key=lambda frame: frame.t)
    [section], [other] = cut(again), cut(LOG)
    for name, s in other.samples.items():
        assert np.array_equal(section.samples[name].value, s.value), name

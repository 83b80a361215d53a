"""A reading that tells rivals apart: what differs by more than is uncertain, and nothing where nothing does."""

import math

import pytest
from made_study import study

from faultline.analysis.discrepancy.name import gauge as module
from faultline.analysis.discrepancy.name.attempt import Attempt, Judge, Study, baseline_of
from faultline.analysis.discrepancy.name.gauge import DECIDES, gauge, readings

SENSORS = ("offset_p_du", "offset_p_ap")
OFFSET = 4e4
PRECISION = {"Pa": 0.003, "m3/s": 0.01}


@pytest.fixture(scope="module")
def rivals() -> tuple[Study, list[Attempt]]:
    """Two sensors of one pressure, of which one shows too much."""
    found = study(SENSORS, {"offset_p_du": OFFSET})
    judge = Judge(found, baseline_of(found))
    return found, [judge.attempt((name,)) for name in SENSORS]


def test_a_gauge_tells_which_of_two_sensors_is_off(rivals: tuple[Study, list[Attempt]]) -> None:
    found, attempts = rivals
    reading = gauge(found, attempts, [SENSORS], PRECISION)
    assert reading is not None
    assert reading.variable in ("p_ap", "p_du")
    assert (reading.unit, reading.told) == ("Pa", (SENSORS,))
    (one, sd), (other, _) = (reading.expected[name] for name in SENSORS)
    assert abs(one - other) == pytest.approx(OFFSET, rel=0.2)
    assert abs(one - other) > DECIDES * sd > 0.0


def test_what_is_as_uncertain_as_it_differs_is_no_reading(
    rivals: tuple[Study, list[Attempt]], monkeypatch: pytest.MonkeyPatch
) -> None:
    found, attempts = rivals
    told = {attempt.effects[0]: readings(found, attempt, PRECISION) for attempt in attempts}
    one, other = (told[name] for name in SENSORS)
    apart = max(abs(one[key][0] - other[key][0]) / math.hypot(one[key][1], other[key][1]) for key in one)
    monkeypatch.setattr(module, "DECIDES", 0.99 * apart)
    assert gauge(found, attempts, [SENSORS], PRECISION) is not None
    monkeypatch.setattr(module, "DECIDES", 1.01 * apart)
    assert gauge(found, attempts, [SENSORS], PRECISION) is None
    assert gauge(found, attempts, [], PRECISION) is None
    monkeypatch.setattr(module, "DECIDES", 0.99 * apart)
    assert gauge(found, attempts, [SENSORS], {}) is None  # a workshop without gauges


def test_flows_are_as_uncertain_as_their_scale(rivals: tuple[Study, list[Attempt]]) -> None:
    """All flows may be larger by the same factor: no pressure tells, only the datasheet does."""
    found, [attempt, _] = rivals
    told = readings(found, attempt, PRECISION)
    for (name, mode), (mean, sd) in told.items():
        if found.model.unknown[name].unit == "m3/s" and mode == "maximum":
            assert sd > 0.03 * abs(mean), name
        if name == "p_du":
            assert sd < 0.02 * abs(mean), mode
    assert told == readings(found, attempt, PRECISION)

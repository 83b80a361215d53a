"""Where a vehicle's residuals lie: no mode by one day and another by the next."""

import numpy as np
import pytest

from faultline.analysis.tuning.thresholds import MINIMUM_TICKS, Seen
from faultline.analysis.tuning.vehicles import Drive, offsets
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.time_scale import TimeScale

IDLE, PARTIAL, MAXIMUM = 1, 2, 3  # indices of the dosing system's modes, behind the edge


OWN = (0, 1, 2, 3)
MODES, TIME = ("edge", "idle", "partial", "maximum"), TimeScale(0.2, 20.0)  # of the dosing system


def drive(day: float, ticks: dict[int, int]) -> Drive:
    """Of one generator, which lies where its mode's number says, and the day."""
    mode = np.repeat(list(ticks), list(ticks.values()))
    r = (mode + day + np.random.default_rng(1).normal(0.0, 0.01, len(mode)))[:, None]
    seen = Seen("drive", np.zeros((len(mode), 1)), r, np.ones((len(mode), 1), dtype=np.bool_), mode, MODES, TIME)
    return Drive("", [], seen, [])


@pytest.mark.parametrize("more", [300, 3000])
def test_a_mode_that_one_drive_shows_more_of_is_not_of_that_days_level(more: int) -> None:
    """Two trucks of a campaign were told a clogged nozzle: idle was of one day, maximum dose of the other."""
    rainy = drive(-100.0, {IDLE: more, PARTIAL: 300, MAXIMUM: 300, EDGE: 100})
    sunny = drive(+100.0, {IDLE: 300, PARTIAL: 300, MAXIMUM: more, EDGE: 100})
    assert offsets([rainy, sunny], OWN)[0] == pytest.approx([0.0, 1.0, 2.0, 3.0], abs=0.01)


def test_a_mode_that_one_drive_alone_shows_lies_where_its_day_puts_it() -> None:
    rainy = drive(-100.0, {IDLE: 300, PARTIAL: 300, EDGE: 100})
    sunny = drive(+100.0, {IDLE: 300, PARTIAL: 300, MAXIMUM: 300, EDGE: 100})
    assert offsets([rainy, sunny], OWN)[0] == pytest.approx([0.0, 1.0, 2.0, 3.0], abs=0.01)


def test_a_moment_of_a_mode_counts_little() -> None:
    short = drive(-100.0, {IDLE: 300, PARTIAL: 300, MAXIMUM: MINIMUM_TICKS // 50, EDGE: 100})
    short.seen.r[short.seen.mode == MAXIMUM] += 1000.0
    long = drive(+100.0, {IDLE: 300, PARTIAL: 300, MAXIMUM: 300, EDGE: 100})
    assert offsets([short, long], OWN)[0, MAXIMUM] == pytest.approx(3.0, abs=1.0)


def test_a_mode_that_hardly_any_drive_shows_is_as_it_is_otherwise() -> None:
    only = drive(10.0, {IDLE: 300, PARTIAL: 300, EDGE: 100})
    found = offsets([only], OWN, np.full((1, 4), 7.0))[0]
    assert found == pytest.approx([10.0, 11.0, 12.0, 7.0], abs=0.01)

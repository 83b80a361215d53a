"""Where a signal was silent, at any rate of samples."""

import numpy as np
import pytest

from faultline.analysis.recordings.track import Track


@pytest.mark.parametrize(
    ("period_s", "silence_s", "is_gap"),
    [
        (0.005, 0.05, False),
        (0.005, 0.15, True),
        (0.1, 0.9, False),
        (0.1, 1.2, True),
        (0.2, 0.9, False),
        (0.2, 1.2, True),
        (60.0, 240.0, False),
        (60.0, 360.0, True),
    ],
)
def test_a_silence_is_told_from_a_sample_that_was_held_up(period_s: float, silence_s: float, is_gap: bool) -> None:
    before = period_s * np.arange(200)
    t = np.concatenate([before, before[-1] + silence_s + before])
    assert Track(t, np.zeros(len(t))).gaps() == ([(before[-1], before[-1] + silence_s)] if is_gap else [])

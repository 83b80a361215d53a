"""Operation that was never trained is told; what was trained, or nearly, is not."""

import numpy as np
import torch
from made_samples import circuit, rc

from faultline.training.free_run import Course
from faultline.training.novelty import novelty, novelty_of, operating_points
from faultline.training.reckoned import Equations, reckoned
from faultline.training.scaling import scaling_of
from faultline.training.windows import Windows


def walk(seed: int, inside: bool, ticks: int = 3000) -> tuple[Windows, Course]:
    """A state and an input that wander in an L (thesis Fig. 6.15): both are never large together, where `inside`."""
    layout, samples = rc(), circuit(1, ticks)
    rng = np.random.default_rng(seed)
    examples = reckoned(layout, samples, Equations(layout))
    windows = Windows(layout, examples, [], scaling_of(examples, "spread"), 0, 0)
    t = np.arange(ticks) / 40.0
    one, two = (1.0 + np.sin(t * f + rng.uniform(0, 6)) for f in (0.7, 0.31))
    if inside:
        along = np.sin(0.11 * t) > 0.0
        one, two = np.where(along, one, 0.2 * one), np.where(along, 0.2 * two, two)
    else:
        one, two = 1.2 + 0.4 * one, 1.2 + 0.4 * two
    noise = rng.normal(0.0, 0.02, (2, ticks))
    windows.z[:, 0] = torch.tensor(one + noise[0])
    x = torch.tensor(two + noise[1], dtype=torch.float32)[None, None]
    return windows, Course(torch.arange(ticks), x, x, x)


def test_the_empty_corner_of_an_l_is_new_and_its_legs_are_not() -> None:
    layout = rc()
    windows, course = walk(1, inside=True)
    measure = novelty_of(layout, windows, course)
    other, again = walk(2, inside=True)
    assert (novelty(measure, operating_points(other, again)) > 1.0).mean() < 0.01
    corner, there = walk(3, inside=False)
    assert (novelty(measure, operating_points(corner, there)) > 1.0).mean() > 0.95


def test_the_predicted_signal_takes_no_part() -> None:
    """A fault of the sensor must not hide itself by being novel."""
    layout = rc()
    windows, course = walk(1, inside=True)
    measure = novelty_of(layout, windows, course)
    before = novelty(measure, operating_points(windows, course))
    windows.z[:, layout.predicts[0]] += 100.0
    assert np.array_equal(before, novelty(measure, operating_points(windows, course)))

"""What numbers of sensors are like without a fault, by hand."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
import pytest

from faultline.analysis.tuning.numbers import RESTLESS, RESTS, STEPS, limited, widest
from faultline.service.core.manifest import Input
from faultline.service.core.signals.received import Received, column_of
from faultline.service.core.signals.values import Quality


class Said(NamedTuple):
    """A log that has numbers of `a`, or none, at times [s], in pieces of so many."""

    numbers: Sequence[tuple[float, float | None]]
    size: int

    def pieces(self, *, judged: bool = True) -> Iterator[Received]:
        for k in range(0, len(self.numbers), self.size):
            some = self.numbers[k : k + self.size]
            time = np.array([t for t, _ in some])
            worth = [(99.0, Quality.ERROR) if number is None else (number, Quality.GOOD) for _, number in some]
            column = column_of([(row, value, int(quality)) for row, (value, quality) in enumerate(worth)])
            yield Received(time[0], time[-1], time, time, {"a": column})

    def strangers(self) -> list[str]:
        return []


A = Input(signal="a", unit="Pa", maximum_age_s=1.0, lower=0.0, upper=10.0)


def of(*numbers: tuple[float, float | None]) -> Input:
    [found] = limited([A], Said(numbers, len(numbers)))
    assert [found] == limited([A], Said(numbers, 1)) == limited([A], Said(numbers, 2))
    return found


def test_the_longest_rest_and_the_largest_step_set_the_limits() -> None:
    found = of((0.0, 3.0), (0.5, 3.0), (1.0, 3.0), (1.5, 3.5), (2.0, 3.4), (6.0, 3.4))
    assert found.largest_step == pytest.approx(STEPS * 0.5)
    assert found.frozen_s == max(RESTS * 4.0, RESTLESS)


def test_a_step_over_a_gap_and_what_is_no_number_are_none() -> None:
    found = of((0.0, 3.0), (1.5, 9.0), (1.6, None), (1.7, 9.1))
    assert found.largest_step == pytest.approx(STEPS * 0.1)


def test_what_may_rest_is_never_frozen() -> None:
    resting = [(0.5 * k, 3.0) for k in range(round(2 * RESTLESS) + 1)]
    assert of(*resting).frozen_s is None
    assert of(*((t, 0.0) for t, _ in resting)).frozen_s == RESTLESS  # outside the operating region it may
    assert of(*resting).largest_step is None


@pytest.mark.parametrize(
    ("rests", "kept"), [([3.0, 5.0], 5.0), ([3.0, None], None), ([None, 3.0], None), ([None, None], None)]
)
def test_limits_are_those_that_all_recordings_keep(rests: Sequence[float | None], kept: float | None) -> None:
    each = [[msgspec.structs.replace(A, frozen_s=rest, largest_step=rest)] for rest in rests]
    [found] = widest(each)
    assert (found.frozen_s, found.largest_step) == (kept, kept)

"""The causal sampler: the last value at or before the tick, with age and quality."""

import msgspec
import numpy as np
import pytest

from faultline.service.core.manifest import Input
from faultline.service.core.signals.latest import DOUBTED_S
from faultline.service.core.signals.sampling import Sampler
from faultline.service.core.signals.values import Quality

INPUTS = [Input(signal=name, unit="Pa", maximum_age_s=1.0, lower=0.0, upper=10.0) for name in ("a", "b")]


def test_a_value_is_usable_until_its_maximum_age() -> None:
    sampler = Sampler(INPUTS)
    sampler.receive("a", 5.0, 3.0, Quality.GOOD)
    for t, usable in ((5.0, True), (6.0, True), (6.01, False)):
        values, quality = sampler.sample(t)
        assert values[0] == 3.0
        assert quality.tolist() == [Quality.GOOD if usable else Quality.LATE, Quality.MISSING]
    assert np.isnan(sampler.sample(5.0)[0][1])


def test_not_available_is_never_a_number_and_does_not_erase_the_last_one() -> None:
    sampler = Sampler(INPUTS)
    sampler.receive("a", 0.0, 3.0, Quality.GOOD)
    sampler.receive("a", 0.1, 65535.0, Quality.NOT_AVAILABLE)
    values, quality = sampler.sample(0.1)
    assert values[0] == 3.0
    assert quality[0] == Quality.NOT_AVAILABLE
    sampler.receive("a", 0.2, 4.0, Quality.GOOD)
    assert sampler.sample(0.2)[1][0] == Quality.GOOD


def test_the_age_is_that_of_the_value() -> None:
    """What comes and is no number, or is not believed, makes the last good value no younger."""
    sampler = Sampler([INPUTS[0], msgspec.structs.replace(INPUTS[1], largest_step=1.0)])
    assert np.isnan(sampler.ages(1.0)).all()
    sampler.receive("a", 1.0, 3.0, Quality.GOOD)
    sampler.receive("b", 1.5, 3.0, Quality.GOOD)
    assert sampler.ages(2.0).tolist() == [1.0, 0.5]
    sampler.receive("a", 2.0, 0.0, Quality.ERROR)
    sampler.receive("a", 2.25, 0.0, Quality.NOT_AVAILABLE)
    sampler.receive("b", 2.25, 9.0, Quality.GOOD)  # a jump
    assert sampler.ages(2.5).tolist() == [1.5, 1.0]
    sampler.receive("a", 2.5, 4.0, Quality.GOOD)
    assert sampler.ages(2.5).tolist() == [0.0, 1.0]


def test_complete_when_every_input_had_a_number_once() -> None:
    sampler = Sampler(INPUTS)
    sampler.receive("a", 0.0, 3.0, Quality.GOOD)
    sampler.receive("b", 0.0, 0.0, Quality.ERROR)
    assert not sampler.complete
    sampler.receive("b", 0.0, 0.0, Quality.GOOD)
    assert sampler.complete


def test_zero_is_a_number() -> None:
    sampler = Sampler(INPUTS)
    sampler.receive("a", 0.0, 0.0, Quality.GOOD)
    values, quality = sampler.sample(0.0)
    assert values[0] == 0.0
    assert quality[0] == Quality.GOOD


def test_the_sample_is_a_copy() -> None:
    sampler = Sampler(INPUTS)
    sampler.receive("a", 0.0, 1.0, Quality.GOOD)
    sampler.sample(0.0)[0][0] = 99.0
    assert sampler.sample(0.0)[0][0] == 1.0


STRICT = [msgspec.structs.replace(INPUTS[0], frozen_s=2.0, largest_step=1.0)]


def heard(*received: tuple[float, float]) -> list[str]:
    """What becomes of values received at times [s]."""
    sampler, found = Sampler(STRICT), []
    for t, value in received:
        sampler.receive("a", t, value, Quality.GOOD)
        found.append(Quality(int(sampler.sample(t)[1][0])).name)
    return found


def test_a_value_that_does_not_change_for_too_long_is_frozen_until_it_does() -> None:
    times = [(0.5 * k, 3.0) for k in range(7)]
    assert heard(*times) == ["GOOD"] * 5 + ["FROZEN"] * 2
    assert heard(*times, (3.5, 3.1), (4.0, 3.1)) == ["GOOD"] * 5 + ["FROZEN"] * 2 + ["GOOD"] * 2


def test_what_rests_outside_the_operating_region_is_not_frozen() -> None:
    rests = [(0.5 * k, 0.0) for k in range(20)]
    assert set(heard(*rests)) == {"GOOD"}
    assert heard(*rests, *((10.0 + 0.5 * k, 1.0) for k in range(6)))[20:] == ["GOOD"] * 5 + ["FROZEN"]


def test_a_value_that_was_away_is_not_frozen_when_it_is_back() -> None:
    """Nobody knows what it was meanwhile."""
    assert heard((0.0, 3.0), (0.5, 3.0), (20.0, 3.0), (20.5, 3.0)) == ["GOOD"] * 4


@pytest.mark.parametrize("quality", [Quality.NOT_AVAILABLE, Quality.ERROR, Quality.RESERVED])
def test_a_value_that_was_not_available_is_not_frozen_when_it_is_back(quality: Quality) -> None:
    """The same as before by chance, after a time in which its sender said that it has none."""
    sampler = Sampler(STRICT)
    for k in range(20):
        sampler.receive("a", 0.5 * k, 3.0 if k < 2 or k >= 18 else 0.0, Quality.GOOD if k < 2 or k >= 18 else quality)
    assert [Quality(int(q)) for q in sampler.sample(9.5)[1]] == [Quality.GOOD]


def test_what_is_doubted_is_not_good_until_it_no_longer_is() -> None:
    sampler = Sampler(INPUTS)
    for channel in INPUTS:
        sampler.receive(channel.signal, 0.0, 1.0, Quality.GOOD)
    sampler.doubt({"a": 0.05})
    assert [Quality(q) for q in sampler.sample(0.1)[1]][:2] == [Quality.DOUBTED, Quality.GOOD]
    assert sampler.new_doubts() == {"a": 0.05}
    sampler.doubt({"a": 0.0})
    assert sampler.new_doubts() == {}, "it is doubted already"
    sampler.doubt({})
    assert {Quality(q) for q in sampler.sample(0.1)[1]} == {Quality.GOOD}


def test_a_doubted_frame_makes_its_signals_doubted_for_ten_seconds_and_the_sample_before_it_too() -> None:
    sampler = Sampler(INPUTS)
    for k in range(100):
        for channel in INPUTS:
            sampler.receive(channel.signal, 0.2 * k, 1.0, Quality.GOOD)
        if k == 10:
            sampler.receive("a", 2.001, np.nan, Quality.DOUBTED)
            assert sampler.new_doubts() == {"a": 2.0}
        values, worth = sampler.sample(0.2 * k + 0.1)
        assert values[0] == 1.0
        assert Quality(worth[0]) is (Quality.DOUBTED if k >= 10 and 0.2 * k + 0.1 < 2.001 + DOUBTED_S else Quality.GOOD)
        assert Quality(worth[1]) is Quality.GOOD
    assert sampler.new_doubts() == {}


def test_a_spike_is_not_believed_and_a_step_is_once_it_lasts() -> None:
    assert heard((0.0, 3.0), (0.1, 5.0), (0.2, 3.1)) == ["GOOD", "JUMP", "GOOD"]
    assert heard((0.0, 3.0), (0.1, 5.0), (0.2, 5.1), (0.3, 5.0)) == ["GOOD", "JUMP", "GOOD", "GOOD"]
    assert heard((0.0, 3.0), (0.1, 9.0), (0.2, 5.0), (0.3, 1.0)) == ["GOOD", "JUMP", "JUMP", "JUMP"]


def test_a_value_on_the_border_is_inside_and_one_of_its_maximum_age_is_not_away() -> None:
    rests = [(0.5 * k, STRICT[0].upper) for k in range(20)]
    assert set(heard(*rests)) == {"GOOD"}  # on the border of the operating region, and so no sensor that is stuck
    assert heard((0.0, 3.0), (STRICT[0].maximum_age_s, 9.0)) == ["GOOD", "JUMP"]


def test_after_a_gap_any_value_may_come() -> None:
    assert heard((0.0, 3.0), (1.1, 9.0)) == ["GOOD", "GOOD"]


def test_a_jump_keeps_the_last_good_value() -> None:
    sampler = Sampler(STRICT)
    sampler.receive("a", 0.0, 3.0, Quality.GOOD)
    sampler.receive("a", 0.1, 9.0, Quality.GOOD)
    assert sampler.sample(0.1)[0][0] == 3.0


def test_doubts_of_a_signal_begin_with_the_earliest_and_end_after_ten_seconds_of_none() -> None:
    sampler = Sampler(INPUTS)
    sampler.receive("a", 1.0, np.nan, Quality.DOUBTED)
    assert sampler.new_doubts() == {"a": 1.0}, "no sample was before it"
    sampler.receive("a", 2.0, 3.0, Quality.GOOD)
    sampler.receive("a", 2.5, np.nan, Quality.DOUBTED)
    assert sampler.new_doubts() == {}, "it is doubted still"
    assert Quality(sampler.sample(2.5)[1][0]) is Quality.DOUBTED
    until = 2.5 + DOUBTED_S
    sampler.receive("a", until, 4.0, Quality.GOOD)
    assert Quality(sampler.sample(until)[1][0]) is Quality.GOOD
    sampler.receive("a", until, np.nan, Quality.DOUBTED)
    assert sampler.new_doubts() == {"a": until}
    sampler.doubt({"b": 4.0})
    sampler.receive("b", 5.0, np.nan, Quality.DOUBTED)
    assert sampler.new_doubts() == {"b": 4.0}, "the earlier of the two"
    sampler.receive("a", 40.0, 1.0, Quality.GOOD)
    sampler.receive("a", 41.0, np.nan, Quality.DOUBTED)
    sampler.doubt({"a": 40.5})
    assert sampler.new_doubts() == {"a": 40.0}, "the sample before the doubted frame"

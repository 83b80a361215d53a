"""The causal sampler: the last value at or before the tick, with age and quality."""

import numpy as np

from service.core.manifest import Input
from service.core.sampling import Sampler
from service.core.signals import Quality

INPUTS = [Input(signal=name, unit="Pa", maximum_age_s=1.0, lower=0.0, upper=10.0) for name in ("a", "b")]


def test_a_value_is_usable_until_its_maximum_age() -> None:
    sampler = Sampler(INPUTS)
    sampler.receive("a", 5.0, 3.0, Quality.GOOD)
    for t, usable in ((5.0, True), (6.0, True), (6.01, False)):
        values, mask = sampler.sample(t)
        assert values[0] == 3.0
        assert mask.tolist() == [usable, False]
    assert np.isnan(sampler.sample(5.0)[0][1])


def test_not_available_is_never_a_number_and_does_not_erase_the_last_one() -> None:
    sampler = Sampler(INPUTS)
    sampler.receive("a", 0.0, 3.0, Quality.GOOD)
    sampler.receive("a", 0.1, 65535.0, Quality.NOT_AVAILABLE)
    values, usable = sampler.sample(0.1)
    assert values[0] == 3.0
    assert not usable[0]
    sampler.receive("a", 0.2, 4.0, Quality.GOOD)
    assert sampler.sample(0.2)[1][0]


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
    values, usable = sampler.sample(0.0)
    assert values[0] == 0.0
    assert usable[0]


def test_the_sample_is_a_copy() -> None:
    sampler = Sampler(INPUTS)
    sampler.receive("a", 0.0, 1.0, Quality.GOOD)
    sampler.sample(0.0)[0][0] = 99.0
    assert sampler.sample(0.0)[0][0] == 1.0
